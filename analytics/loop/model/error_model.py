"""The error model of a gyro: named terms, their coefficients with covariance, and the remaining noise."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Self

import msgspec
import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.registry import effect
from analytics.loop.model.model_text import BIAS, ParsedTerm, parse_model, term_text
from stream.batch import FloatArray
from stream.decoding import decode_json
from stream.errors import BadInput

# names that people give to channels in their own language
_ALSO_NAMED = {"温度": "temperature", "temp": "temperature", "电压": "supply_voltage", "供电电压": "supply_voltage"}


def _remedy(channel: str, recorded: Collection[str]) -> str:
    """What to do about a channel that is missing; names differ by their letters alone, or are of another language.

    >>> _remedy("temperature", ["Temperature"]), _remedy("supply_voltage", ["temperature"])
    ('import Temperature under that name (--rename Temperature=temperature)', 'record it')
    """
    alike = [name for name in sorted(recorded) if channel in {name.lower(), _ALSO_NAMED.get(name.lower())}]
    return f"import {alike[0]} under that name (--rename {alike[0]}={channel})" if alike else "record it"


class ModelNoise(msgspec.Struct, frozen=True, omit_defaults=True):
    """Noise of a signal in its result unit u and hours; for deg/h the units in parentheses."""

    N: float  # white noise, u*sqrt(h) (angle random walk, deg/sqrt(h))
    B: float  # flicker: bias instability, u (deg/h); 0 where there is none
    K: float  # random walk, u/sqrt(h) (rate random walk, deg/h/sqrt(h)); 0 where there is none
    turn_on: float  # standard deviation of the bias from run to run, u (deg/h)
    most: tuple[float, float, float] | None = None  # N, B, K that the unit's own Allan fits allow, where they give it

    def parameters(self) -> dict[str, float]:
        """N, B, K and turn-on scatter by name."""
        return {"N": self.N, "B": self.B, "K": self.K, "turn_on": self.turn_on}


class ModelTerm(msgspec.Struct, frozen=True, omit_defaults=True):
    """One term: ``bias``, the constant, or the name of an effect with the values of its shape parameters.

    >>> str(ModelTerm("warm_up", {"time_constant": 1800.0})), str(ModelTerm("scale_factor"))
    ('warm_up(time_constant=1800)', 'scale_factor*input_rate')
    """

    name: str
    shape: dict[str, Any] = {}

    def __str__(self) -> str:
        return term_text(ParsedTerm(self.name, self.shape))

    def columns(self, run: RunBlocks) -> FloatArray:
        """Columns of the term in a run, shape (blocks, columns)."""
        if self.name == BIAS:
            return np.ones((len(run), 1))
        found = effect(self.name)
        missing = [channel for channel in found.needs if channel not in run.channels]
        if missing:
            raise BadInput(
                f"run {run.run}, unit {run.unit}: term {self} of the error model needs channel {', '.join(missing)}; "
                f"the run has {', '.join(sorted(run.channels)) or 'none'}: "
                f"{_remedy(missing[0], run.channels)}, or remove the term"
            )
        if not self.is_shaped():
            names = ", ".join(f"{parameter.name}=..." for parameter in found.parameters)
            raise BadInput(f"error model: {self.name} has no value of its parameters; write {self.name}({names})")
        return found.regressors(run, self.shape)

    def is_shaped(self) -> bool:
        """Whether the shape parameters have values, where the effect has any."""
        return self.name == BIAS or bool(self.shape) or not effect(self.name).parameters

    def labels(self) -> tuple[str, ...]:
        """Names of the columns."""
        if self.name == BIAS:
            return (BIAS,)
        return tuple(f"{self.name}[{each}]" if each else self.name for each in effect(self.name).columns(self.shape))


class ErrorModel(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A signal as a sum of terms, plus noise.

    Without coefficients the model is declared, with them it is fitted. `bias` is the constant; every other term is an
    effect and occurs at most once.

    >>> model = ErrorModel.parse("rate = bias + scale_factor*input_rate + temperature")
    >>> model.signal, [term.name for term in model.terms]
    ('rate', ['bias', 'scale_factor', 'temperature'])
    >>> str(model.with_term("warm_up", {"time_constant": 600.0}))
    'rate = bias + scale_factor*input_rate + temperature + warm_up(time_constant=600)'
    >>> ErrorModel.from_json(model.to_json()) == model
    True
    """

    terms: tuple[ModelTerm, ...]
    signal: str | None = None
    unit_of_measure: str | None = None  # of the prediction
    coefficients: tuple[float, ...] = ()  # one for each column; empty in a declared model
    units: tuple[str, ...] = ()
    covariance: tuple[tuple[float, ...], ...] = ()
    # left: {"N": 0.005, "B": 0.02, "K": 0.01, "turn_on": 0.3} in the units of `ModelNoise`
    noise: dict[str, float] = {}

    def __post_init__(self) -> None:
        """Check that the parts are consistent; models that come as JSON are validated here."""
        names = [str(term) for term in self.terms]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise BadInput(f"error model: {', '.join(twice)} occurs twice; name each term once")
        n = len(self.coefficients)
        if any(len(row) != len(self.covariance) for row in self.covariance) or len(self.covariance) not in (0, n):
            raise BadInput(f"error model: {n} coefficients, but a covariance of {len(self.covariance)} rows")
        if len(self.units) not in (0, n):
            raise BadInput(f"error model: {n} coefficients, but {len(self.units)} units of measure")

    @classmethod
    def parse(cls, text: str, channels: Collection[str] = ()) -> Self:
        """Read a model from text, see `parse_model`; other `channels` than the standard ones may be linear terms."""
        signal, parsed = parse_model(text, channels)
        return cls(signal=signal, terms=tuple(ModelTerm(each.name, dict(each.shape)) for each in parsed))

    @classmethod
    def from_json(cls, document: str | bytes) -> Self:
        """Read a model that `to_json` has written."""
        try:
            model = decode_json(document, cls)
        except msgspec.MsgspecError as error:
            raise BadInput(f"not an error model: {error}; write one with ErrorModel.to_json") from error
        if not model.terms:
            raise BadInput("not an error model: it has no term; write one with ErrorModel.to_json")
        model.labels()
        return model

    def to_json(self) -> str:
        """Return the model as JSON."""
        return msgspec.json.encode(self).decode()

    def __str__(self) -> str:
        right = " + ".join(map(str, self.terms))
        return right if self.signal is None else f"{self.signal} = {right}"

    @property
    def is_fitted(self) -> bool:
        """Whether it has coefficients."""
        return bool(self.coefficients)

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects among its terms."""
        return tuple(term.name for term in self.terms if term.name != BIAS)

    @property
    def errors(self) -> FloatArray:
        """Standard uncertainty of each coefficient; NaN where there is no covariance."""
        if not self.covariance:
            return np.full(len(self.coefficients), np.nan)
        return np.asarray(np.sqrt(np.diag(np.array(self.covariance))))

    def labels(self) -> tuple[str, ...]:
        """Names of the columns, such as ``temperature`` or ``table_angle_1[cos]``."""
        return tuple(label for term in self.terms for label in term.labels())

    def columns(self, run: RunBlocks) -> FloatArray:
        """Columns of the regression, shape (blocks, columns); NaN where a needed channel is NaN."""
        if not self.terms:
            return np.empty((len(run), 0))
        return np.column_stack([term.columns(run) for term in self.terms])

    def shaped(self, runs: Sequence[RunBlocks]) -> Self:
        """Return the model with shapes for the terms without one, by least squares, one term after the other."""
        terms = list(self.terms)
        for at, term in enumerate(terms):
            if term.is_shaped():
                continue
            others = [each for each in terms if each is not term and each.is_shaped()]
            tried = [ModelTerm(term.name, dict(shape)) for shape in effect(term.name).shapes(runs)]
            if not tried:
                raise BadInput(f"error model: {term.name} has no shape to try on these runs; give its parameters")
            terms[at] = min(tried, key=lambda each: _residual_squares(runs, [*others, each]))
        return msgspec.structs.replace(self, terms=tuple(terms))

    def predict(self, run: RunBlocks) -> FloatArray:
        """Prediction of the fitted model for each block; NaN where a needed channel is NaN."""
        if not self.is_fitted:
            raise BadInput(f"error model '{self}' has no coefficients yet: fit it first")
        if self.unit_of_measure not in (None, run.unit_of_measure):
            raise BadInput(
                f"run {run.run}, unit {run.unit}: the signal is in {run.unit_of_measure}, the error model was fitted "
                f"in {self.unit_of_measure}"
            )
        columns = self.columns(run)
        if columns.shape[1] != len(self.coefficients):
            count = len(self.coefficients)
            raise BadInput(f"error model '{self}': {count} coefficients for {columns.shape[1]} columns; fit it again")
        return np.asarray(columns @ np.array(self.coefficients))

    def residual(self, run: RunBlocks) -> FloatArray:
        """Signal minus prediction of each block."""
        return run.value - self.predict(run)

    def fitted(
        self,
        coefficients: Sequence[float] | FloatArray,
        covariance: Sequence[Sequence[float]] | FloatArray = (),
        *,
        unit_of_measure: str | None = None,
        units: Sequence[str] = (),
        noise: Mapping[str, float] | None = None,
    ) -> Self:
        """Return the model with its coefficients."""
        return msgspec.structs.replace(
            self,
            coefficients=tuple(float(each) for each in coefficients),
            covariance=tuple(tuple(float(each) for each in row) for row in covariance),
            unit_of_measure=unit_of_measure or self.unit_of_measure,
            units=tuple(units),
            noise=dict(self.noise if noise is None else noise),
        )

    def with_term(self, name: str, shape: Mapping[str, Any] | None = None) -> Self:
        """Return the model with one more term, to be fitted."""
        return msgspec.structs.replace(
            self, terms=(*self.terms, ModelTerm(name, dict(shape or {}))), coefficients=(), covariance=(), units=()
        )


def _residual_squares(runs: Sequence[RunBlocks], terms: Sequence[ModelTerm]) -> float:
    """Residual sum of squares of a least-squares fit with a constant for each run."""
    named = [term for term in terms if term.name != BIAS]
    blocks = [np.column_stack([run.value, *(term.columns(run) for term in named)]) for run in runs]
    blocks = [each[np.isfinite(each).all(axis=1)] for each in blocks]
    centred = np.vstack([each - each.mean(axis=0) if len(each) else each for each in blocks])
    y, x = centred[:, 0], centred[:, 1:]
    scale = np.sqrt(np.sum(x**2, axis=0))
    x = x / np.where(scale > 0, scale, 1.0)
    found, *_ = np.linalg.lstsq(x, y, rcond=None)
    return float(np.sum((y - x @ found) ** 2))
