"""A run that only the log has so far, as far as its documents and samples tell."""

from analytics.serve.api.operation import Call, Nothing
from analytics.serve.api.rows import iso
from analytics.serve.api.run_course import run_course
from analytics.serve.api.runs import RunDocument, RunRow, RunUnit
from stream.errors import NotFound
from stream.events import RunResumed, RunStarted


def fresh_run(call: Call, name: str) -> RunDocument:
    """A run that the lake does not have yet; NotFound if the log has none either."""
    heard = call.service.live.course.heard(name, call.state.segments)
    started = next((each for each in heard if isinstance(each.document, RunStarted)), None)
    if started is None or not isinstance(started.document, RunStarted):
        raise NotFound(f"run {name!r} is not in the store; /api/runs lists them")
    document, course = started.document, run_course(call, Nothing())
    resumed = [each.document for each in heard if isinstance(each.document, RunResumed)]
    channels = call.service.live.tail.channels(name)
    row = RunRow(
        run=name, site=started.place.site, station=started.place.station, date_known=document.date_known,
        started_ns=document.t_ns if document.date_known else None, ended_ns=None, duration_s=None,
        outcome=course.outcome, resumptions=len(resumed), gap_s=sum(each.gap_ns for each in resumed) / 1e9,
        units=len(document.units), signals=len(channels), samples=0, procedure=document.procedure,
        operator=document.operator, lot=document.lot, simulated=document.simulated, source=document.source,
        recorded_ns=started.arrival_ns, started=iso(document.t_ns) if document.date_known else None,
    )  # fmt: skip
    units = [
        RunUnit(
            unit=unit, product=None, lot=None, slot=None, fixture=None,
            signals=sorted(signal for each, signal in channels if each == unit), samples=0, t_last_ns=None,
            arrival_last_ns=None, verdict=None, early=None,
        )
        for unit in sorted({*document.units, *(unit for unit, _ in channels)})[:200]
    ]  # fmt: skip
    return RunDocument(run=row, steps=[], documents=[], units=units, verdicts={}, next=None)
