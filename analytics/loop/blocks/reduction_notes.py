"""Notes on a reduction: what was left out, assumed or looks wrong, as sentences."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from analytics.curves.isolated_outliers import IsolatedOutliers
from analytics.loop.blocks.run_blocks import RunBlocks
from stream.batch import BoolArray

LEAST_SHARE = 0.2
"""Part of the usual number of samples that a block must have."""


@dataclass(frozen=True)
class Note:
    """Something that was left out, assumed or looks wrong.

    Parameters
    ----------
    what: In one word, such as ``constant`` or ``copy``.
    text: As a sentence.
    channel, runs: Which channel, and in which runs.
    is_limit: Whether it limits what can be concluded from the record.
    """

    what: str
    text: str
    channel: str | None = None
    runs: tuple[str, ...] = ()
    is_limit: bool = False


def in_runs(found: Collection[str], of: int) -> str:
    """Names of runs for a sentence.

    Examples
    --------
    >>> in_runs(["r1"], 1), in_runs(["r1", "r2"], 9), in_runs(["r1", "r2"], 2)
    ('in run r1', 'in 2 of 9 runs (r1, r2)', 'in all 2 runs')
    """
    names = list(found)
    if len(names) == of:
        return f"in run {names[0]}" if of == 1 else f"in all {of} runs"
    listed = ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
    return f"in {len(names)} of {of} runs ({listed})"


def not_finite(missing: Mapping[str, int]) -> list[Note]:
    """Note samples that are not finite, by their number in each run."""
    having = [run for run, samples in missing.items() if samples > 0]
    if not having:
        return []
    where = in_runs(having, len(missing))
    text = f"{sum(missing[run] for run in having):,} samples are not finite {where}: left out"
    return [Note("not_finite", text, runs=tuple(having))]


def isolated(signal: str, found: Mapping[str, IsolatedOutliers], of: int) -> list[Note]:
    """Note isolated outliers that raise the noise."""
    if not found:
        return []
    count, largest = sum(each.count for each in found.values()), max(each.largest for each in found.values())
    raised = max(each.raise_n_by for each in found.values())
    text = (
        f"{count:,} samples of {signal} are isolated outliers {in_runs(found, of)}, up to {largest:.3g} times the "
        f"noise: they raise N by up to {raised:.0%}"
    )
    return [Note("outliers", text, signal, tuple(found), is_limit=True)]


def far_outside(name: str, far: Mapping[str, tuple[int, float]], units: Mapping[str, str], of: int) -> list[Note]:
    """Note outliers of a signal or channel: their number, and the farthest, in each run."""
    if not far:
        return []
    worst = max(far, key=lambda run: abs(far[run][1]))
    count, value = sum(count for count, _ in far.values()), f"{far[worst][1]:g} {units[worst]}"
    text = (
        f"{count:,} blocks or readings of {name} are left out {in_runs(far, of)}: outliers of up to {value}, as from a "
        "fill value, a transmission error or a shock"
    )
    return [Note("far_outside", text, name, tuple(far), is_limit=True)]


def apart(intervals_s: Mapping[str, float], block_s: float) -> list[Note]:
    """Note runs with an interval between samples that exceeds the length of a block."""
    having = [run for run, interval_s in intervals_s.items() if interval_s > 1.5 * block_s]
    if not having:
        return []
    apart_s = max(intervals_s[run] for run in having)
    text = (
        f"samples are up to {apart_s:g} s apart {in_runs(having, len(intervals_s))}, blocks are {block_s:g} s long: "
        f"most are empty, and the noise N is estimated too low; give blocks from {apart_s:g} s on"
    )
    return [Note("apart", text, runs=tuple(having), is_limit=True)]


def partial(rows: Mapping[str, BoolArray]) -> list[Note]:
    """Note blocks with too few samples, at the edges of gaps."""
    why = f"they hold less than {LEAST_SHARE:.0%} of the usual number of samples"
    return _blocks_left_out("partial", rows, why)


def not_resolved(rows: Mapping[str, BoolArray], interval_s: float, block_s: float) -> list[Note]:
    """Note blocks in which the reference rate changes faster than its readings resolve."""
    if interval_s >= 0.5 * block_s:
        advice = f"record it more often than once in {interval_s:g} s, or as means over the same times as the signal"
    else:
        advice = "shorter blocks or more readings keep more"
    why = f"the reference rate changes within them faster than its readings show; {advice}"
    return _blocks_left_out("unresolved", rows, why, "input_rate")


def _blocks_left_out(what: str, rows: Mapping[str, BoolArray], why: str, channel: str | None = None) -> list[Note]:
    having = [run for run, own in rows.items() if own.any()]
    if not having:
        return []
    count = sum(int(rows[run].sum()) for run in having)
    text = f"{count:,} blocks are left out {in_runs(having, len(rows))}: {why}"
    return [Note(what, text, channel, tuple(having))]


def positions(words: Collection[str], numbers: Mapping[str, float]) -> list[Note]:
    """Note the meaning of the numbers of the channel position."""
    if not words:
        return []
    text = f"channel position stands for: {', '.join(f'{numbers[word]:g} {word}' for word in sorted(words))}"
    if len(words) > 1:
        text += (
            "; positions differ by gravity, earth rate, magnetic field and mounting: only positions that were "
            "remounted several times show by which"
        )
    return [Note("positions", text, "position", is_limit=len(words) > 1)]


def no_power_on(unknown: Sequence[str], of: int) -> list[Note]:
    """Note runs without a recorded power-on."""
    if not unknown:
        return []
    where = f"any of {of} runs" if len(unknown) == of > 1 else in_runs(unknown, of).removeprefix("in ")
    text = f"no power-on is recorded in {where}: time_since_power_on counts from the first sample"
    return [Note("no_power_on", text, "time_since_power_on", tuple(unknown), is_limit=True)]


def power_ons(split: Sequence[str], of: int) -> list[Note]:
    """Note runs with several power-ons."""
    if not split:
        return []
    where = in_runs(split, of)
    text = f"the unit was powered on several times {where}: each power-on counts as a run, RUN#1, RUN#2, ..."
    return [Note("power_ons", text, runs=tuple(split))]


def no_scatter(runs: Sequence[RunBlocks]) -> list[Note]:
    """Note that nothing within blocks shows the noise."""
    if not all(run.is_table for run in runs):
        return []
    most = max(int(run.n.max()) for run in runs)
    held = "hold one sample each" if most == 1 else f"hold up to {most:,} samples without scatter"
    text = f"blocks of {runs[0].block_s:g} s {held}: the noise is estimated from the residual of the model alone"
    return [Note("no_scatter", text, is_limit=True)]
