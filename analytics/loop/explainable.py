"""How much more of the error a function of the recorded channels can explain, at least.

Gradient boosting of regression trees learns the residual of a diagnosed unit from its channels, their slopes and their
lags, and predicts each run from the other runs. What it predicts is a lower bound: another function may explain more.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from threadpoolctl import threadpool_limits

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.residuals import Residuals
from analytics.loop.tracing.held_out.error_report import error_gain, less_run_means
from analytics.loop.tracing.result.holdout import REFERENCE_S
from analytics.loop.tracing.whitening.noise_variance import averages_of
from analytics.methods.distributions import normal_sf, student_sf
from stream.batch import FloatArray, IntArray

MOST_P_VALUE = 0.003
_MOST_FOLDS = 12
_LAG_S = 600.0
_LEAST_SHARE = 0.1  # of what is explained, from which a channel is named
_NOT_CAUSES = ("day", "position")
_FEWEST_REPLICATES = 3
_FEWEST_IN_LEAF, _LEAST_OF_ALL_IN_LEAF = 20, 0.005
_TREES = {"max_iter": 100, "learning_rate": 0.06, "max_leaf_nodes": 8, "l2_regularization": 1.0}


class Explainable(msgspec.Struct, frozen=True, kw_only=True):
    """Share of the squared error about the mean of each run that the channels explain in runs not learned from.

    Parameters
    ----------
    at_least: Lower bound of the share, `lo` or 0; 0 where it is not significant.
    value: Estimate of the share; negative if the prediction is worse than none.
    lo, hi: Its 95 % confidence bounds over runs; None with a single run.
    averaging_s: Averaging time of the error.
    p_value: Of no dependence on the channels.
    channels: Share of each channel in what is explained, the largest first.
    """

    at_least: float
    value: float
    lo: float | None
    hi: float | None
    averaging_s: float
    p_value: float
    channels: dict[str, float] = {}

    @property
    def is_significant(self) -> bool:
        """Whether the residual depends on the channels."""
        return self.p_value < MOST_P_VALUE and self.value > 0

    @property
    def sentence(self) -> Bilingual:
        """What is left to explain."""
        estimate = f"{self.value:.0%}"
        if self.lo is not None and self.hi is not None:
            estimate += f", 95 %: {self.lo:.0%} … {self.hi:.0%}"
        if self.value > 0 and not self.is_significant:
            return Bilingual(
                f"what a black box explains of the error from the recorded channels is not significant ({estimate}; "
                f"p = {self.p_value:.2g}, below {MOST_P_VALUE:g} is asked for)",
                f"黑箱回归由所记录的通道解释的误差不显著（{estimate}；p = {self.p_value:.2g}，须小于{MOST_P_VALUE:g}）",
            )
        if not self.is_significant:
            return Bilingual(
                "a black box explains no more of the error from the recorded channels",
                "黑箱回归也未能用已记录的通道进一步解释误差",
            )
        names, seconds = list(self.channels), f"{self.averaging_s:g} s"
        if not self.at_least > 0:
            return Bilingual(
                f"the error follows a function of {', '.join(names)}, learned from others (p = {self.p_value:.2g}), "
                f"but how much of it that explains is not settled ({estimate})",
                f"误差随{'、'.join(names)}的某一函数变化（由其他试验学得，p = {self.p_value:.2g}）；"
                f"可解释的份额尚不能确定（{estimate}）",
            )
        return Bilingual(
            f"at least {self.at_least:.0%} more of the squared error about the mean of each run, at {seconds}, is "
            f"explained by a function of {', '.join(names)}, learned from other runs (estimate {estimate})",
            f"去除各次试验均值后，{seconds}平均时间上的误差平方至少还有{self.at_least:.0%}可由"
            f"{'、'.join(names)}的函数解释（由其他试验学得；估计值{estimate}）",
        )

    def document(self) -> dict[str, Any]:
        """JSON form."""
        return {
            "at_least": self.at_least,
            "value": self.value,
            "lo": self.lo,
            "hi": self.hi,
            "averaging_s": self.averaging_s,
            "p_value": self.p_value,
            "significant": self.is_significant,
            "channels": list(self.channels),
            "shares": self.channels,
        }


@dataclass(frozen=True)
class _Features:
    """Columns for the trees, shape (n, features), and the channel of each."""

    columns: FloatArray
    channel: tuple[str, ...]


def explainable(residuals: Residuals, seed: int = 0) -> Explainable | None:
    """Predict the residual of each replicate from the others; None with fewer than three, or without a channel.

    Needs scikit-learn, the extra ``explain``.
    """
    from sklearn.ensemble import HistGradientBoostingRegressor

    record = residuals.record
    replicate = record.stack.replicate
    features = _features(residuals)
    if len(record.stack.replicates) < _FEWEST_REPLICATES or not features.channel:
        return None
    left = less_run_means(residuals.after, replicate)
    # threads of the trees that wait for each other cost more than they save, twentyfold on a busy machine; the limit
    # holds for libraries that are loaded by now
    with threadpool_limits(1, "openmp"):
        forest = _Forest.grown(HistGradientBoostingRegressor, features, left, replicate, seed)
        predicted = forest.predicted()
        found = _share(residuals, left, predicted)
        if not found.is_significant:
            return found
        won = _alignment(residuals, left, np.column_stack([predicted, forest.predicted_without_each(seed)]))[0]
    lost = np.maximum(won[0] - won[1:], 0.0)
    shares = lost / max(float(lost.sum()), 1e-300)
    names = list(dict.fromkeys(features.channel))
    named = {names[at]: float(shares[at]) for at in np.argsort(-shares) if shares[at] >= _LEAST_SHARE}
    return msgspec.structs.replace(found, channels=named)


@dataclass(frozen=True)
class _Forest:
    """Trees of each fold of the replicates, grown on the other folds."""

    features: _Features
    replicate: IntArray
    fold: IntArray
    trees: tuple[Any, ...]

    @classmethod
    def grown(
        cls, regressor: Callable[..., Any], features: _Features, left: FloatArray, replicate: IntArray, seed: int
    ) -> "_Forest":
        fold = replicate % _MOST_FOLDS
        trees = []
        for number in np.unique(fold):
            rest = fold != number
            leaf = max(_FEWEST_IN_LEAF, int(_LEAST_OF_ALL_IN_LEAF * np.count_nonzero(rest)))
            each = regressor(**_TREES, min_samples_leaf=leaf, random_state=seed)
            trees.append(each.fit(features.columns[rest], left[rest]))
        return cls(features, replicate, fold, tuple(trees))

    def predicted(self, columns: FloatArray | None = None) -> FloatArray:
        """Each replicate from the trees of the others, less its mean."""
        given = self.features.columns if columns is None else columns
        found = np.empty(len(given))
        for number, trees in zip(np.unique(self.fold), self.trees, strict=True):
            found[self.fold == number] = trees.predict(given[self.fold == number])
        return less_run_means(found, self.replicate)

    def predicted_without_each(self, seed: int) -> FloatArray:
        """The same with the readings of one channel shuffled within each replicate, a column for each channel."""
        rng = np.random.default_rng(seed)
        order = np.lexsort((rng.random(self.replicate.size), self.replicate))
        found = []
        for name in dict.fromkeys(self.features.channel):
            columns = self.features.columns.copy()
            at = np.flatnonzero(np.array(self.features.channel) == name)
            columns[:, at] = columns[np.ix_(order, at)]
            found.append(self.predicted(columns))
        return np.column_stack(found)


def _share(residuals: Residuals, left: FloatArray, predicted: FloatArray) -> Explainable:
    record, replicate = residuals.record, residuals.record.stack.replicate
    _, along, squares = _alignment(residuals, left, predicted[:, None])
    block_s = record.noise_model.block_s
    rows = np.arange(len(record))
    averages = averages_of(record, max(1, round(REFERENCE_S / block_s)), rows)
    seconds = max(REFERENCE_S, block_s)
    if not averages.rows:
        averages, seconds = averages_of(record, 1, rows), block_s
    before, explained = averages.of(left), averages.of(predicted)
    gain = error_gain(before, before - explained, np.array([replicate[each[0]] for each in averages.rows]))
    if gain is None:
        return Explainable(at_least=0.0, value=0.0, lo=None, hi=None, averaging_s=seconds, p_value=1.0)
    p_value = _p_value(along, squares)
    return Explainable(
        at_least=max(gain.lo or 0.0, 0.0) if p_value < MOST_P_VALUE else 0.0,
        value=gain.fraction,
        lo=gain.lo,
        hi=None if gain.hi is None else min(gain.hi, 1.0),
        averaging_s=seconds,
        p_value=p_value,
    )


def _alignment(
    residuals: Residuals, left: FloatArray, predicted: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Whitened residual times each prediction, in all; of the first, by replicate; and its square by replicate."""
    replicate = residuals.record.stack.replicate
    whitened = residuals.record.whitener(residuals.noise)(np.column_stack([left, predicted]))
    by_replicate = [np.bincount(replicate, each * whitened[:, 1]) for each in whitened[:, :2].T]
    along, squares = (np.asarray(each, dtype=np.float64) for each in by_replicate)
    return whitened[:, 0] @ whitened[:, 1:], along, squares


def _p_value(along: FloatArray, squares: FloatArray) -> float:
    """Of the sum over replicates of whitened residual times prediction, which is 0 on average where nothing is left.

    The prediction of one replicate is made of the residuals of the others: each pair counts twice, which doubles the
    variance. The larger of two standard errors counts: by the noise model, and from the scatter over replicates.
    """
    total, count = float(along.sum()), along.size
    if squares.sum() <= 0:
        return 1.0
    slope = total / float(squares.sum())
    by_model = np.sqrt(2.0 * squares.sum())
    by_scatter = np.sqrt(2.0 * count / (count - 1) * np.sum((along - slope * squares) ** 2))
    return float(max(normal_sf(total / by_model), student_sf(total / max(by_scatter, 1e-300), count - 1)))


def _features(residuals: Residuals) -> _Features:
    """Means of the channels, and of those that change slowly their slopes and what they are ahead of a lag."""
    stack = residuals.record.stack
    columns: list[FloatArray] = []
    channel: list[str] = []
    for name in sorted(residuals.channels.difference(_NOT_CAUSES)):
        of_runs = [_of_channel(run, name) for run in stack.runs]
        for kind in zip(*of_runs, strict=True):
            column = np.concatenate([each[rows] for each, rows in zip(kind, stack.rows, strict=True)])
            if np.isfinite(column).any() and np.nanstd(column) > 0:
                columns.append(column)
                channel.append(name)
    return _Features(np.column_stack(columns) if columns else np.empty((len(stack), 0)), tuple(channel))


def _of_channel(run: RunBlocks, name: str) -> tuple[FloatArray, ...]:
    from scipy.signal import lfilter  # slow to import

    mean = run.mean(name)
    time_s = run.time_s
    slope = np.gradient(mean, time_s) if len(run) > 1 else np.zeros(len(run))
    share = -np.expm1(-run.block_s / _LAG_S)
    known = np.isfinite(mean)
    # a block without a reading would leave none of those after it
    filled = np.interp(time_s, time_s[known], mean[known]) if known.any() else np.zeros(len(run))
    lagged = np.asarray(lfilter([share], [1.0, share - 1.0], filled, zi=(1.0 - share) * filled[:1])[0])
    return mean, slope, mean - lagged
