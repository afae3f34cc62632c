"""The test of the runs' biases in a diagnosis, and why it was not made."""

from collections.abc import Iterator

from analytics.loop.bilingual import Bilingual
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.tracing.case import Case
from analytics.loop.tracing.search.effect_search import Search
from analytics.loop.tracing.search.run_causes import RunCause, run_cause
from analytics.loop.tracing.search.screening import Candidates
from analytics.loop.tracing.verdict.effect_findings import AGEING
from analytics.loop.tracing.verdict.noise_agreement import MOST_RUNS
from analytics.loop.tracing.whitening.white_variance import record_of


def cause_of_biases(case: Case, candidates: Candidates, found: Search) -> RunCause | None:
    """The cause that the biases of all runs follow, where nothing was seen; of a few runs see `scatter_finding`."""
    if found.selected or found.unreplicated or untested(case):
        return None
    prior = case.training.prior
    every = record_of(case.stack, prior.center, turn_on_is_declared=prior.turn_on_is_declared)
    return run_cause(candidates, found, every)


def untested(case: Case) -> bool:
    """Whether there are too few runs for the test."""
    return case.replication == "within_run" or len(case.stack.runs) <= MOST_RUNS


def untested_biases(case: Case, model: ErrorModel) -> Iterator[Bilingual]:
    """What the biases of several runs are not compared with, and why."""
    runs = case.stack.runs
    if case.replication == "within_run":
        return
    if untested(case):
        yield Bilingual(
            "the biases of the runs are not compared with what differs only between them, such as their date: not "
            f"enough runs, {len(runs)} of the {MOST_RUNS + 1} needed",
            f"各次试验的零偏未与仅在试验之间不同的原因（如日期）比较：试验次数不足，有{len(runs)}次，"
            f"需要{MOST_RUNS + 1}次",
        )
        return
    undated = sum("day" not in run.channels for run in runs)
    if undated and AGEING not in model.effects:
        yield Bilingual(
            f"the biases of the runs are not compared with time: {undated} of {len(runs)} runs have no date; import "
            "them with --start",
            f"各次试验的零偏未与时间比较：{len(runs)}次试验中有{undated}次没有日期；请用--start导入日期",
        )
