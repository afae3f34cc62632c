"""Notes on a reduction: what was left out, assumed or looks wrong, as sentences."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.run_blocks import RunBlocks
from stream.batch import BoolArray
from stream.defects.outliers import IsolatedOutliers

_BLOCKS_S = (1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0)
_OTHER_RATE = 1.5
_LEFT_OF_DELAY = 0.001  # of an interval; up to 0.0009 was measured on swings of eight and more readings, and on ramps
_BLOCKS_A_RATE, _FEWEST_A_RATE = 8, 4  # that fit into a rate that is held, one at each end being lost
LEAST_SHARE = 0.2  # part of the usual number of samples that a block must have


OUTPUT = "output"  # of a note on outputs of a unit that are no channels


@dataclass(frozen=True)
class Note:
    """Something that was left out, assumed or looks wrong."""

    what: str  # in one word, such as ``constant`` or ``copy``
    text: Bilingual  # as a sentence
    channel: str | None = None
    runs: tuple[str, ...] = ()
    is_limit: bool = False  # whether it limits what can be concluded from the record


def in_runs(found: Collection[str], of: int) -> Bilingual:
    """Names of runs for a sentence.

    >>> in_runs(["r1"], 1), in_runs(["r1", "r2"], 9), in_runs(["r1", "r2"], 2)
    ('in run r1', 'in 2 of 9 runs (r1, r2)', 'in all 2 runs')
    """
    names = list(found)
    if len(names) == of:
        if of == 1:
            return Bilingual(f"in run {names[0]}", f"在试验{names[0]}中")
        return Bilingual(f"in all {of} runs", f"在全部{of}次试验中")
    listed = ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
    return Bilingual(f"in {len(names)} of {of} runs ({listed})", f"在{of}次试验中的{len(names)}次（{listed}）中")


def not_finite(missing: Mapping[str, int]) -> list[Note]:
    """Note samples that are not finite, by their number in each run."""
    if not (having := [run for run, samples in missing.items() if samples > 0]):
        return []
    where = in_runs(having, len(missing))
    count = f"{sum(missing[run] for run in having):,}"
    text = Bilingual(
        f"{count} samples are not finite {where}: left out", f"{where.zh}有{count}个采样不是有限数：已略去"
    )
    return [Note("not_finite", text, runs=tuple(having))]


def isolated(signal: str, found: Mapping[str, IsolatedOutliers], of: int) -> list[Note]:
    """Note isolated outliers that raise the noise."""
    if not found:
        return []
    count, largest = sum(each.count for each in found.values()), max(each.largest for each in found.values())
    raised = max(each.raise_n_by for each in found.values())
    where = in_runs(found, of)
    text = Bilingual(
        f"{count:,} samples of {signal} are isolated outliers {where}, up to {largest:.3g} times the noise: they raise "
        f"N by up to {raised:.0%}",
        f"{where.zh}，{signal}有{count:,}个孤立离群采样，最大为噪声的{largest:.3g}倍：使N最多偏大{raised:.0%}",
    )
    return [Note("outliers", text, signal, tuple(found), is_limit=True)]


def far_outside(name: str, far: Mapping[str, tuple[int, float]], units: Mapping[str, str], of: int) -> list[Note]:
    """Note outliers of a signal or channel: their number, and the farthest, in each run."""
    if not far:
        return []
    worst = max(far, key=lambda run: abs(far[run][1]))
    count, value = sum(count for count, _ in far.values()), f"{far[worst][1]:g} {units[worst]}"
    where = in_runs(far, of)
    text = Bilingual(
        f"{count:,} blocks or readings of {name} are left out {where}: outliers of up to {value}, as from a fill "
        "value, a transmission error or a shock",
        f"{where.zh}略去{name}的{count:,}个数据块或读数：离群值（最大为{value}），如填充值、传输误码或冲击所致",
    )
    return [Note("far_outside", text, name, tuple(far), is_limit=True)]


def apart(intervals_s: Mapping[str, float], block_s: float) -> list[Note]:
    """Note runs with an interval between samples that exceeds the length of a block."""
    if not (having := [run for run, interval_s in intervals_s.items() if interval_s > 1.5 * block_s]):
        return []
    apart_s = max(intervals_s[run] for run in having)
    where = in_runs(having, len(intervals_s))
    text = Bilingual(
        f"samples are up to {apart_s:g} s apart {where}, blocks are {block_s:g} s long: most are empty, and the noise "
        f"N is estimated too low; give blocks from {apart_s:g} s on",
        f"{where.zh}采样间隔达{apart_s:g} s，而数据块长{block_s:g} s：多数数据块为空，噪声N偏低；"
        f"数据块请取{apart_s:g} s以上",
    )
    return [Note("apart", text, runs=tuple(having), is_limit=True)]


def partial(rows: Mapping[str, BoolArray]) -> list[Note]:
    """Note blocks with too few samples, at the edges of gaps."""
    share = f"{LEAST_SHARE:.0%}"
    why = Bilingual(f"they hold less than {share} of the usual number of samples", f"采样数不足通常的{share}")
    return _blocks_left_out("partial", rows, why)


def not_resolved(rows: Mapping[str, BoolArray], interval_s: float, block_s: float, held_s: float) -> list[Note]:
    """Note blocks in which the reference rate changes faster than its readings resolve; `held_s` is that of a rate."""
    fitting_s = max((each for each in _BLOCKS_S if each <= held_s / _BLOCKS_A_RATE), default=0.0)
    if held_s < _FEWEST_A_RATE * block_s and interval_s <= fitting_s < block_s:
        advice = Bilingual(
            f"rates are held for {held_s:.3g} s, of which blocks of {block_s:g} s leave little: --block {fitting_s:g}s "
            f"keeps more, or hold each for {2 * _FEWEST_A_RATE * block_s:g} s",
            f"各角速率仅保持{held_s:.3g} s，{block_s:g} s的数据块所剩无几：用--block {fitting_s:g}s可保留更多，"
            f"或每个角速率保持{2 * _FEWEST_A_RATE * block_s:g} s",
        )
    elif interval_s >= 0.5 * block_s:
        advice = Bilingual(
            f"record it more often than once in {interval_s:g} s, or as means over the same times as the signal",
            f"请以高于每{interval_s:g} s一次的频度记录基准，或记录与信号同时段的均值",
        )
    else:
        advice = Bilingual("shorter blocks or more readings keep more", "缩短数据块或增加读数可保留更多")
    why = Bilingual(
        f"the reference rate changes within them faster than its readings show; {advice}",
        f"基准角速率变化快于其读数所示；{advice.zh}",
    )
    return _blocks_left_out("unresolved", rows, why, "input_rate")


def hidden_delay_s(reference_s: float, signal_s: float) -> float:
    """The longest delay that joining readings of two rates may leave, in seconds; 0 where both have one rate.

    >>> hidden_delay_s(1.0, 0.01), hidden_delay_s(0.01, 0.01)
    (0.001, 0.0)
    """
    longer, shorter = max(reference_s, signal_s), min(reference_s, signal_s)
    return 0.0 if longer < _OTHER_RATE * shorter else _LEFT_OF_DELAY * longer


def two_rates(reference_s: float, signal_s: float, block_s: float) -> list[Note]:
    """Note a swinging reference that is read at another rate than the signal."""
    if not (hidden_s := hidden_delay_s(reference_s, signal_s)):
        return []
    least = f"{hidden_s:.1g} s"
    text = Bilingual(
        f"the reference rate swings, and is read every {reference_s:.3g} s, the signal every {signal_s:.3g} s: a time "
        f"offset or an effect of angular acceleration that is a delay of less than {least} may be what is left of the "
        "distance of their times",
        f"基准角速率持续摆动，其读数间隔为{reference_s:.3g} s，信号为{signal_s:.3g} s："
        f"相当于{least}以下延时的时间偏移或角加速度效应，可能只是两者时刻之差的残余",
    )
    if reference_s > block_s * (1.0 + 1e-9):
        text = Bilingual(
            f"{text}; blocks of {block_s:g} s have no reading each, and are left out where it swings",
            f"{text.zh}；并非每个{block_s:g} s数据块都有基准读数，摆动处的数据块已略去",
        )
    return [Note("two_rates", text, "input_rate", is_limit=True)]


def _blocks_left_out(
    what: str, rows: Mapping[str, BoolArray], why: Bilingual, channel: str | None = None
) -> list[Note]:
    if not (having := [run for run, own in rows.items() if own.any()]):
        return []
    count = sum(int(rows[run].sum()) for run in having)
    where = in_runs(having, len(rows))
    text = Bilingual(f"{count:,} blocks are left out {where}: {why}", f"{where.zh}略去{count:,}个数据块：{why.zh}")
    return [Note(what, text, channel, tuple(having))]


def positions(words: Collection[str], numbers: Mapping[str, float]) -> list[Note]:
    """Note the meaning of the numbers of the channel position."""
    if not words:
        return []
    meanings = ", ".join(f"{numbers[word]:g} {word}" for word in sorted(words))
    text = Bilingual(f"channel position stands for: {meanings}", f"通道position代表：{meanings}")
    if len(words) > 1:
        text = Bilingual(
            f"{text}; positions differ by gravity, earth rate, magnetic field and mounting: only positions that were "
            "remounted several times show by which",
            f"{text.zh}；位置之间的差别可能是重力、地球自转、磁场或安装：只有多次重新安装的位置才能判别",
        )
    return [Note("positions", text, "position", is_limit=len(words) > 1)]


def no_power_on(unknown: Sequence[str], of: int) -> list[Note]:
    """Note runs without a recorded power-on."""
    if not unknown:
        return []
    where = in_runs(unknown, of)
    if len(unknown) == of > 1:
        where = Bilingual(f"in any of {of} runs", f"{of}次试验均")
    text = Bilingual(
        f"no power-on is recorded {where}: time_since_power_on counts from the first sample",
        f"{where.zh}无上电记录：time_since_power_on从首个采样起计",
    )
    return [Note("no_power_on", text, "time_since_power_on", tuple(unknown), is_limit=True)]


def power_ons(split: Sequence[str], of: int) -> list[Note]:
    """Note runs with several power-ons."""
    if not split:
        return []
    where = in_runs(split, of)
    text = Bilingual(
        f"the unit was powered on several times {where}: each power-on counts as a run, RUN#1, RUN#2, ...",
        f"{where.zh}产品多次上电：每次上电计为一次试验，记作RUN#1、RUN#2……",
    )
    return [Note("power_ons", text, runs=tuple(split))]


def no_scatter(runs: Sequence[RunBlocks]) -> list[Note]:
    """Note that nothing within blocks shows the noise."""
    if not all(run.is_table for run in runs):
        return []
    most = max(int(run.n.max()) for run in runs)
    held = Bilingual("hold one sample each", "各含一个采样")
    if most > 1:
        held = Bilingual(f"hold up to {most:,} samples without scatter", f"至多含{most:,}个采样且无离散")
    block = f"{runs[0].block_s:g} s"
    text = Bilingual(
        f"blocks of {block} {held}: the noise is estimated from the residual of the model alone",
        f"{block}数据块{held.zh}：噪声仅由模型残差估计",
    )
    return [Note("no_scatter", text, is_limit=True)]
