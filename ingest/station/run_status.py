"""The status of a run at a station."""

from collections.abc import Sequence

from ingest.procedures.plan import PlannedStep
from ingest.station.operator_console import ConsoleOperator
from ingest.station.run_limits import LimitReport, listed
from ingest.station.run_log import RunLog
from ingest.station.station import Station
from ingest.station_clock import StationClock
from stream.delivery.publisher import DurablePublisher
from stream.status.role_status import Role, RoleState, RoleStatus, RunProgress, new_status


def run_status(
    log: RunLog, steps: Sequence[PlannedStep], station: Station, clock: StationClock, operator: ConsoleOperator,
    decisions: LimitReport, publisher: DurablePublisher, began_ns: int, left: Sequence[str] = (),
) -> RoleStatus:  # fmt: skip
    """How far a run is, and what keeps its samples from being recorded; `left` says why it was left before its end."""
    state, paused = log.state, publisher.paused
    silent = log.coverage.silent(clock.speed)
    pause = f"the recorder pauses: {paused}" if paused else ""
    trouble = "; ".join(left) or publisher.warning or pause or decisions.silence or "; ".join(log.faults)
    if silent and not trouble:
        trouble = f"nothing has come for {max(silent.values()):,.0f} s from {listed(list(silent))}"
    forecast_s = decisions.forecast_s()
    progress = RunProgress(
        run=state.run, procedure=state.procedure, units=state.units, step=min(state.step + 1, len(steps)),
        steps=len(steps), doing=operator.doing, left_s=clock.computer_s(operator.left_s),
        decided_at_s=None if forecast_s is None else clock.computer_s(forecast_s),
        verdicts=decisions.so_far(), undecided=decisions.undecided(),
        released={unit: each.verdict.value for unit, each in state.released.items()}, saved_s=log.saved_s,
    )  # fmt: skip
    numbers = {
        "samples_total": float(log.samples), "short_records_total": float(state.short_records),
        **publisher.numbers,
    }  # fmt: skip
    is_paused = operator.is_paused or bool(paused)
    at_work = RoleState.PAUSED if is_paused else RoleState.WORKING
    return new_status(
        Role.RUN, began_ns, name=station.table.name, state=RoleState.INTERRUPTED if left else at_work,
        trouble=trouble, numbers=numbers, run=progress,
    )  # fmt: skip
