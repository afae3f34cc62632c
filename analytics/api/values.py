"""Values given as arrays: one row of numbers, at the rate that is stated with them."""

import math
import sys
from collections.abc import Iterable, Iterator
from numbers import Real
from typing import Any

import numpy as np
import numpy.typing as npt

from stream.batch import FloatArray
from stream.bounds import MAX_INTERVAL_NS
from stream.errors import BadInput

_EXACT = 2.0**53  # all integers below are floats
_OFF_GRID = 0.5  # of an interval
_OFF_RATE = 1e-3  # of the samples, over a whole index
_TOO_LARGE = "values are integers from 2**53 on, which floats round: give them less an offset, as x - x[0]"
_TRUTHS = "true and false"
_NO_NUMBERS = {
    "M": "times", "m": "durations", "b": _TRUTHS, "U": "texts", "S": "texts",
    "V": "records of fields (give one field, as values['rate'])",
}  # fmt: skip
_MOMENTS = {"datetime", "datetime64", "date"}
_DURATIONS = {"timedelta", "timedelta64"}


def check_index(values: object, rate_hz: float) -> None:
    """BadInput where a series of pandas has times that are not `rate_hz` apart: its values alone would not show it."""
    for times in _times_of(getattr(values, "index", None)):
        _check_times(times, rate_hz)


def _times_of(index: Any) -> Iterator[npt.NDArray[Any]]:
    """Times and durations in the index of a series of pandas, of each of its levels, without zones."""
    if getattr(index, "nlevels", 1) > 1:
        for level in range(index.nlevels):
            yield from _times_of(index.get_level_values(level))
        return
    kind = getattr(index, "inferred_type", "")
    pandas: Any = sys.modules.get("pandas")
    if kind == "categorical":
        yield from _times_of(index.astype(index.categories.dtype))
    elif kind in _MOMENTS:
        yield np.asarray(pandas.DatetimeIndex(pandas.to_datetime(index, utc=True)).tz_convert(None))
    elif kind in _DURATIONS:
        yield np.asarray(pandas.TimedeltaIndex(pandas.to_timedelta(index)))
    elif kind == "period":
        yield np.asarray(pandas.PeriodIndex(index).to_timestamp())


def _check_times(times: npt.NDArray[Any], rate_hz: float) -> None:
    missing = np.flatnonzero(np.isnat(times))
    if missing.size:
        raise BadInput(
            f"the index has no time at sample {missing[0]} ({missing.size} in all): give it one, or the values alone "
            "(series.to_numpy())"
        )
    steps_s = np.diff(times).astype("timedelta64[ns]").astype(np.int64) / 1e9
    is_apart = np.isclose(steps_s * rate_hz, 1.0, rtol=0.0, atol=_OFF_GRID)
    if not is_apart.all():
        at = int(np.flatnonzero(~is_apart)[0])
        raise BadInput(
            f"the index has {steps_s[at]:g} s between samples {at} and {at + 1}, and rate_hz={rate_hz:g} says "
            f"{1.0 / rate_hz:g} s: sort it, fill what is missing with NaN (series.asfreq), or give the values alone "
            "(series.to_numpy())"
        )
    if not steps_s.size:
        return
    elapsed = float((times[-1] - times[0]).astype("timedelta64[ns]").astype(np.int64)) / 1e9 * rate_hz
    if abs(elapsed - steps_s.size) > max(_OFF_GRID, _OFF_RATE * steps_s.size):
        raise BadInput(
            f"the index has {steps_s.size / elapsed * rate_hz:.6g} samples a second on average, and rate_hz is "
            f"{rate_hz:g}: give its own rate, or the values alone (series.to_numpy())"
        )


def row_of(values: npt.ArrayLike) -> FloatArray:
    """One number a sample; BadInput for everything else."""
    if values is None:
        raise BadInput("values are nothing: one number a sample is expected")
    _refuse_truths(values if isinstance(values, list | tuple) else ())  # beside a number they become one
    if isinstance(values, np.ma.MaskedArray):
        values = np.ma.filled(values.astype(np.float64), np.nan)
    try:
        found = np.asarray(values)
    except ValueError:
        raise BadInput("values are rows of several lengths: one row of samples of one axis is expected") from None
    if np.iscomplexobj(found):
        raise BadInput("values are complex numbers: one real number a sample is expected")
    if found.dtype.kind == "O":
        _refuse_truths(found.flat)
    if (what := _NO_NUMBERS.get(found.dtype.kind)) or _holds(found, str):
        raise BadInput(f"values are {what or 'texts'}: one number a sample is expected")
    try:
        row = np.ascontiguousarray(found, np.float64)
    except OverflowError:  # an integer of more than 308 digits
        raise BadInput(_TOO_LARGE) from None
    except (TypeError, ValueError) as error:
        raise BadInput(f"values are not numbers: {error}") from None
    if (found.dtype.kind in "iu" or _holds(found, int)) and (np.abs(row) >= _EXACT).any():
        raise BadInput(_TOO_LARGE)
    if row.ndim != 1:
        raise BadInput(f"values have the shape {row.shape}: one row of samples of one axis is expected")
    infinite = np.flatnonzero(np.isinf(row))
    if infinite.size:
        raise BadInput(f"value {infinite[0]} is infinite ({infinite.size} in all): give NaN where a sample is missing")
    return row


def _refuse_truths(values: Iterable[object]) -> None:
    if {bool, np.bool} & set(map(type, values)):
        raise BadInput(f"values are {_TRUTHS}: one number a sample is expected")


def _holds(found: npt.NDArray[Any], kind: type) -> bool:
    return found.dtype.kind == "O" and any(isinstance(each, kind) for each in found.flat)


def rate_of(rate_hz: object) -> float:
    """The rate, an array of no dimension as its number."""
    given = rate_hz.item() if isinstance(rate_hz, np.ndarray) and rate_hz.ndim == 0 else rate_hz
    if isinstance(given, bool | np.bool) or not isinstance(given, Real):
        raise BadInput(f"rate_hz is {rate_hz!r}: a number of samples a second is expected")
    try:
        found = float(given)
    except OverflowError:  # an integer of more than 308 digits
        found = math.inf
    least = 1e9 / MAX_INTERVAL_NS
    if not least <= found <= 1e9:
        raise BadInput(f"rate_hz is {found:g}: samples a second are expected, from {least:.2g} to 1e9")
    return found
