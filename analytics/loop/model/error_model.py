"""The error model of a gyro: named terms, their coefficients with covariance, and the noise that is left."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Self

import msgspec
import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.coefficient_units import coefficient_unit
from analytics.loop.effects.registry import effect
from analytics.loop.model.model_text import BIAS, ParsedTerm, parse_model, term_text
from stream.batch import FloatArray
from stream.errors import BadInput


class ModelTerm(msgspec.Struct, frozen=True, omit_defaults=True):
    """One term: ``bias``, the constant, or the name of an effect with the values of its shape parameters.

    Examples
    --------
    >>> str(ModelTerm("warm_up", {"time_constant": 1800.0})), str(ModelTerm("scale_factor"))
    ('warm_up(time_constant=1800)', 'scale_factor*input_rate')
    """

    name: str
    shape: dict[str, Any] = {}

    def __str__(self) -> str:
        return term_text(ParsedTerm(self.name, self.shape))

    def columns(self, run: RunBlocks) -> FloatArray:
        """Columns of the term in a run, shape (blocks, columns).

        Raises
        ------
        BadInput: If the run lacks a channel that the effect needs.
        """
        if self.name == BIAS:
            return np.ones((len(run), 1))
        found = effect(self.name)
        missing = [channel for channel in found.needs if channel not in run.channels]
        if missing:
            raise BadInput(
                f"run {run.run}, unit {run.unit}: term {self} of the error model needs channel {', '.join(missing)}; "
                f"the run has {', '.join(sorted(run.channels)) or 'none'}: record it, or take the term out"
            )
        if not self.is_shaped():
            names = ", ".join(f"{parameter.name}=..." for parameter in found.parameters)
            raise BadInput(
                f"error model: {self.name} has no value of its parameters; write {self.name}({names}), or let "
                f"ErrorModel.shaped find them"
            )
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
    """What a signal is made of, beside noise: a sum of terms.

    Without coefficients it is declared, with them it is fitted. `bias` is the constant; every other term is an effect.

    Parameters
    ----------
    terms: Each at most once.
    signal: Name of the signal that it is a model of.
    unit_of_measure: Of what it predicts.
    coefficients: One for each column; empty while the model is only declared.
    units: Units of measure of the coefficients.
    covariance: Of the coefficients.
    noise: What is left, such as ``{"N": 0.005, "B": 0.02, "K": 0.01, "turn_on": 0.3}`` in deg/sqrt(h), deg/h,
        deg/h/sqrt(h), deg/h.

    Examples
    --------
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
    unit_of_measure: str | None = None
    coefficients: tuple[float, ...] = ()
    units: tuple[str, ...] = ()
    covariance: tuple[tuple[float, ...], ...] = ()
    noise: dict[str, float] = {}

    def __post_init__(self) -> None:
        """Check that the parts fit together; this is the border for models that come as JSON."""
        names = [str(term) for term in self.terms]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise BadInput(f"error model: {', '.join(twice)} is there twice; name each term once")
        n = len(self.coefficients)
        if any(len(row) != len(self.covariance) for row in self.covariance) or len(self.covariance) not in (0, n):
            raise BadInput(f"error model: {n} coefficients, but a covariance of {len(self.covariance)} rows")
        if len(self.units) not in (0, n):
            raise BadInput(f"error model: {n} coefficients, but {len(self.units)} units of measure")

    @classmethod
    def parse(cls, text: str, channels: Collection[str] = ()) -> Self:
        """Read a model from text: terms joined by ``+``; what stands before ``=`` is the signal.

        Parameters
        ----------
        text: Such as ``rate = bias + scale_factor*input_rate + warm_up(time_constant=1800)``.
        channels: Names of channels that may stand as linear terms of their own.

        Raises
        ------
        BadInput: If a term is not known; the message names those that look alike.
        """
        signal, parsed = parse_model(text, channels)
        return cls(signal=signal, terms=tuple(ModelTerm(each.name, dict(each.shape)) for each in parsed))

    @classmethod
    def from_json(cls, document: str | bytes) -> Self:
        """Read a model that `to_json` has written.

        Raises
        ------
        BadInput: If it is not one, or has terms that this gyrofleet does not know.
        """
        try:
            model = msgspec.json.decode(document, type=cls)
        except msgspec.MsgspecError as error:
            raise BadInput(f"not an error model: {error}; write one with ErrorModel.to_json") from error
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
    def has_bias(self) -> bool:
        """Whether a constant is among its terms."""
        return any(term.name == BIAS for term in self.terms)

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
        """Columns of the regression in a run, shape (blocks, columns); NaN where a channel that is needed is NaN."""
        if not self.terms:
            return np.empty((len(run), 0))
        return np.column_stack([term.columns(run) for term in self.terms])

    def coefficient_units(self, run: RunBlocks) -> tuple[str, ...]:
        """Unit of measure of each coefficient, for the signal and the channels of a run."""
        return tuple(
            run.unit_of_measure if term.name == BIAS else coefficient_unit(effect(term.name), run.unit_of_measure, run)
            for term in self.terms
            for _ in term.labels()
        )

    def shaped(self, runs: Sequence[RunBlocks]) -> Self:
        """Return the model with shapes for the terms that have none yet: those that leave the least residual.

        By least squares, of the shapes that each effect itself proposes for these runs, one term after the other.
        """
        terms = list(self.terms)
        for at, term in enumerate(terms):
            if term.is_shaped():
                continue
            others = [each for each in terms if each is not term and each.is_shaped()]
            tried = [ModelTerm(term.name, dict(shape)) for shape in effect(term.name).shapes(runs)]
            if not tried:
                raise BadInput(f"error model: {term.name} has no shape to try on these runs; give its parameters")
            terms[at] = min(tried, key=lambda each: _left(runs, [*others, each]))
        return msgspec.structs.replace(self, terms=tuple(terms))

    def predict(self, run: RunBlocks) -> FloatArray:
        """What the fitted model says of each block, in `unit_of_measure`; NaN where a channel that is needed is NaN.

        Raises
        ------
        BadInput: If the model has no coefficients, or is of another unit of measure than the run.
        """
        if not self.is_fitted:
            raise BadInput(f"error model '{self}' has no coefficients yet: fit it first")
        if self.unit_of_measure not in (None, run.unit_of_measure):
            raise BadInput(
                f"run {run.run}, unit {run.unit}: the signal is in {run.unit_of_measure}, the error model was fitted "
                f"in {self.unit_of_measure}"
            )
        columns = self.columns(run)
        if columns.shape[1] != len(self.coefficients):
            raise BadInput(
                f"error model '{self}': {len(self.coefficients)} coefficients for {columns.shape[1]} columns; fit anew"
            )
        return np.asarray(columns @ np.array(self.coefficients))

    def residual(self, run: RunBlocks) -> FloatArray:
        """What the fitted model leaves of each block."""
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

    def without_term(self, name: str) -> Self:
        """Return the model without the terms of an effect, to be fitted."""
        return msgspec.structs.replace(
            self,
            terms=tuple(term for term in self.terms if term.name != name),
            coefficients=(),
            covariance=(),
            units=(),
        )


def _left(runs: Sequence[RunBlocks], terms: Sequence[ModelTerm]) -> float:
    """Sum of squares that least squares leaves, with a constant for each run."""
    columns, values = [], []
    for run in runs:
        block = np.column_stack([run.value, *(term.columns(run) for term in terms if term.name != BIAS)])
        block = block[np.isfinite(block).all(axis=1)]
        if len(block):
            block = block - block.mean(axis=0)
        values.append(block[:, 0])
        columns.append(block[:, 1:])
    x, y = np.vstack(columns), np.concatenate(values)
    scale = np.sqrt(np.sum(x**2, axis=0))
    x = x / np.where(scale > 0, scale, 1.0)
    found, *_ = np.linalg.lstsq(x, y, rcond=None)
    return float(np.sum((y - x @ found) ** 2))
