"""Checks of a record: stuck signals, copies, channels that are constant, missing, mislabelled or on another clock."""

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.notes.left_out import LeftOut
from analytics.loop.blocks.notes.reduction_notes import Note, in_runs
from analytics.loop.blocks.run_blocks import RunBlocks, stands_still
from storage.sql.catalog import Catalog
from stream.batch import FloatArray
from stream.quantities import conversion, is_angular_rate

RunName = tuple[str, str]
"""A unit and one of its runs."""
_COPY = 1.0 - 1e-9
_BY_NATURE = frozenset({"day", "time_since_power_on", "input_rate", "table_rate", "position"})
_DERIVED = frozenset({"table_acceleration", "position", "gravity_i", "day"})
_FEWEST_FOR_COPY = 10
_CLOCK_APART_S = 1.0
_MISTAKES = {
    3600.0: Bilingual("as of deg/s under a label of deg/h, or the other way round", "deg/s与deg/h混淆"),
    60.0: Bilingual("as of deg/s or deg/h beside deg/min", "deg/s或deg/h与deg/min混淆"),
    180.0 / np.pi: Bilingual("as of radians under a label of degrees, or the other way round", "弧度与度混淆"),
    3600.0 * 180.0 / np.pi: Bilingual("as of rad/s under a label of deg/h, or the other way round", "rad/s与deg/h混淆"),
    1000.0: Bilingual("as of thousandths (mdps) under a label of the whole, or the other way round", "千分单位混淆"),
}
"""Ratio of two units of measure that may be confused, and how."""
_NEAR = 0.02
_FOLLOWS = 0.95
_FEWEST_FOR_RATIO = 10
_STILL_SHARE, _MOST_ALIKE = 0.2, 0.1
_ROUNDING = 1e-12


def check_runs(runs: Sequence[RunBlocks]) -> list[Note]:
    """Notes on runs in which the signal stands still."""
    notes = []
    still = [run.run for run in runs if len(run) > 1 and stands_still(run.value)]
    if still:
        where = in_runs(still, len(runs))
        text = Bilingual(
            f"signal {runs[0].signal} never changes {where}: its output is dead or stuck; exclude such runs with --run",
            f"信号{runs[0].signal}{where.zh}从不变化，输出失效或卡死：用--run略去这些试验",
        )
        notes.append(Note("still", text, runs=tuple(still), is_limit=True))
    return notes


def copied_runs(runs: Iterable[RunBlocks]) -> dict[RunName, RunName]:
    """Runs with the samples of an earlier one, and that one: one measurement under several names."""
    first: dict[bytes, RunName] = {}
    return {
        (run.unit, run.run): earlier
        for run in runs
        if len(run) >= _FEWEST_FOR_COPY and not stands_still(run.value)
        if (earlier := first.setdefault(run.value.tobytes(), (run.unit, run.run))) != (run.unit, run.run)
    }


def copies_left_out(copies: Mapping[RunName, RunName], runs: int) -> LeftOut:
    """Copied runs of one unit, of so many, that are left out."""
    pairs = list(copies.items())[:3]
    listed = Bilingual(
        ", ".join(f"{run} of {_named(unit, *of)}" for (unit, run), of in pairs),
        "、".join(f"{run}为{_named(unit, *of).zh}的副本" for (unit, run), of in pairs),
    )
    more = Bilingual(", ...", "等") if len(copies) > len(pairs) else Bilingual("", "")
    return LeftOut(
        Bilingual("the runs", "试验"),
        len(copies) / runs,
        Bilingual(
            f"they are copies, sample for sample ({listed}{more}), and would confirm each other",
            f"采样逐点相同（{listed.zh}{more.zh}），不能互相证实",
        ),
    )


def _named(unit: str, other: str, run: str) -> Bilingual:
    return Bilingual(run, run) if unit == other else Bilingual(f"{run} of unit {other}", f"产品{other}的{run}")


def copied_elsewhere(copies: Mapping[RunName, RunName], unit: str) -> list[Note]:
    """Note runs of a unit that stand under the names of other units as well."""
    found = [(of[1], own) for own, of in copies.items() if of[0] == unit != own[0]]
    if not found:
        return []
    listed = ", ".join(f"run {run} as {own[1]} of unit {own[0]}" for run, own in found[:3])
    listed_zh = "、".join(f"试验{run}即产品{own[0]}的{own[1]}" for run, own in found[:3])
    more = len(found) > 3
    text = Bilingual(
        f"{listed}{', ...' if more else ''}: the same samples under the names of several units, one at most right "
        "one; they count here",
        f"{listed_zh}{'等' if more else ''}：同一采样记在多个产品名下，至多一个正确；此处计入",
    )
    return [Note("copied_elsewhere", text, runs=tuple(run for run, _ in found), is_limit=True)]


def check_channels(runs: Sequence[RunBlocks]) -> list[Note]:
    """Notes on channels that are constant, copies of each other, in counts, or missing at times."""
    names = sorted({name for run in runs for name in run.channels})
    varying = [name for name in names if not _is_constant([run for run in runs if name in run.channels], name)]
    return [*(note for name in names for note in _check_one(runs, name)), *_check_copies(runs, varying)]


def _check_one(runs: Sequence[RunBlocks], name: str) -> Iterator[Note]:
    having = [run for run in runs if name in run.channels]
    if missing := [run.run for run in runs if name not in run.channels]:
        where = in_runs(missing, len(runs))
        text = Bilingual(
            f"channel {name} is missing {where}: effects that need it are not searched for",
            f"{where.zh}缺少通道{name}：不查找需要它的效应",
        )
        yield Note("missing_channel", text, name, tuple(missing))
    gaps = {run.run: int(np.isnan(run.mean(name)).sum()) for run in having}
    if gone := [run for run, blocks in gaps.items() if blocks]:
        blocks, total = sum(gaps.values()), sum(map(len, having))
        where = in_runs(gone, len(having))
        text = Bilingual(
            f"channel {name} has no reading near {blocks:,} of {total:,} blocks, {where}",
            f"{where.zh}，通道{name}在{total:,}个数据块中的{blocks:,}个附近没有读数",
        )
        yield Note("channel_gap", text, name, tuple(gone))
    if _is_constant(having, name) and name not in _DERIVED:
        text = Bilingual(
            f"channel {name} never changes: its effects cannot be distinguished from the bias",
            f"通道{name}从不变化：与它相关的效应无法与零偏区分",
        )
        yield Note("constant", text, name, tuple(run.run for run in having))
    elif name not in _BY_NATURE | _DERIVED:
        yield from _check_stopped(having, name)
    units = sorted({run.channels[name].unit_of_measure for run in having})
    if len(units) > 1:
        text = Bilingual(
            f"channel {name} is in {' and '.join(units)}, depending on the run: import it in one unit of measure",
            f"通道{name}的单位因试验而异（{'、'.join(units)}）：请以同一单位导入",
        )
        yield Note("mixed_units", text, name, is_limit=True)
    elif units[0] in {"count", "LSB"}:
        text = Bilingual(
            f"channel {name} is in {units[0]}: coefficients are per {units[0]}",
            f"通道{name}的单位为{units[0]}：系数按每{units[0]}计",
        )
        yield Note("counts", text, name)


def _check_stopped(having: Sequence[RunBlocks], name: str) -> Iterator[Note]:
    """Note a channel that has one value over a long part of a run, and changes from block to block elsewhere."""
    longest: dict[str, int] = {}
    pairs = alike = 0
    for run in having:
        mean = run.mean(name)
        same = np.abs(np.diff(mean)) <= _ROUNDING * np.abs(mean[1:])
        edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]])))
        lengths = edges[1::2] - edges[::2]
        longest[run.run] = int(lengths.max(initial=0))
        pairs += len(same) - longest[run.run]
        alike += int(same.sum()) - longest[run.run]
    if alike >= _MOST_ALIKE * pairs:
        return
    stopped = {
        run.run: longest[run.run] / len(run)
        for run in having
        if longest[run.run] >= max(_FEWEST_FOR_COPY, _STILL_SHARE * len(run))
    }
    if stopped:
        where, share = in_runs(stopped, len(having)), max(stopped.values())
        text = Bilingual(
            f"channel {name} keeps one value for up to {share:.0%} of a run {where}, and changes from block to block "
            "elsewhere: if its sensor had stopped there, its coefficients are wrong; exclude such runs with --run",
            f"{where.zh}，通道{name}在至多{share:.0%}的时间内保持同一数值，其余时间逐块变化：若传感器当时停滞，"
            "其系数有误；用--run略去这些试验",
        )
        yield Note("stopped", text, name, tuple(stopped), is_limit=True)


def _is_constant(having: Sequence[RunBlocks], name: str) -> bool:
    values = np.concatenate([run.mean(name) for run in having])
    values = values[np.isfinite(values)]
    return len(values) == 0 or float(np.ptp(values)) <= 1e-12 * float(np.abs(values).max())


def _check_copies(runs: Sequence[RunBlocks], names: Sequence[str]) -> Iterator[Note]:
    everywhere = [name for name in names if all(name in run.channels for run in runs)]
    values = {name: np.concatenate([run.mean(name) for run in runs]) for name in everywhere}
    for one, other in itertools.combinations(everywhere, 2):
        if not _BY_NATURE.issuperset((one, other)) and _is_copy(values[one], values[other]):
            text = Bilingual(
                f"channels {one} and {other} are copies of each other: their effects cannot be distinguished",
                f"通道{one}与{other}互为副本：二者的效应无法区分",
            )
            yield Note("copy", text, other)


def _is_copy(one: FloatArray, other: FloatArray) -> bool:
    both = np.isfinite(one) & np.isfinite(other)
    if both.sum() < _FEWEST_FOR_COPY or np.ptp(one[both]) == 0 or np.ptp(other[both]) == 0:
        return False
    with np.errstate(over="ignore", invalid="ignore"):  # values whose squares overflow are refused later
        return abs(float(np.corrcoef(one[both], other[both])[0, 1])) > _COPY


def clock_offsets(catalog: Catalog) -> dict[tuple[str, str], dict[str, float]]:
    """Least delay of the messages of each unit in each run, seconds, by signal; only of live runs in real time."""
    found: dict[tuple[str, str], dict[str, float]] = {}
    sql = "select run, unit, signal, offset_least_ns / 1e9 from clocks where reason is null"
    for run, unit, signal, seconds in catalog.rows(sql):
        found.setdefault((str(run), str(unit)), {})[str(signal)] = float(seconds)
    return found


def check_clocks(
    offsets: Mapping[tuple[str, str], Mapping[str, float]], unit: str, signal: str, beside: Sequence[tuple[str, str]]
) -> Iterator[Note]:
    """Notes on runs in which the clocks of a unit and of an instrument (run and name) are over a second apart."""
    apart: dict[str, dict[str, float]] = {}
    for run, instrument in beside:
        own, other = offsets.get((run, unit), {}).get(signal), offsets.get((run, instrument))
        if own is None or not other:
            continue
        seconds = own - min(other.values())
        if abs(seconds) > _CLOCK_APART_S:
            apart.setdefault(instrument, {})[run] = seconds
    for instrument, by_run in sorted(apart.items()):
        text = Bilingual(
            f"the clock of {instrument} is {_signed(by_run)} s off that of {unit} in run {', '.join(by_run)}: its "
            "channels are joined by their own clock",
            f"在试验{'、'.join(by_run)}中，{instrument}的时钟与{unit}相差{_signed(by_run)} s：其通道按自身时钟对齐",
        )
        yield Note("clock_offset", text, runs=tuple(by_run), is_limit=True)


def _signed(seconds_by_run: Mapping[str, float]) -> str:
    lo, hi = min(seconds_by_run.values()), max(seconds_by_run.values())
    return f"{lo:+.1f}" if hi - lo < 0.1 else f"{lo:+.1f} to {hi:+.1f}"


def check_labels(runs: Sequence[RunBlocks]) -> Iterator[Note]:
    """Notes on reference rates that the signal follows by a ratio of two units of measure: a label is wrong."""
    for name in ("input_rate", "table_rate"):
        ratios = {run.run: ratio for run in runs if (ratio := _ratio(run, name)) is not None}
        wrong: dict[float, list[str]] = {}
        for run, ratio in ratios.items():
            size = max(abs(ratio), 1.0 / abs(ratio))
            if (factor := next((each for each in _MISTAKES if abs(size / each - 1.0) < _NEAR), None)) is not None:
                wrong.setdefault(factor, []).append(run)
        for factor, names in wrong.items():
            ratio = abs(ratios[names[0]])
            shown = Bilingual(f"1/{1 / ratio:,.4g} of", f"1/{1 / ratio:,.4g}")
            if ratio > 1:
                shown = Bilingual(f"{ratio:,.4g} times", f"{ratio:,.4g}倍")
            signal, where, mistake = runs[0].signal, in_runs(names, len(runs)), _MISTAKES[factor]
            text = Bilingual(
                f"{signal} is {shown} {name} {where}, both in the units they are labelled with, {mistake}: correct the "
                f"label and import again, else every coefficient of {name} is wrong by this factor",
                f"{where.zh}，按所标单位，{signal}为{name}的{shown.zh}，疑为单位标注有误（{mistake.zh}）："
                f"请改正标注后重新导入，否则{name}的系数均差此倍数",
            )
            yield Note("unit_label", text, name, tuple(names), is_limit=True)


def _ratio(run: RunBlocks, name: str) -> float | None:
    """Slope of the signal over a rate, both in one unit; None where the signal does not follow it."""
    channel = run.channels.get(name)
    if channel is None or not is_angular_rate(run.unit_of_measure) or not is_angular_rate(channel.unit_of_measure):
        return None
    rate = channel.mean * conversion(channel.unit_of_measure, run.unit_of_measure)[0]
    known = np.isfinite(rate) & np.isfinite(run.value)
    if np.count_nonzero(known) < _FEWEST_FOR_RATIO:
        return None
    x, y = rate[known] - rate[known].mean(), run.value[known] - run.value[known].mean()
    xx, yy, xy = float(x @ x), float(y @ y), float(x @ y)
    if not (np.isfinite(xx) and np.isfinite(yy)) or xx <= 0.0 or yy <= 0.0 or xy**2 < _FOLLOWS * xx * yy:
        return None
    return xy / xx
