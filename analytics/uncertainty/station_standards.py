"""What a run's station states of its measurement standards, as type B components (JCGM 100 4.3)."""

import datetime as dt
import json
import math
from collections.abc import Collection
from contextlib import suppress
from typing import Any, NamedTuple
from zoneinfo import ZoneInfo

from analytics.uncertainty.component import Component
from analytics.uncertainty.distribution import Distribution
from ingest.measurement_standards import QUANTITIES

NOT_STATED = "the station states none"


class StatedQuantity(NamedTuple):
    """Standard uncertainty of a quantity, in its unit, or why it is unknown."""

    u: float
    freedom: float
    reason: str = ""
    entry: dict[str, Any] | None = None  # as it stands in the log
    source: str = ""  # instrument, serial, certificate


class StationStandards:
    """The standards of a run.

    Parameters
    ----------
    text
        The detail `standards` of the run's documents; None if it has none.
    t_ns
        When the run began; None if that is unknown.
    time_zone
        Of the station.
    recorded_ns
        When the run was recorded; it began before that.

    Examples
    --------
    >>> entry = {"quantity": "rate", "stated": 100.0, "divisor": 2.0, "u": 50.0, "unit": "ppm"}
    >>> table = {"name": "table", "kind": "rate_table", "serial": "RT-17", "quantities": [entry]}
    >>> standards = StationStandards(json.dumps([table]), None)
    >>> standards.quantity("rate").u, standards.quantity("levelling").reason
    (50.0, 'the station states none')
    """

    def __init__(
        self, text: str | None, t_ns: int | None, time_zone: str | None = None, recorded_ns: int | None = None
    ) -> None:
        self.entries: list[dict[str, Any]] = []
        with suppress(json.JSONDecodeError, TypeError):  # of another program: nothing is stated
            found = json.loads(text or "[]")
            self.entries = [each for each in found if isinstance(each, dict)]
        self.day = None if t_ns is None else _day(t_ns, time_zone)
        self._recorded = None if recorded_ns is None else _day(recorded_ns, time_zone)

    def quantity(self, name: str) -> StatedQuantity:
        """What is stated of a quantity; of several standards the largest, unknown if any of them is out of date.

        The station does not say which of them was read.
        """
        expired = ""
        found: list[StatedQuantity] = []
        for standard in self.entries:
            for entry in standard.get("quantities", []):
                if entry.get("quantity") == name:
                    if (ended := self._ended(standard)) is not None:
                        expired = ended
                    else:
                        freedom = entry.get("freedom")
                        found.append(
                            StatedQuantity(
                                float(entry["u"]), math.inf if freedom is None else freedom, "", entry, _named(standard)
                            )
                        )
        if found and expired:
            expired += "; another standard of the station states it too: take out what was not used"
        if found and not expired:
            return max(found, key=lambda each: each.u)
        return StatedQuantity(math.nan, math.inf, expired or NOT_STATED)

    def _ended(self, standard: dict[str, Any]) -> str | None:
        """That the calibration of a standard had ended when the run began, or may have; None where it held."""
        due, last = standard.get("calibration_due"), self.day or self._recorded
        if not due or last is None or due >= last.isoformat():
            return None
        ended = f"the calibration of {_named(standard)} ended on {due}"
        return ended if self.day is not None else f"{ended}, and the date of the run is not known"


def worst(standards: Collection[StationStandards], name: str) -> StatedQuantity:
    """What is stated of a quantity by the standards of several runs: an unknown one, else the largest."""
    found = [each.quantity(name) for each in standards] or [StatedQuantity(math.nan, math.inf, NOT_STATED)]
    return max(found, key=lambda each: math.inf if each.reason else each.u)


def component(name: str, stated: StatedQuantity, sensitivity: float, unit: str) -> Component:
    """A known quantity as a component of the budget of a value in `unit`."""
    entry = stated.entry or {}
    quantity = QUANTITIES[name]
    return Component(
        en=quantity.en, zh=quantity.zh, evaluation="B", distribution=Distribution(entry.get("distribution", "normal")),
        stated=float(entry["stated"]), divisor=float(entry["divisor"]), unit=quantity.unit, sensitivity=sensitivity,
        sensitivity_unit=f"({unit})/{quantity.unit}", freedom=stated.freedom, source=stated.source,
    )  # fmt: skip


def _named(standard: dict[str, Any]) -> str:
    parts = [str(standard.get("name") or standard.get("kind") or "a standard")]
    parts += [f"serial {standard['serial']}"] if standard.get("serial") else []
    parts += [f"certificate {standard['certificate']}"] if standard.get("certificate") else []
    return ", ".join(parts)


def _day(t_ns: int, time_zone: str | None) -> dt.date:
    zone: dt.tzinfo = dt.UTC
    with suppress(ValueError, KeyError, OSError):
        zone = ZoneInfo(time_zone or "UTC")
    return dt.datetime.fromtimestamp(t_ns / 1e9, zone).date()
