"""The search for one more level step, in noise that may wander from session to session."""

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.special import stdtr

from analytics.trends.levels.session_model import SessionModel, SessionNoise, Sums, Whitened
from analytics.trends.levels.sessions import LevelStep
from stream.batch import FloatArray, IntArray

_SIMULATED = 500
_SEED = 20260781
_CONFIDENCE = 0.95
_WHITE = SessionNoise(0.0, 0.0)
# a likelihood ratio below which not even one moment alone is significant at 1 %
_IDLE = 6.6
# up to this probability in white noise, the one in noise of the sessions is computed
_SEEN = 0.05
# noises within this much of the greatest log-likelihood are plausible
_PLAUSIBLE = 2.0
# beyond this quantile of the simulated ones probabilities are extrapolated by an exponential
_TAIL = 0.03


class BestStep(NamedTuple):
    """The best step; the probability of one as good in white noise, and in noise of the sessions."""

    step: LevelStep
    seen: float
    wander: float


class _NoiseFit(NamedTuple):
    """The fixed columns fitted under one noise: remaining sums of squares of each series, and the normal equations."""

    whitened: Whitened
    products: FloatArray
    squares: FloatArray
    normal: FloatArray
    right: FloatArray


class StepSearch:
    """The search for one more step beside fixed columns."""

    def __init__(self, model: SessionModel, steps: list[LevelStep], fixed: FloatArray) -> None:
        self._model = model
        self._all = steps
        self._fixed = fixed
        self._steps = [step for step in steps if not _depends(step.column, fixed)]
        none = np.empty((len(fixed), 0))
        self._columns = np.column_stack([none, *(step.column for step in self._steps)])

    def with_step(self, step: LevelStep) -> "StepSearch":
        """The same search beside one more known step."""
        return StepSearch(self._model, self._all, np.column_stack([self._fixed, step.column]))

    def without(self, step: LevelStep) -> "StepSearch":
        """The same search without a step that was added."""
        kept = [at for at in range(self._fixed.shape[1]) if not np.array_equal(self._fixed[:, at], step.column)]
        return StepSearch(self._model, self._all, self._fixed[:, kept])

    @property
    def _freedom(self) -> int:
        return int(self._model.session.size - self._fixed.shape[1])

    def _fit(self, whitened: Whitened, sums: Sums) -> _NoiseFit:
        products = whitened.turn @ sums.products
        normal = self._fixed.T @ whitened.weight @ self._fixed
        right = self._fixed.T @ products
        squares = sums.squares - np.sum(sums.products * (whitened.inner @ sums.products), axis=0)
        squares = squares - np.sum(right * np.linalg.solve(normal, right), axis=0)
        return _NoiseFit(whitened, products, np.maximum(squares, 1e-12 * sums.squares), normal, right)

    def _fits(self, sums: Sums, noises: tuple[Whitened, ...] = ()) -> list[_NoiseFit]:
        return [self._fit(each, sums) for each in noises or self._model.whitened]

    def _likelihood(self, fit: _NoiseFit, squares: FloatArray) -> FloatArray:
        """Logarithm of the restricted likelihood."""
        log_det = fit.whitened.log_det + float(np.linalg.slogdet(fit.normal)[1])
        return -0.5 * (log_det + self._freedom * np.log(squares))

    def _explained(self, fit: _NoiseFit) -> tuple[FloatArray, FloatArray]:
        """Of each step and series its product with the residuals; of each step its information."""
        across = fit.whitened.weight @ self._columns
        beside = np.linalg.solve(fit.normal, self._fixed.T @ across)
        product = self._columns.T @ fit.products - beside.T @ fit.right
        information = np.sum(self._columns * across, axis=0) - np.sum(beside * (self._fixed.T @ across), axis=0)
        return product, np.maximum(information, 1e-12)

    def _step_ratios(self, fits: list[_NoiseFit]) -> tuple[FloatArray, IntArray]:
        """Twice the log-likelihood ratio of the best step against none, each with its best noise; which step."""
        series = fits[0].squares.size
        without = np.full(series, -np.inf)
        best = np.full((len(self._steps), series), -np.inf)
        for fit in fits:
            without = np.maximum(without, self._likelihood(fit, fit.squares))
            product, information = self._explained(fit)
            left = np.maximum(fit.squares - product**2 / information[:, None], 1e-12 * fit.squares)
            np.maximum(best, self._likelihood(fit, left), out=best)
        return 2 * (best.max(axis=0) - without), best.argmax(axis=0)

    def _session_ratios(self, fits: list[_NoiseFit]) -> FloatArray:
        """Twice the log-likelihood ratio of the best noise of the sessions against none."""
        each = np.array([self._likelihood(fit, fit.squares) for fit in fits])
        return np.asarray(2 * (each.max(axis=0) - each[0]), np.float64)

    def best(self, sums: Sums) -> BestStep | None:
        """The best step: its probability in white noise, and in noise of the sessions that is plausible."""
        if not self._steps:
            return None
        white = self._model.whitened[:1]
        ratio, _ = self._step_ratios(self._fits(sums, white))
        seen = wander = 1.0
        if ratio[0] > _IDLE:
            seen = _tail(self._step_ratios(self._fits(self._simulated(_WHITE), white))[0], float(ratio[0]))
        fits = self._fits(sums)
        ratio, at = self._step_ratios(fits)
        if seen <= _SEEN and ratio[0] > 0:
            simulated = (self._fits(self._simulated(noise)) for noise in self._plausible(fits))
            wander = max(_tail(self._step_ratios(each)[0], float(ratio[0])) for each in simulated)
        return BestStep(self._steps[int(at[0])], seen, wander)

    def _simulated(self, noise: SessionNoise) -> Sums:
        return self._model.simulated(noise, _SIMULATED, np.random.default_rng(_SEED))

    def unsteady(self, sums: Sums, asked: float) -> tuple[float, float] | None:
        """Deviation of the sessions and its probability in noise alone; None where that is above `asked`."""
        fits = self._fits(sums)
        ratio = float(self._session_ratios(fits)[0])
        if ratio < _IDLE / 2:
            return None
        chance = _tail(self._session_ratios(self._fits(self._simulated(_WHITE))), ratio)
        if chance > asked:
            return None
        best = self._likeliest(fits)
        deviation = math.sqrt(float(best.squares[0]) / self._freedom)
        return deviation * math.sqrt(best.whitened.noise.ratio / self._model.mean_size), chance

    def _likeliest(self, fits: list[_NoiseFit]) -> _NoiseFit:
        return max(fits, key=lambda fit: float(self._likelihood(fit, fit.squares)[0]))

    def _plausible(self, fits: list[_NoiseFit]) -> list[SessionNoise]:
        """The noise that fits best, and the slowest one that is plausible."""
        likelihood = np.array([float(self._likelihood(fit, fit.squares)[0]) for fit in fits])
        near = [fits[at].whitened.noise for at in np.flatnonzero(likelihood >= likelihood.max() - _PLAUSIBLE)]
        slowest = max(near, key=lambda each: each.slow)
        return list(dict.fromkeys([fits[int(likelihood.argmax())].whitened.noise, slowest]))

    def levels(self, sums: Sums) -> FloatArray:
        """Level of each session: that of its station, with the steps."""
        best = self._likeliest(self._fits(sums))
        return self._fixed @ np.linalg.solve(best.normal, best.right)[:, 0]

    def residuals(self, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Value expected of each unit and station, and the standard deviation of the residual in that of the noise."""
        model = self._model
        left, spread = model.residuals(y - self.levels(model.sums(y))[model.session])
        return y - left, spread

    def moments(self, sums: Sums, step: LevelStep) -> "Moments":
        """All possible moments of this step: weights by their likelihoods, and sizes with each noise."""
        near = [at for at, each in enumerate(self._steps) if each.station == step.station]
        rows = []
        for fit in self._fits(sums):
            product, information = (each[near] for each in self._explained(fit))
            left = np.maximum(fit.squares[0] - product[:, 0] ** 2 / information, 1e-12 * fit.squares[0])
            freedom = self._freedom - 1
            log_det = fit.whitened.log_det + float(np.linalg.slogdet(fit.normal)[1]) + np.log(information)
            errors = np.sqrt(left / freedom / information)
            rows.append((-0.5 * (log_det + freedom * np.log(left)), product[:, 0] / information, errors))
        logs, sizes, errors = (np.array(each) for each in zip(*rows, strict=True))
        weights = np.exp(logs - logs.max())
        return Moments([self._steps[at] for at in near], weights / weights.sum(), sizes, errors, self._freedom - 1)


class Moments(NamedTuple):
    """Steps at all moments; weights, sizes and standard errors of shape (noises, steps)."""

    steps: list[LevelStep]
    weights: FloatArray
    sizes: FloatArray
    errors: FloatArray
    freedom: int

    def size(self) -> tuple[float, float, float]:
        """Size with its 95 % bounds, over all moments and noises."""
        mean = float(np.sum(self.weights * self.sizes))
        live = self.weights > 1e-9
        weights, sizes, errors = self.weights[live], self.sizes[live], self.errors[live]
        far = 50 * float(errors.max()) + float(np.ptp(sizes))

        def below(size: float) -> float:
            return float(weights @ stdtr(self.freedom, (size - sizes) / errors))

        tail = (1 - _CONFIDENCE) / 2
        lo, hi = (brentq(lambda size, p=p: below(size) - p, mean - far, mean + far) for p in (tail, 1 - tail))
        return mean, float(lo), float(hi)

    def likely(self) -> list[LevelStep]:
        """The moments that hold 95 % of the weight."""
        weight = self.weights.sum(axis=0)
        order = np.argsort(-weight, kind="stable")
        many = int(np.searchsorted(np.cumsum(weight[order]), _CONFIDENCE)) + 1
        return [self.steps[at] for at in sorted(order[:many])]


def _depends(column: FloatArray, fixed: FloatArray) -> bool:
    left = column - fixed @ np.linalg.lstsq(fixed, column, rcond=None)[0]
    return bool(left @ left < 1e-9 * (column @ column))


def _tail(simulated: FloatArray, value: float) -> float:
    """Probability of a value at least this large."""
    n = simulated.size
    above = int((simulated >= value).sum())
    if above >= _TAIL * n:
        return (above + 1) / (n + 1)
    start = float(np.quantile(simulated, 1 - _TAIL))
    mean = max(float((simulated[simulated > start] - start).mean()), 1e-9)
    return _TAIL * math.exp(-max(value - start, 0.0) / mean)
