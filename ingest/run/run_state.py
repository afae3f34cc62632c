"""How far a run of simulated units is: one small file beside its spool, there whole or not at all."""

from pathlib import Path

import msgspec

from ingest.moment import moment_ns
from ingest.run_record import Outcome, Phase
from ingest.simulator.station import PowerCycle
from ingest.state_file import read_state
from stream.errors import BadInput

RUN_FILE = "run.json"
_FORMAT = 1


class RunParameters(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a run was started with; `speed` 0 is as fast as possible, `start` the moment of its first samples."""

    simulate: int
    rate_hz: float
    batch: int
    hours: float
    speed: float
    seed: int
    site: str
    station: str
    procedure: str | None = None
    position: str | None = None
    operator: str | None = None
    lot: str | None = None
    start: str | None = None


class RunState(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A run as it stands.

    Parameters
    ----------
    run: Its id.
    parameters: What it was started with.
    began_ns: The station's clock when it was started.
    t0_ns: Time of its first sample.
    starts: How many processes have worked on it.
    power_cycles: The power-ons of its units so far.
    phase, outcome: How far it is, and how it ended.
    """

    format: int = _FORMAT
    run: str
    parameters: RunParameters
    began_ns: int
    t0_ns: int
    starts: int = 1
    power_cycles: tuple[PowerCycle, ...] = msgspec.field(name="power_ups")  # as written by earlier versions
    phase: Phase = "starting"
    outcome: Outcome = "completed"


def begin_run(run: str, parameters: RunParameters, now_ns: int) -> RunState:
    """A run that starts now; without `start`, no sample of it lies in the future when it is sent.

    Raises
    ------
    BadInput: If `start` cannot be read.

    Examples
    --------
    >>> parameters = RunParameters(
    ...     simulate=1, rate_hz=1.0, batch=1, hours=1.0, speed=2.0, seed=1, site="local", station="simulated")
    >>> begin_run("r1", parameters, 3600 * 10**9).t0_ns / 1e9
    1800.0
    """
    duration_ns = round(parameters.hours * 3600e9)
    lasts_ns = round(duration_ns / parameters.speed) if parameters.speed else 0
    t0_ns = now_ns - max(0, duration_ns - lasts_ns) if parameters.start is None else moment_ns(parameters.start)
    return RunState(run=run, parameters=parameters, began_ns=now_ns, t0_ns=t0_ns, power_cycles=(PowerCycle(0, t0_ns),))


def read_run(folder: Path, run: str, parameters: RunParameters) -> RunState | None:
    """The run that is kept in a folder; None where there is none.

    Raises
    ------
    BadInput: If it was started with other parameters, or the folder is that of another run.
    StoreError: If it cannot be read.
    """
    state = read_state(folder / RUN_FILE, RunState)
    if state is None:
        return None
    if state.run != run:
        raise BadInput(f"{folder} is the spool of run {state.run}, not of {run}: give --spool another folder")
    others = [
        f"--{name.replace('_', '-')} was {was!r}, now {getattr(parameters, name)!r}"
        for name, was in msgspec.structs.asdict(state.parameters).items()
        if was != getattr(parameters, name)
    ]
    if others:
        raise BadInput(
            f"run {state.run} was started with other options: {'; '.join(others)}; give the same command again, or "
            "another --run"
        )
    return state
