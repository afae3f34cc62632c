"""The error before and after, beside the error that noise leaves."""

from typing import Any

import msgspec

REFERENCE_S = 1800.0
"""Averaging time at which errors are compared, if the runs are long enough."""
_PARTS = ("before", "after", "floor", "before_within", "after_within", "floor_within")


class ErrorGain(msgspec.Struct, frozen=True):
    """Relative decrease of the squared error, with its 95 % confidence bounds over runs.

    Parameters
    ----------
    fraction: 1 - MSE after / MSE before; negative if the error rises.
    lo, hi: Bounds; None for a single run.
    """

    fraction: float
    lo: float | None
    hi: float | None
    runs: int

    @property
    def is_significant(self) -> bool:
        """Whether the error falls significantly."""
        return self.lo is not None and self.lo > 0

    @property
    def is_loss(self) -> bool:
        """Whether the error rises significantly."""
        return self.hi is not None and self.hi < 0


class ErrorAt(msgspec.Struct, frozen=True):
    """RMS of the residual at one averaging time, in the signal's unit.

    Parameters
    ----------
    before, after: With the declared model and with the model found; coefficients from the training runs.
    floor: Left by the fitted noise alone, including the error of the declared coefficients.
    averages: Number of averages.
    excited_before, excited_after, excited_floor: The same over averages that excite the effect.
    before_within, after_within, floor_within: The same about the mean of each run, without turn-on scatter.
    gain, gain_within: Of the raw error and of the error within runs; None if nothing was found.
    """

    averaging_s: float
    before: float
    after: float
    floor: float
    averages: int
    excited_before: float | None = None
    excited_after: float | None = None
    excited_floor: float | None = None
    before_within: float = 0.0
    after_within: float = 0.0
    floor_within: float = 0.0
    gain: ErrorGain | None = None
    gain_within: ErrorGain | None = None


class ErrorTable(msgspec.Struct, frozen=True):
    """The error before and after at several averaging times.

    Parameters
    ----------
    runs, is_held_out: The runs, and whether they were held out of the fit.
    rows: For the block and for 300, 1800 and 3600 s, as far as the runs are long enough.
    achievable_fraction: (MSE before - MSE after) / (MSE before - MSE floor) at 1800 s; None if nothing was found or
        nothing exceeds the floor.
    achievable_fraction_excited: The same over averages that excite the effect.
    """

    runs: tuple[str, ...]
    is_held_out: bool
    unit_of_measure: str
    rows: tuple[ErrorAt, ...]
    achievable_fraction: float | None = None
    achievable_fraction_excited: float | None = None

    @property
    def reference(self) -> ErrorAt | None:
        """The errors at 1800 s, or at the longest shorter averaging time with several averages in a run."""
        rows = [row for row in self.rows if row.averaging_s <= REFERENCE_S]
        rows = [row for row in rows if row.before_within > 0] or rows
        return max(rows, key=lambda row: row.averaging_s, default=None)

    def document(self) -> dict[str, Any]:
        """JSON form."""
        by_time = {f"rms_{row.averaging_s:g}s": row for row in self.rows}
        return {
            **{part: {key: getattr(row, part) for key, row in by_time.items()} for part in _PARTS},
            "gain": {key: _gain(row.gain) for key, row in by_time.items()},
            "gain_within": {key: _gain(row.gain_within) for key, row in by_time.items()},
            "achievable_fraction": self.achievable_fraction,
            "achievable_fraction_excited": self.achievable_fraction_excited,
            "unit_of_measure": self.unit_of_measure,
            "runs": list(self.runs),
            "held_out": self.is_held_out,
        }


def _gain(gain: ErrorGain | None) -> dict[str, Any] | None:
    return None if gain is None else {**msgspec.to_builtins(gain), "significant": gain.is_significant}
