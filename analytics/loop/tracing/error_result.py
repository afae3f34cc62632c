"""The error before and after, beside what noise leaves of it; JSON."""

from typing import Any

import msgspec


class ErrorGain(msgspec.Struct, frozen=True):
    """Share of the squared error that the model found takes away, with its 95 % limits over runs.

    Parameters
    ----------
    fraction: 1 - MSE after / MSE before; less than 0 where the error rises.
    lo, hi: Limits, the runs being the sample; None of one run.
    runs: How many runs there are.
    """

    fraction: float
    lo: float | None
    hi: float | None
    runs: int

    @property
    def is_significant(self) -> bool:
        """Whether the error falls by more than chance."""
        return self.lo is not None and self.lo > 0

    @property
    def is_loss(self) -> bool:
        """Whether the error rises by more than chance."""
        return self.hi is not None and self.hi < 0


class ErrorAt(msgspec.Struct, frozen=True):
    """RMS of the residual averaged over a time, in the signal's unit.

    Parameters
    ----------
    averaging_s: Seconds.
    before, after: With the declared model and with the model found, coefficients from the training runs.
    floor: What the fitted noise alone would leave, the error of the estimated declared coefficients included.
    excited_before, excited_after: The same over the averages in which the effect is excited; None without an effect.
    averages: How many averages there are.
    before_within, after_within, floor_within: The same with the mean of each run taken off, so that turn-on scatter is
        in none of them; the floor is what the fitted noise without turn-on scatter leaves.
    gain, gain_within: Of the raw error and of that within the runs; None where nothing was found.
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
    """The error before and after, beside the floor that noise sets.

    Parameters
    ----------
    runs: Where it was measured.
    is_held_out: Whether those runs took no part in the fit.
    unit_of_measure: Of the RMS values.
    rows: For the block and for 300, 1800 and 3600 s, as far as runs are long enough.
    achievable_fraction: (MSE before - MSE after) / (MSE before - MSE floor) at 1800 s; None where nothing was found or
        nothing is above the floor.
    achievable_fraction_excited: The same over averages in which the effect is excited.
    """

    runs: tuple[str, ...]
    is_held_out: bool
    unit_of_measure: str
    rows: tuple[ErrorAt, ...]
    achievable_fraction: float | None = None
    achievable_fraction_excited: float | None = None

    def document(self) -> dict[str, Any]:
        """Return it as it stands in JSON."""
        parts = {
            part: {f"rms_{row.averaging_s:g}s": getattr(row, part) for row in self.rows}
            for part in ("before", "after", "floor", "before_within", "after_within", "floor_within")
        }
        gains = {
            part: {f"rms_{row.averaging_s:g}s": _gain(getattr(row, part)) for row in self.rows}
            for part in ("gain", "gain_within")
        }
        return {
            **parts,
            **gains,
            "achievable_fraction": self.achievable_fraction,
            "achievable_fraction_excited": self.achievable_fraction_excited,
            "unit_of_measure": self.unit_of_measure,
            "runs": list(self.runs),
            "held_out": self.is_held_out,
        }


def _gain(gain: ErrorGain | None) -> dict[str, Any] | None:
    if gain is None:
        return None
    return {**msgspec.to_builtins(gain), "significant": gain.is_significant}
