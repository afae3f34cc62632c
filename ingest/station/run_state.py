"""How far a procedure's run at a station is: one small file, there whole or not at all."""

import datetime as dt
import string
from collections.abc import Iterator
from pathlib import Path

import msgspec

from ingest.run_record import Outcome, Phase, read_state
from stream.errors import BadInput

STATE_FILE = "procedure.json"


class StationRunState(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A procedure's run as it stands."""

    format: int = 1
    run: str  # its id
    procedure: str
    plan: str  # SHA-256 of its steps as they were planned
    units: tuple[str, ...]  # serial numbers
    t0_ns: int  # the station's clock when it started
    seen_ns: int  # the station's clock when it was last seen going on
    starts: int = 1  # how many processes have worked on it
    phase: Phase = "starting"
    outcome: Outcome = "completed"
    step: int = 0  # index of the step that is worked on
    open_steps: dict[str, str] = {}  # identity of the document of the step that is being recorded, by unit
    epochs: dict[str, str] = {}  # epoch of every unit's power-on by unit; none for one that is off
    steps_done: int = 0
    is_powered: bool = False  # whether the units have power
    powered_ns: int = 0  # since when
    closed_steps: dict[str, str] = {}  # identity of the document of the last step, by unit; sent again after a crash
    closed_as: str = ""  # how it ended
    closed_ns: int = 0  # when it ended
    short_records: int = 0  # records of a unit in a step that lack samples


def read_station_run(folder: Path) -> StationRunState | None:
    """The run that is kept in a folder; None where there is none. Raises StoreError if it cannot be read."""
    return read_state(folder / STATE_FILE, StationRunState)


def check_same(state: StationRunState, procedure: str, plan: str, units: tuple[str, ...]) -> None:
    """Raise BadInput where a run that is to be resumed was started as another one."""
    if state.procedure != procedure:
        raise BadInput(f"run {state.run} is one of procedure {state.procedure}, not {procedure}: give another --run")
    if set(state.units) != set(units):
        added, gone = sorted(set(units) - set(state.units)), sorted(set(state.units) - set(units))
        raise BadInput(
            f"run {state.run} was started with other units (new now: {', '.join(added) or 'none'}; gone: "
            f"{', '.join(gone) or 'none'}): give the same --units, or another --run"
        )
    if state.plan != plan:
        raise BadInput(
            f"run {state.run} was started with other steps of {procedure}: give the same --set and the same file, or "
            f"another --run"
        )


def unfinished_runs(spool: Path) -> list[StationRunState]:
    """Runs of procedures in a store's spool that have not ended, in the order of their start."""
    found = [read_station_run(path.parent) for path in sorted(spool.glob(f"*/{STATE_FILE}"))]
    return sorted((each for each in found if each is not None and each.phase != "ended"), key=lambda each: each.t0_ns)


def left_run(spools: Path, procedure: str, units: tuple[str, ...]) -> str | None:
    """The run of this procedure and these units that is to be resumed; None where there is none."""
    wanted = [each for each in unfinished_runs(spools) if each.procedure == procedure and set(each.units) == set(units)]
    return wanted[0].run if wanted else None


def other_unfinished(spools: Path, procedure: str, run: str) -> Iterator[str]:
    """A warning for each run of this procedure that was left unfinished with other units."""
    for state in unfinished_runs(spools):
        if state.procedure == procedure and state.run != run:
            units = f"{', '.join(state.units[:4])}{' and others' if len(state.units) > 4 else ''}"
            yield (
                f"warning: run {state.run} of {units} was left unfinished at step {state.step + 1}; give its --units "
                "to resume it, with --end to end it"
            )


def fresh_id(spools: Path, procedure: str, day: dt.date) -> str:
    """A run's id: the day, the procedure and a letter."""
    letters = string.ascii_uppercase
    for n in range(26 * 26):
        name = f"{day}-{procedure}-{letters[n // 26 - 1] if n >= 26 else ''}{letters[n % 26]}"
        if not any((spools / name).glob("*.json")):  # a run was begun there
            return name
    raise BadInput(f"there are {26 * 26} runs of {procedure} on {day}: give this one a name with --run")
