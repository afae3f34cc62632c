"""What was left out of a record before anything was fitted, as shares of the information in it."""

import re
from collections.abc import Iterator, Mapping, Sequence

import msgspec
import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.run_blocks import RunBlocks
from stream.batch import BoolArray, FloatArray

REPORTED, GRAVE = 0.2, 0.5
"""Share of a kind of run or of a channel's excitation that is worth a word, and one without which nothing is denied."""
FAR_OUTSIDE = Bilingual("a reading of the signal lies far outside its neighbours", "信号有读数远离其前后读数")
FEW_SAMPLES = Bilingual("they hold too few samples", "采样过少")
NOT_RESOLVED = Bilingual(
    "the reference rate changes within them faster than its readings show", "基准角速率在块内的变化快于其读数所能反映"
)
_TAIL = 0.05
_DERIVED = frozenset({"day", "time_since_power_on", "position"})
_AT_EDGES = frozenset({"table_acceleration"})  # blocks across an edge hold all of it


class LeftOut(msgspec.Struct, frozen=True):
    """Something that was left out: blocks, runs of a kind, a step, or a channel's excitation."""

    what: Bilingual
    share: float  # part of it that was left out, 0 to 1
    why: Bilingual
    is_grave: bool = False  # whether what remains cannot show that nothing is missing

    def document(self) -> dict[str, object]:
        """Return it as it stands in JSON."""
        return {"what": str(self.what), "share": self.share, "why": str(self.why)}

    @property
    def sentence(self) -> Bilingual:
        """As a limit of a verdict."""
        return Bilingual(
            f"{self.share:.0%} of {self.what} left out: {self.why}",
            f"略去{self.what.zh}的{self.share:.0%}：{self.why.zh}",
        )


class Loss(msgspec.Struct, frozen=True):
    """Blocks that were left out for one reason."""

    why: Bilingual
    rows: Mapping[str, BoolArray]  # by the name of the run; a run that lost none may be missing


def left_out(
    runs: Sequence[RunBlocks], losses: Sequence[Loss], steps: Mapping[tuple[str, str], BoolArray] | None = None
) -> tuple[LeftOut, ...]:
    """Return what losses of blocks mean for runs: how many, of which kind of run, step and excitation; worst first.

    `runs` have all blocks, those left out included; a block in several losses counts for the first. `steps` are the
    blocks that lie in each step, by run and name of the step.
    """
    gone = {run.run: np.zeros(len(run), dtype=np.bool_) for run in runs}
    blocks = sum(map(len, runs))
    what = Bilingual(f"{blocks:,} blocks", f"{blocks:,}个数据块")
    by_reason = []
    for loss in losses:
        count = 0
        for name in gone.keys() & loss.rows.keys():
            count += int((loss.rows[name] & ~gone[name]).sum())
            gone[name] |= loss.rows[name]
        if count:
            by_reason.append(LeftOut(what, count / blocks, loss.why))
    if not by_reason:
        return ()
    found = [*_kinds(runs, losses, gone), *_excitation(runs, losses, gone), *_steps(losses, gone, steps or {})]
    return tuple(sorted([*found, *by_reason], key=lambda each: (not each.is_grave, -each.share)))


def kind_of_run(name: str) -> str:
    """What a run is called without its numbers: runs of one name are of one kind.

    >>> kind_of_run("02-rate"), kind_of_run("temperature_cycle_3#2"), kind_of_run("2026-11-21")
    ('rate', 'temperature cycle', '')
    """
    return " ".join(re.findall(r"[^\W\d_]+", name)).lower()


def _mostly(losses: Sequence[Loss], weight: Mapping[str, FloatArray]) -> Bilingual:
    """The reason that weighs most."""

    def weight_of(loss: Loss) -> float:
        return float(sum(weight[name][rows].sum() for name, rows in loss.rows.items() if name in weight))

    return max(losses, key=weight_of).why


def _kinds(runs: Sequence[RunBlocks], losses: Sequence[Loss], gone: Mapping[str, BoolArray]) -> Iterator[LeftOut]:
    kinds: dict[str, list[RunBlocks]] = {}
    for run in runs:
        kinds.setdefault(kind_of_run(run.run), []).append(run)
    for kind, of_kind in kinds.items():
        share = sum(int(gone[run.run].sum()) for run in of_kind) / max(1, sum(map(len, of_kind)))
        if share < REPORTED:
            continue
        what = Bilingual(f"runs '{kind}'", f"“{kind}”类试验")
        if len(kinds) == 1:
            what = Bilingual("all runs", "全部试验")
        elif not kind:
            what = Bilingual(f"runs {of_kind[0].run} and the like", f"{of_kind[0].run}一类试验")
        why = _mostly(losses, {run.run: np.ones(len(run)) for run in of_kind})
        yield LeftOut(what, share, why, share >= GRAVE)


def _excitation(runs: Sequence[RunBlocks], losses: Sequence[Loss], gone: Mapping[str, BoolArray]) -> Iterator[LeftOut]:
    """Of each channel the sum of squares about its middle, but for what it does in less than a twentieth of a run."""
    for name in sorted({name for run in runs for name in run.channels} - _DERIVED):
        clipped = {run.run: _clipped(run.mean(name)) for run in runs if name in run.channels}
        known = np.concatenate([each[np.isfinite(each)] for each in clipped.values()])
        if known.size == 0 or np.ptp(known) == 0:
            continue
        middle = float(np.median(known))
        squares = {run: np.nan_to_num(each - middle) ** 2 for run, each in clipped.items()}
        whole = sum(float(each.sum()) for each in squares.values())
        lost = sum(float(each[gone[run]].sum()) for run, each in squares.items())
        blocks = sum(int(gone[run].sum()) for run in squares) / sum(map(len, squares.values()))
        # noise has its share of the squares in every block
        if whole > 0 and lost / whole >= max(REPORTED, 1.5 * blocks):
            is_grave = lost / whole >= GRAVE and name not in _AT_EDGES
            what = Bilingual(f"the excitation of {name}", f"{name}的激励")
            yield LeftOut(what, lost / whole, _mostly(losses, squares), is_grave)


def _clipped(mean: FloatArray) -> FloatArray:
    known = mean[np.isfinite(mean)]
    if known.size == 0:
        return mean
    low, high = np.quantile(known, (_TAIL, 1.0 - _TAIL))
    return np.asarray(np.clip(mean, low, high))


def _steps(
    losses: Sequence[Loss], gone: Mapping[str, BoolArray], steps: Mapping[tuple[str, str], BoolArray]
) -> Iterator[LeftOut]:
    for (run, step), rows in steps.items():
        if run in gone and rows.any() and gone[run][rows].all():
            why = _mostly(losses, {run: rows.astype(np.float64)})
            what = Bilingual(f"step {step} of run {run}", f"试验{run}的步骤{step}")
            yield LeftOut(what, 1.0, why, is_grave=True)
