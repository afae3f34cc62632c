"""Terms of an error model that can be subtracted from a signal during its run."""

import functools

import msgspec
import numpy as np

from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from analytics.loop.effects.registry import effect
from analytics.loop.model.error_model import ErrorModel, ModelTerm
from analytics.loop.model.model_text import BIAS
from stream.batch import FloatArray
from stream.decoding import decode_json
from stream.errors import BadInput, GyrofleetError

LIVE_BLOCK_S = 5.0  # blocks on which terms are evaluated, seconds; they are interpolated between the middles
LOOK_AHEAD_BLOCKS = 13  # blocks after which the value of a term must be final: a slope is taken over 60 s to both sides
TIME_SINCE_POWER_ON = "time_since_power_on"

_NOT_SUBTRACTED = (BIAS, "scale_factor")
_NOT_LIVE = {
    "table_angle": f"it moves within blocks of {LIVE_BLOCK_S:g} s",
    "table_acceleration": "it is derived once a run is recorded",
    "position": "it is known from a run's steps once they are recorded",
    "day": "it counts from the unit's first day in the store",
}
_PROBE_BLOCKS = 240


def live_part(model: ErrorModel) -> ErrorModel:
    """The terms that are subtracted, with their coefficients: all but the bias and the scale factor.

    Those two belong to the gyro's own calibration and are what its tests measure; temperatures are relative to 25 degC,
    so that the remaining bias is that at 25 degC.

    >>> model = ErrorModel.parse("rate = bias + scale_factor*input_rate + temperature").fitted([3.0, 0.1, 0.25])
    >>> str(live_part(model)), live_part(model).coefficients
    ('rate = temperature', (0.25,))
    """
    terms: list[ModelTerm] = []
    coefficients: list[float] = []
    at = 0
    for term in model.terms:
        width = len(term.labels())
        if term.name not in _NOT_SUBTRACTED:
            terms.append(term)
            coefficients.extend(model.coefficients[at : at + width])
        at += width
    return msgspec.structs.replace(
        model, terms=tuple(terms), coefficients=tuple(coefficients), units=(), covariance=(), noise={}
    )


def needed_channels(model: ErrorModel) -> tuple[str, ...]:
    """Channels that the terms need, each once."""
    return tuple(dict.fromkeys(name for term in model.terms for name in effect(term.name).needs))


def predicted(model: ErrorModel, run: RunBlocks) -> FloatArray:
    """Sum of the terms in each block; independent of the number of later blocks."""
    total = np.zeros(len(run))
    column = 0
    for term in model.terms:
        columns = term.columns(run)
        for at in range(columns.shape[1]):  # the rounding of a matrix product depends on the number of rows
            total = total + model.coefficients[column] * columns[:, at]
            column += 1
    return total


def check_live(unit: str, model: ErrorModel) -> None:
    """Refuse a model without a term to subtract, or with one that cannot be computed during a run."""
    part = live_part(model)
    if not part.terms:
        raise BadInput(
            f"unit {unit}: the error model '{model}' has nothing but bias and scale factor, which stay in the signal: "
            "there is nothing to compensate"
        )
    for term in part.terms:
        if (why := why_not_live(term)) is not None:
            raise BadInput(
                f"unit {unit}: term {term} of the error model cannot be computed during a run: {why}; put the "
                "model to use with --shadow, or leave the term out"
            )


def why_not_live(term: ModelTerm) -> str | None:
    """Why a term cannot be computed during a run; None where it can.

    >>> why_not_live(ModelTerm("temperature_rate"))
    >>> why_not_live(ModelTerm("ageing"))
    "channel day: it counts from the unit's first day in the store"
    """
    if effect(term.name).name.startswith("stale_"):
        return "it marks readings that repeat, which depends on the length of the blocks"
    for name in effect(term.name).needs:
        if name in _NOT_LIVE:
            return f"channel {name}: {_NOT_LIVE[name]}"
    key = msgspec.json.encode(term).decode()
    return None if _is_final(key) else "its value at a time depends on samples more than a minute later"


@functools.cache
def _is_final(encoded: str) -> bool:
    """Whether the values of a term, except the last ones, do not change when more blocks come."""
    term = decode_json(encoded, ModelTerm)
    whole = _probe(term, _PROBE_BLOCKS)
    half = _PROBE_BLOCKS // 2
    try:
        before, after = term.columns(whole.part(slice(half))), term.columns(whole)
    except GyrofleetError:
        return False
    stands = half - LOOK_AHEAD_BLOCKS
    return np.array_equal(before[:stands], after[:stands], equal_nan=True)


def _probe(term: ModelTerm, blocks: int) -> RunBlocks:
    rng = np.random.default_rng(1)
    units = {"temperature": "degC", "rate": "deg/s"}
    channels = {}
    for name in effect(term.name).needs:
        unit = next((each for word, each in units.items() if word in name), "1")
        channels[name] = Channel(20.0 + np.cumsum(rng.normal(0.0, 1.0, blocks)), np.zeros(blocks), unit)
    if TIME_SINCE_POWER_ON in channels:
        channels[TIME_SINCE_POWER_ON] = Channel(middles_s(blocks), np.zeros(blocks), "s")
    return live_blocks(("probe", "probe", "rate"), 0, "deg/h", channels, blocks)


def live_blocks(
    name: tuple[str, str, str], t0_ns: int, unit_of_measure: str, channels: dict[str, Channel], blocks: int
) -> RunBlocks:
    """Blocks of a run in progress, with its channels and no signal; `name` is unit, run and signal."""
    unit, run, signal = name
    nothing = np.zeros(blocks)
    return RunBlocks(
        unit, run, signal, np.arange(blocks), LIVE_BLOCK_S, t0_ns, nothing, np.ones(blocks, np.int64),
        np.full(blocks, np.nan), unit_of_measure, channels,
    )  # fmt: skip


def middles_s(blocks: int) -> FloatArray:
    """Middles of the first blocks, seconds from where the first begins."""
    return np.asarray((np.arange(blocks) + 0.5) * LIVE_BLOCK_S, dtype=np.float64)
