"""The data of one unit, split into training and held-out set."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.run_blocks import RunBlocks, stands_still
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.tracing.whitening.stack import Stack, StackReport, UnitRecord, in_segments, stacked
from analytics.loop.tracing.whitening.white_variance import record_of
from stream.batch import BoolArray
from stream.errors import BadInput

FEWEST_BLOCKS = 20
FEWEST_REPLICATES = 3  # fewer runs cannot be split into training and held-out set
FEWEST_BLOCKS_TO_SPLIT = 60  # a shorter single run cannot be split


@dataclass(frozen=True)
class Case:
    """The data of one unit, split."""

    stack: Stack  # all blocks
    report: StackReport  # those that were dropped
    replication: Literal["runs", "within_run"]  # what the replicates are: runs, or segments of one run
    held_out: tuple[str, ...]  # names of the held-out replicates; empty if there are too few
    training: UnitRecord  # the other blocks

    @property
    def held_out_blocks(self) -> BoolArray:
        """Marks the held-out blocks; all blocks if none are held out."""
        return self.stack.of_replicates(self.held_out or self.stack.replicates)


def case_of(
    runs: Sequence[RunBlocks], model: ErrorModel, declared: ModelNoise | None, holdout: Sequence[str] | None = None
) -> Case:
    """Stack and split the runs of one unit."""
    return split(*stacked(runs, model.shaped(runs)), declared, holdout)


def split(
    stack: Stack,
    report: StackReport,
    declared: ModelNoise | None,
    holdout: Sequence[str] | None,
    *,
    turn_on_is_declared: bool = True,
) -> Case:
    """Split stacked blocks; the last third is held out unless runs are named."""
    is_single = len(stack.runs) == 1
    whole = in_segments(stack) if is_single else stack
    names = whole.replicates
    if holdout is None:
        is_short = is_single and len(stack) < FEWEST_BLOCKS_TO_SPLIT
        held_out = () if is_short or len(names) < FEWEST_REPLICATES else names[len(names) - len(names) // 3 :]
    else:
        held_out = tuple(name for name in names if name in holdout)
    training = whole.part(~whole.of_replicates(held_out)) if held_out else whole
    record = record_of(training, declared, turn_on_is_declared=turn_on_is_declared)
    return Case(whole, report, "within_run" if is_single else "runs", held_out, record)


def check_runs(runs: Sequence[RunBlocks], holdout: Sequence[str] | None) -> None:
    """Refuse runs of several signals, units or grids, and held-out runs that are not there or are all runs."""
    for name in ("unit", "signal", "unit_of_measure", "block_s"):
        values = sorted({str(getattr(run, name)) for run in runs})
        if len(values) > 1:
            raise BadInput(f"runs to diagnose have several values of {name}: {', '.join(values)}; give one")
    known = [run.run for run in runs]
    if unknown := sorted(set(holdout or ()) - set(known)):
        raise BadInput(f"run to hold out is not there: {', '.join(unknown)}; the runs are {', '.join(known)}")
    if holdout and set(known) <= set(holdout):
        raise BadInput(f"all runs ({', '.join(known)}) are to be held out: leave some to fit the model to")


def missing_data(stack: Stack, model: ErrorModel, holdout: Sequence[str]) -> Bilingual | None:
    """What is missing for a trace, or for a fit without the held-out runs; None if there is enough."""
    missing = _missing(stack, model)
    if missing or not holdout or len(stack.runs) == 1:
        return missing
    missing = _missing(stack.part(~stack.of_replicates(holdout)), model)
    return missing and Bilingual(f"without the held-out runs: {missing}", f"除去留出试验：{missing.zh}")


def _missing(stack: Stack, model: ErrorModel) -> Bilingual | None:
    blocks, columns = len(stack), stack.design.shape[1]
    if blocks < FEWEST_BLOCKS:
        return Bilingual(
            f"{blocks} blocks have the signal and the channels of the model; {FEWEST_BLOCKS} are needed",
            f"有信号及模型所需通道的数据块有{blocks}个，需要{FEWEST_BLOCKS}个",
        )
    if blocks < 3 * columns:
        return Bilingual(
            f"{blocks} blocks for {columns} coefficients of '{model}'; three times as many are needed",
            f"{blocks}个数据块对应'{model}'的{columns}个系数；数据块数须为系数的三倍",
        )
    if not stands_still(stack.value):
        return None
    value = f"{stack.value[0]:g}"
    return Bilingual(
        f"the signal is constant at {value}: the output is dead or stuck", f"信号始终为{value}：输出失效或卡死"
    )
