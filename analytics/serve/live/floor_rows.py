"""The floor as rows of numbers: all of it, and what has changed, small enough for 10,000 units."""

import time
from collections import Counter, defaultdict
from collections.abc import Iterable
from typing import Any

from analytics.floor import Floor, RunNow, UnitNow
from stream.events import Verdict

VERDICTS = ("", *(each.value for each in Verdict))
UNIT_COLUMNS = ("number", "unit", "run", "slot", "product")
STATE_COLUMNS = ("number", "verdict", "early", "silent", "step", "left_s", "ratio", "last_s", "released")
_CODES = {word: code for code, word in enumerate(VERDICTS)}
_NS = 10**9


class FloorRows:
    """Rows of a floor; steps are numbered as they appear."""

    def __init__(self) -> None:
        self.version = 0
        self._steps: dict[str, int] = {"": 0}
        self._sent_steps = 1
        self._runs: set[str] = set()  # changed since they were sent

    def begin(self) -> None:
        """Begin a floor whose units have other numbers."""
        self.version += 1
        self._steps, self._sent_steps = {"": 0}, 1
        self._runs.clear()

    def document(self, floor: Floor) -> dict[str, Any]:
        """All of it; `columns` and `state_columns` name the cells of the rows.

        A unit's `state` has the code of its verdict so far in `verdicts`, whether early decisions gave it, whether it
        is silent, the number of its step in `steps`, the seconds left, the value nearest its limit divided by that
        limit, the second (since 1970) in which its last sample arrived (was measured, of a file), and whether it is
        released before the end of its run.
        """
        units = [unit for unit in floor.units.values() if not unit.is_instrument]
        states = [self._state(unit) for unit in units]
        return {
            "version": self.version,
            "time_ns": time.time_ns(),
            "verdicts": VERDICTS,
            "columns": UNIT_COLUMNS,
            "state_columns": STATE_COLUMNS,
            "steps": list(self._steps),
            "runs": runs_of(floor),
            "units": [unit_row(unit) for unit in units],
            "states": states,
        }

    def changes(self, floor: Floor, *, with_runs: bool = True) -> dict[str, Any] | None:
        """What has changed since the last time; None if nothing has.

        Rows of runs count their units and take milliseconds: without `with_runs` they are left to the next time.
        """
        fresh, changed = _tested(floor, floor.fresh), _tested(floor, floor.changed)
        self._runs |= floor.changed_runs | {unit.run.run for unit in changed}
        runs = self._runs if with_runs else set()
        if not (changed or fresh or floor.gone or runs):
            return None
        self.version += 1
        states = [self._state(unit) for unit in changed]
        names = list(self._steps)[self._sent_steps :]
        first, self._sent_steps = self._sent_steps, len(self._steps)
        changes = {
            "version": self.version,
            "time_ns": time.time_ns(),
            "steps": {first + at: name for at, name in enumerate(names)},
            "runs": runs_of(floor, runs) if runs else [],
            "units": [unit_row(unit) for unit in fresh],
            "states": states,
            "gone": list(floor.gone),
        }
        runs.clear()
        return changes

    def _state(self, unit: UnitNow) -> list[int | float | None]:
        early = unit.decided_early if not unit.verdict else ""
        step = self._steps.setdefault(unit.step, len(self._steps))
        worst, left_s = unit.worst, unit.left_s
        ratio = None if worst is None or worst.value is None else float(f"{worst.value / worst.limit.upper:.3g}")
        return [
            unit.number,
            _CODES.get(unit.verdict or early, 0),
            int(bool(early)),
            int(unit.is_silent),
            step,
            None if left_s is None else round(left_s),
            ratio,
            unit.last_ns // _NS,
            int(unit.released is not None),
        ]


def _tested(floor: Floor, names: Iterable[str]) -> list[UnitNow]:
    """Those of the units that are on the floor, without instruments of the station."""
    found = (floor.units[name] for name in names if name in floor.units)
    return [unit for unit in found if not unit.is_instrument]


def unit_row(unit: UnitNow) -> list[int | str | None]:
    """What seldom changes of a unit."""
    return [unit.number, unit.unit, unit.run.run, unit.slot, unit.product]


def runs_of(floor: Floor, wanted: set[str] | None = None) -> list[dict[str, Any]]:
    """Runs on the floor with their units by verdict, silent ones, and the longest time left."""
    verdicts: defaultdict[str, Counter[str]] = defaultdict(Counter)
    silent: Counter[str] = Counter()
    released: Counter[str] = Counter()
    saved_s: Counter[str] = Counter()
    left: defaultdict[str, list[float]] = defaultdict(list)
    for unit in floor.units.values():
        run = unit.run.run
        if (wanted is not None and run not in wanted) or unit.is_instrument:
            continue
        verdicts[run][unit.so_far] += 1
        silent[run] += unit.is_silent
        if unit.released is not None:
            released[run] += 1
            saved_s[run] += round(unit.released.planned_s - unit.released.recorded_s)
        if (left_s := unit.left_s) is not None:
            left[run].append(left_s)
    runs = [run for name, run in floor.runs.items() if wanted is None or name in wanted]
    return [
        _run_row(run, verdicts[run.run], left[run.run])
        | {"silent": silent[run.run], "released": released[run.run], "saved_s": saved_s[run.run]}
        for run in runs
    ]


def _run_row(run: RunNow, verdicts: Counter[str], left: list[float]) -> dict[str, Any]:
    return {
        "run": run.run,
        "site": run.place.site,
        "station": run.place.station,
        "procedure": run.procedure,
        "operator": run.operator,
        "lot": run.lot,
        "started_ns": run.started_ns if run.date_known else None,
        "outcome": run.outcome,
        "resumptions": run.resumptions,
        "planned_s": run.planned_s,
        "left_s": round(max(left)) if left else None,
        "units": sum(verdicts.values()),
        "time_zone": run.time_zone,
        "verdicts": dict(sorted(verdicts.items())),
    }
