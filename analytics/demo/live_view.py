"""The terminal's view of a run: units, rates, bias stability, verdicts; headings in English and Chinese."""

import time
from collections.abc import Sequence

from rich import box
from rich.console import Group, RenderableType
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from analytics.demo.demo import DemoState, UnitView
from stream.estimators.decision.decision import Outcome
from stream.events import Check, EarlyDecision, Limit, Verdict, VerdictGiven
from stream.worker.limit_checks import judge

_WIDE = 140
_SHOWN = {
    Verdict.PASS: ("合格", "green"),
    Verdict.FAIL: ("不合格", "bold red"),
    Verdict.MARGINAL: ("临界", "yellow"),
    Verdict.NO_DATA: ("无数据", "dim"),
    Verdict.ABORTED: ("中止", "red"),
}
_NAMES = {
    "angle_random_walk": ("Angle random walk", "角度随机游走"),
    "allan_deviation": ("Allan deviation", "Allan 标准差"),
    "bias_stability": ("Bias stability", "零偏稳定性"),
}


def live_view(state: DemoState, width: int) -> RenderableType:
    """Progress, speed and the table of units, in `width` characters."""
    elapsed_s = state.seconds or time.monotonic() - state.began
    times = state.simulated_s / max(elapsed_s, 1e-9)
    line = Text.assemble(
        ("SIMULATED  模拟数据  ", "bold magenta"),
        f"run {state.run}   {state.simulated_s / 3600:.2f} of {state.duration_s / 3600:g} h   ",
        f"{state.samples:,} samples   {state.samples / max(elapsed_s, 1e-9) / 1e6:.2f} M samples/s   ",
        f"{times:,.0f} x real time   {state.phase}",
    )
    bar = ProgressBar(total=state.duration_s, completed=state.simulated_s)
    return Group(line, bar, Text(), fleet_table(state, width))


def fleet_table(state: DemoState, width: int) -> Table:
    """A row for each unit: its samples, each limit's estimate with its confidence interval, the verdict."""
    is_wide = width >= _WIDE
    table = Table(
        header_style="bold",
        caption=f"values with their 95 % confidence bounds; limits {state.limits.label}",
        caption_justify="left",
        box=box.HEAVY_HEAD if is_wide else box.SIMPLE_HEAD,
        padding=(0, 1) if is_wide else (0, 1, 0, 0),
    )
    table.add_column("Unit\n产品", no_wrap=True)
    if is_wide:
        table.add_column("Samples\n采样数", justify="right")
        table.add_column("Rate, last 5 s\n角速率\ndeg/h", justify="right")
        table.add_column("Last temp.\n温度\ndegC", justify="right")
    for limit in state.limits.live:
        table.add_column(limit_title(limit), justify="right", overflow="fold")
    table.add_column("Verdict\n判定", no_wrap=True)
    for view in state.units.values():
        cells = _row(view, state.limits.live)
        table.add_row(*(cells if is_wide else [cells[0], *cells[4:]]))
    return table


def limit_title(limit: Limit) -> str:
    """Heading of a limit's column in two languages.

    >>> limit_title(Limit(characteristic="bias_stability", signal="rate", tau_s=10.0, upper=0.8,
    ...     unit_of_measure="deg/h")).splitlines()
    ['Bias stability', '零偏稳定性 10 s', '<= 0.8 deg/h']
    """
    english, chinese = _NAMES[limit.characteristic]
    tau = "" if limit.tau_s is None else f" {limit.tau_s:g} s"
    return f"{english}\n{chinese}{tau}\n<= {limit.upper:g} {limit.unit_of_measure}"


def _row(view: UnitView, limits: Sequence[Limit]) -> list[RenderableType]:
    checks = view.verdict.checks if view.verdict else [judge(limit, list(view.estimates.values())) for limit in limits]
    return [
        view.unit,
        f"{view.samples:,}",
        "" if view.rate_deg_per_h is None else f"{view.rate_deg_per_h:+.2f}",
        "" if view.temperature_deg_c is None else f"{view.temperature_deg_c:.2f}",
        *(_cell(check, view.decisions.get(check.limit), final=view.verdict is not None) for check in checks),
        _verdict(view.verdict),
    ]


def _cell(check: Check, decision: EarlyDecision | None, *, final: bool) -> Text:
    if check.value is None:
        return Text("...", style="dim")
    text = f"{check.value:.4f}\n{_short(check.lo)}-{_short(check.hi)}"
    if final:
        return Text(text, style=_SHOWN[check.verdict][1])
    # an interval looked at again and again says nothing; a decision that was planned does
    if decision is None or decision.outcome == Outcome.UNDECIDED:
        return Text(text)
    return Text(f"{text}\n{decision.outcome} early 提前", style=_SHOWN[Verdict(decision.outcome)][1])


def _short(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}" if value >= 0.1 else f"{value:.4f}"


def _verdict(given: VerdictGiven | None) -> Text:
    if given is None:
        # a look at an interval in mid-run decides wrongly too often: the verdict is given once, at the end
        return Text("at the end\n结束时", style="dim")
    chinese, style = _SHOWN[given.verdict]
    return Text(f"{given.verdict}\n{chinese}", style=style)
