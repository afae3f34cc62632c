"""Notes on what a reduction left out, as sentences."""

from collections.abc import Mapping, Sequence

from analytics.loop.blocks.checks import Note, in_runs
from analytics.loop.blocks.derived import is_table
from analytics.loop.blocks.means import Blocks
from analytics.loop.blocks.records import Record
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.blocks.step_channels import Step
from stream.batch import BoolArray

LEAST_SHARE = 0.2
"""Part of the usual number of samples that a block must hold."""


def not_finite(found: Mapping[str, Blocks], records: Mapping[str, Record]) -> list[Note]:
    """Note samples that are no finite numbers."""
    missing = {run: records[run].samples - int(blocks.n.sum()) for run, blocks in found.items()}
    having = [run for run, samples in missing.items() if samples > 0]
    if not having:
        return []
    where = in_runs(having, len(found))
    text = f"{sum(missing[run] for run in having):,} samples are no finite numbers {where}: left out"
    return [Note("not_finite", text, runs=tuple(having))]


def far_outside(name: str, far: Mapping[str, tuple[int, float]], units: Mapping[str, str], of: int) -> list[Note]:
    """Note readings that lie far outside of those beside them."""
    if not far:
        return []
    worst = max(far, key=lambda run: abs(far[run][1]))
    count, value = sum(count for count, _ in far.values()), f"{far[worst][1]:g} {units[worst]}"
    text = (
        f"{count:,} blocks or readings of {name} are left out {in_runs(list(far), of)}: a reading, {value} the "
        "largest, lies far outside of those before and after it, as a fill value does, a bit that was flipped on the "
        "way, or a knock"
    )
    return [Note("far_outside", text, name, tuple(far), is_limit=True)]


def apart(records: Mapping[str, Record], block_s: float) -> list[Note]:
    """Note samples that are further apart than blocks are long."""
    having = [run for run, record in records.items() if record.interval_s > 1.5 * block_s]
    if not having:
        return []
    apart_s = max(records[run].interval_s for run in having)
    text = (
        f"samples are up to {apart_s:g} s apart {in_runs(having, len(records))}, blocks are {block_s:g} s long: most "
        f"are empty, and the noise N is estimated too low; give blocks from {apart_s:g} s on"
    )
    return [Note("apart", text, runs=tuple(having), is_limit=True)]


def partial(rows: Mapping[str, BoolArray]) -> list[Note]:
    """Blocks that hold but a few samples, at the edge of a gap."""
    having = [run for run, own in rows.items() if own.any()]
    if not having:
        return []
    text = (
        f"{sum(int(rows[run].sum()) for run in having):,} blocks are left out {in_runs(having, len(rows))}: they hold "
        f"less than {LEAST_SHARE:.0%} of the usual number of samples"
    )
    return [Note("partial", text, runs=tuple(having))]


def not_resolved(rows: Mapping[str, BoolArray], interval_s: float, block_s: float) -> list[Note]:
    """Note blocks in which the reference rate changes faster than its readings show."""
    having = [run for run, own in rows.items() if own.any()]
    if not having:
        return []
    if interval_s >= 0.5 * block_s:
        advice = f"record it more often than once in {interval_s:g} s, or as means over the same times as the signal"
    else:
        advice = "shorter blocks or more readings keep more"
    text = (
        f"{sum(int(rows[run].sum()) for run in having):,} blocks are left out {in_runs(having, len(rows))}: the "
        f"reference rate changes within them faster than its readings show; {advice}"
    )
    return [Note("unresolved", text, "input_rate", tuple(having))]


def positions(
    runs: Sequence[RunBlocks], steps: Mapping[str, Sequence[Step]], numbers: Mapping[str, float]
) -> list[Note]:
    """Note what the numbers of the channel position stand for."""
    words = sorted({step.position for run in runs for step in steps.get(run.run, ()) if step.position})
    if not words:
        return []
    text = f"channel position stands for: {', '.join(f'{numbers[word]:g} {word}' for word in words)}"
    if len(words) > 1:
        text += (
            "; what differs between positions is gravity, the earth's rate and field, or the mounting itself: only "
            "positions that were mounted anew several times tell"
        )
    return [Note("positions", text, "position", is_limit=len(words) > 1)]


def no_scatter(runs: Sequence[RunBlocks]) -> list[Note]:
    """Note that nothing within blocks tells the noise."""
    if not all(is_table(run) for run in runs):
        return []
    most = max(int(run.n.max()) for run in runs)
    held = "hold one sample each" if most == 1 else f"hold up to {most:,} samples without scatter"
    text = (
        f"blocks of {runs[0].block_s:g} s {held}: nothing within them tells the noise, which is judged by what the "
        "model leaves"
    )
    return [Note("no_scatter", text, is_limit=True)]
