"""The pages of runs: all of them, and one."""

from typing import Any

from analytics.serve.api.operation import Call, Nothing, link
from analytics.serve.api.rows import Name
from analytics.serve.api.run import runs as api
from analytics.serve.api.run.run_allan import MOST_UNITS, RunAllan, RunAllanAsked, run_allan
from analytics.serve.api.run.run_course import RunCourse, run_course
from analytics.serve.pages.frame.page import shown

_CHOICES = 200


class RunPageAsked(api.RunAsked, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Of which units the Allan deviation is shown, and of which signal."""

    show: tuple[Name, ...] = ()
    signal: Name = ""


@shown("/runs", "runs.html.jinja", shared_s=1.0)
def list_runs(call: Call, asked: api.RunsAsked) -> dict[str, Any]:
    """All runs."""
    found = api.list_runs(call, asked)
    next_page = None if found.next is None else found.next.removeprefix("/api")
    return {"found": found, "next": next_page, "data": f"/api{call.url}"}


@shown("/runs/{run}", "run.html.jinja", is_slow=True, shared_s=0.5)
def run(call: Call, asked: RunPageAsked) -> dict[str, Any]:
    """One run."""
    page = {name: getattr(asked, name) for name in ("unit", "limit", "after")}
    found = api.run(call, api.RunAsked(**page))
    course = run_course(call, Nothing())
    show = asked.show[:MOST_UNITS]
    curves = run_allan(call, RunAllanAsked(unit=show, signal=asked.signal))
    next_page = None if found.next is None else found.next.removeprefix("/api")
    return {
        "found": found, "next": next_page, "data": link("api", "runs", found.run.run), "course": course,
        "curves": curves, "too_many": len(asked.show) > MOST_UNITS, "most": MOST_UNITS,
        "choices": _choices(course, curves), "course_data": link("api", "runs", course.run, "course"),
        "allan_data": link("api", "runs", course.run, "allan", unit=[each.unit for each in curves.units],
                           signal=curves.signal),
        "commands_data": link("api", "runs", course.run, "commands"), "zone": found.run.time_zone,
    }  # fmt: skip


def _choices(course: RunCourse, curves: RunAllan) -> list[tuple[str, bool]]:
    """Units to choose from, and whether each is shown: those that are, then the first ones."""
    chosen = [each.unit for each in curves.units]
    others = [each for each in course.units if each not in chosen]
    return sorted([(unit, unit in chosen) for unit in (chosen + others)[:_CHOICES]])
