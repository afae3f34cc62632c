"""Channels that follow from the record, such as input rate and gravity."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.edge_slope import mean_slope_per_s
from analytics.loop.blocks.notes.reduction_notes import Note, in_runs
from analytics.loop.blocks.run_blocks import SECOND_NS, Channel, RunBlocks
from analytics.loop.blocks.signal_blocks import SignalBlocks
from analytics.loop.blocks.step_channels import (
    Step,
    by_axis,
    by_position,
    commanded_rate,
    input_axis_up,
    unknown_axes,
    unknown_positions,
)
from stream.batch import BoolArray, FloatArray, IntArray

_DAY_NS = 86_400 * SECOND_NS
_SETTLED = 1e-3
AT_REST_DEG_PER_S = 1e-3


def with_times(run: RunBlocks, power_on_ns: Sequence[int], first_day_ns: int | None) -> RunBlocks:
    """The run with ``time_since_power_on`` (of the last power-on; s) and ``day`` (days from `first_day_ns`)."""
    channels = dict(run.channels)
    at_ns, none = run.middle_ns, np.zeros(len(run))
    if "time_since_power_on" not in channels and len(power_on_ns) > 0:
        on_ns = np.array(sorted(power_on_ns), np.int64)
        before = np.searchsorted(on_ns, at_ns, side="right") - 1
        since_s = np.where(before >= 0, (at_ns - on_ns[np.maximum(before, 0)]) / SECOND_NS, np.nan)
        channels["time_since_power_on"] = Channel(since_s, none, "s")
    if "day" not in channels and run.is_date_known and first_day_ns is not None:
        channels["day"] = Channel((at_ns - first_day_ns) / _DAY_NS, none, "day")
    return replace(run, channels=channels)


def with_motion(
    run: RunBlocks, blocks: SignalBlocks, steps: Sequence[Step], turns: float | None, numbers: Mapping[str, float]
) -> RunBlocks:
    """The run with ``position``, ``input_rate``, ``gravity_i`` and ``table_acceleration`` as far as they are known.

    `turns` is the component of the table's axis along the input axis where positions do not define it, None if unknown;
    `numbers` is the number of each word in the channel ``position``.
    """
    channels = dict(run.channels)
    none = np.zeros(len(run))
    centre_ns = _at_ns(run, blocks.centre_s)
    position = by_position(steps, centre_ns, numbers.get)
    if "position" not in channels and np.isfinite(position).any():
        channels["position"] = Channel(position, none, "1")
    up = by_position(steps, centre_ns, lambda word: input_axis_up(word, run.signal))
    if "gravity_i" not in channels and np.isfinite(up).any():
        channels["gravity_i"] = Channel(up, none, "g_0")
    table, commanded = channels.get("table_rate"), commanded_in(run, blocks, steps)
    along = by_axis(steps, centre_ns, run.signal)
    if np.isfinite(along).any():  # an axis that points down turns the other way
        along = np.where(np.isfinite(up) & (np.isnan(along) | (along * up != 0.0)), up, along)
    else:
        along = up if np.isfinite(up).any() else np.full(len(run), np.nan if turns is None else turns)
    if "input_rate" not in channels and np.isfinite(along).any():
        if table is not None:
            spread = table.spread * np.abs(np.nan_to_num(along))
            inside = None if table.inside is None else table.inside.scaled(along)
            slope = None if table.slope_per_s is None else table.slope_per_s * along
            channels["input_rate"] = Channel(
                table.mean * along, spread, table.unit_of_measure, inside=inside, slope_per_s=slope
            )
        elif np.isfinite(commanded).any():
            channels["input_rate"] = Channel(commanded * along, none, "deg/s")
    if "table_acceleration" not in channels and table is not None and table.unit_of_measure == "deg/s":
        slope = mean_slope_per_s(run, "table_rate", across_gaps=False)
        turning = np.where(is_steady(table, commanded), 0.0, slope)
        channels["table_acceleration"] = Channel(turning, none, "deg/s^2")
    return replace(run, channels=channels)


def commanded_in(run: RunBlocks, blocks: SignalBlocks, steps: Sequence[Step]) -> FloatArray:
    """Commanded rate throughout the samples of each block, deg/s; NaN where there was none, or several."""
    return commanded_rate(steps, _at_ns(run, blocks.first_s), _at_ns(run, blocks.last_s))


def _at_ns(run: RunBlocks, seconds: FloatArray) -> IntArray:
    return run.t0_ns + np.round(seconds * SECOND_NS).astype(np.int64)


def is_steady(rate: Channel, commanded: FloatArray) -> BoolArray:
    """Mark blocks that lie in a step of one rate and measured that rate: a step begins when its rate has settled."""
    return np.asarray(np.abs(rate.mean - commanded) <= _SETTLED * np.abs(commanded) + AT_REST_DEG_PER_S, dtype=np.bool_)


def assumed_axis(steps: Mapping[str, Sequence[Step]], runs: Sequence[RunBlocks]) -> tuple[float | None, list[Note]]:
    """Component of the table's axis along the input axis where positions do not define it, and notes on it.

    Without a recorded input rate the input axis is assumed to lie along the table's axis; but if several positions or
    axes are named whose words are unknown, its direction varies, and there is no input rate.
    """
    without = [run for run in runs if "input_rate" not in run.channels]
    names = tuple(run.run for run in without)
    kinds = (Bilingual("axes", "转动轴"), unknown_axes), (Bilingual("positions", "位置"), unknown_positions)
    for kind, unknown in kinds:
        words = sorted({word for run in without for word in unknown(steps.get(run.run, ()), run.signal)})
        if len(words) > 1:
            text = Bilingual(
                f"no input_rate is recorded, and the {kind} {', '.join(words)} do not define the direction of the "
                "input axis: record or import channel input_rate",
                f"未记录input_rate，{kind.zh}{'、'.join(words)}也未说明输入轴方向：请记录或导入通道input_rate",
            )
            return None, [Note("no_input_rate", text, "input_rate", names, is_limit=True)]
    return 1.0, []


def source_of_input_rate(before: Sequence[RunBlocks], after: Sequence[RunBlocks]) -> Iterator[Note]:
    """Note the source of an input rate that is not recorded."""
    pairs = list(zip(before, after, strict=True))
    taken = [(old, new) for old, new in pairs if "input_rate" not in old.channels and "input_rate" in new.channels]
    commands = Bilingual("the steps' rate commands", "步骤的角速率指令")
    for source, has_table in ((Bilingual("table_rate", "table_rate"), True), (commands, False)):
        runs = [new.run for old, new in taken if ("table_rate" in old.channels) is has_table]
        if runs:
            where = in_runs(runs, len(before))
            text = Bilingual(
                f"input_rate is taken from {source} {where}: the table's axis is assumed to be the input axis unless "
                "the axis or position of a step says otherwise",
                f"{where.zh}input_rate取自{source.zh}：除非步骤的转动轴或位置另有说明，假定转台轴沿输入轴",
            )
            yield Note("input_rate", text, "input_rate", tuple(runs), is_limit=True)


def without_rest(runs: Sequence[RunBlocks]) -> list[RunBlocks]:
    """Runs without a derived acceleration of the table that is 0 everywhere."""
    name = "table_acceleration"
    if any(np.nan_to_num(run.mean(name)).any() for run in runs if name in run.channels):
        return list(runs)
    return [replace(run, channels={key: each for key, each in run.channels.items() if key != name}) for run in runs]


def split_at_power_ons(run: RunBlocks, power_on_ns: Sequence[int], fewest_blocks: int) -> list[RunBlocks]:
    """Power-ons within a run as runs of their own, ``RUN#1`` and so on, each with at least some blocks."""
    epoch = np.searchsorted(np.array(sorted(power_on_ns), np.int64), run.middle_ns, side="right")
    found = np.unique(epoch)
    if len(found) <= 1:
        return [run]
    parts = [run.part(epoch == each) for each in found]
    return [replace(part, run=f"{run.run}#{i}") for i, part in enumerate(parts, 1) if len(part) >= fewest_blocks]
