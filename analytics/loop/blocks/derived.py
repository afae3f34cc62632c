"""Channels that nobody recorded but the record gives: input rate, gravity, acceleration, time since power-on, day."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from analytics.loop.blocks.channels import slope
from analytics.loop.blocks.checks import Note, in_runs
from analytics.loop.blocks.means import SECOND_NS, Blocks
from analytics.loop.blocks.run_blocks import Channel, RunBlocks
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
from stream.quantities import conversion, is_angular_rate

_DAY_NS = 86_400 * SECOND_NS
_SETTLED = 1e-3
_AT_REST_DEG_PER_S = 1e-3
_BEYOND_NOISE = 3.0
_BEYOND_USUAL = 10.0
_AS_OFTEN = 1.05
"""Interval between readings of the reference over that between samples up to which both may be of the same times."""
_MOVING_DEG_PER_S, _ALONG = 0.1, 0.1
"""Change of a reference that is an edge in any run, where the signal goes with it by more than this part."""
_FEWEST_STEADY = 10
_FOLLOWED = 0.02
"""Part of an edge that the signal may miss of it where both are means over the same times."""


def middle_ns(run: RunBlocks) -> IntArray:
    """Middle of each block, ns UTC."""
    half = round(run.block_s * SECOND_NS) // 2
    return run.t0_ns + run.slot * round(run.block_s * SECOND_NS) + half


def is_table(run: RunBlocks) -> bool:
    """Whether it is a table of means, one sample a block: its times say little, its scatter nothing."""
    return not np.isfinite(run.white_variance).any()


def with_times(run: RunBlocks, power_on_ns: Sequence[int], first_day_ns: int | None) -> RunBlocks:
    """The run with ``time_since_power_on`` (of the last power-on; s) and ``day`` (days from `first_day_ns`)."""
    channels = dict(run.channels)
    at_ns = middle_ns(run)
    none = np.zeros(len(run))
    if "time_since_power_on" not in channels and len(power_on_ns) > 0:
        on_ns = np.array(sorted(power_on_ns), np.int64)
        before = np.searchsorted(on_ns, at_ns, side="right") - 1
        since_s = np.where(before >= 0, (at_ns - on_ns[np.maximum(before, 0)]) / SECOND_NS, np.nan)
        channels["time_since_power_on"] = Channel(since_s, none, "s")
    if "day" not in channels and run.is_date_known and first_day_ns is not None:
        channels["day"] = Channel((at_ns - first_day_ns) / _DAY_NS, none, "day")
    return replace(run, channels=channels)


def with_motion(
    run: RunBlocks, blocks: Blocks, steps: Sequence[Step], turns: float | None, numbers: Mapping[str, float]
) -> RunBlocks:
    """The run with ``position`` and what can be had of ``input_rate``, ``gravity_i`` and ``table_acceleration``.

    Parameters
    ----------
    run: With the channels that were recorded.
    blocks: When the samples of each block were taken.
    steps: Of the unit in the run.
    turns: Component of the table's axis along the input axis where positions do not tell; None where it is not known.
    numbers: Number by which the channel ``position`` stands for a word.
    """
    channels = dict(run.channels)
    none = np.zeros(len(run))
    centre_ns = run.t0_ns + np.round(blocks.centre_s * SECOND_NS).astype(np.int64)
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
            channels["input_rate"] = Channel(table.mean * along, spread, table.unit_of_measure)
        elif np.isfinite(commanded).any():
            channels["input_rate"] = Channel(commanded * along, none, "deg/s")
    if "table_acceleration" not in channels and table is not None and table.unit_of_measure == "deg/s":
        turning = np.where(is_steady(table, commanded), 0.0, slope(run.slot, run.block_s, table.mean))
        channels["table_acceleration"] = Channel(turning, none, "deg/s^2")
    return replace(run, channels=channels)


def commanded_in(run: RunBlocks, blocks: Blocks, steps: Sequence[Step]) -> FloatArray:
    """Rate that was commanded while all samples of a block were taken, deg/s; NaN where there was none, or several."""
    first_ns, last_ns = (
        run.t0_ns + np.round(each * SECOND_NS).astype(np.int64) for each in (blocks.first_s, blocks.last_s)
    )
    return commanded_rate(steps, first_ns, last_ns)


def is_steady(rate: Channel, commanded: FloatArray) -> BoolArray:
    """Whether a block lies in a step of one rate, and that was measured: a step begins when its rate is settled."""
    return np.asarray(
        np.abs(rate.mean - commanded) <= _SETTLED * np.abs(commanded) + _AT_REST_DEG_PER_S, dtype=np.bool_
    )


def supposed_axis(steps: Mapping[str, Sequence[Step]], runs: Sequence[RunBlocks]) -> tuple[float | None, list[Note]]:
    """How the table's axis lies where positions do not tell, and what is to be said of it.

    Without a recorded input rate the input axis is supposed to lie along the table's axis; but where several positions
    are named whose words say nothing, it lies now this way, now that, and there is no input rate.
    """
    without = [run for run in runs if "input_rate" not in run.channels]
    if not without:
        return 1.0, []
    names = tuple(run.run for run in without)
    for kind, unknown in (("axes", unknown_axes), ("positions", unknown_positions)):
        words = sorted({word for run in without for word in unknown(steps.get(run.run, ()), run.signal)})
        if len(words) > 1:
            text = (
                f"no input_rate is recorded, and the {kind} {', '.join(words)} do not say how the input axis lies: "
                "there is no input rate; record or import it as channel input_rate"
            )
            return None, [Note("no_input_rate", text, "input_rate", names, is_limit=True)]
    return 1.0, []


def source_of_input_rate(before: Sequence[RunBlocks], after: Sequence[RunBlocks]) -> list[Note]:
    """Say where an input rate was taken from that nobody recorded."""
    pairs = list(zip(before, after, strict=True))
    taken = [(old, new) for old, new in pairs if "input_rate" not in old.channels and "input_rate" in new.channels]
    notes = []
    for source, has_table in (("table_rate", True), ("the steps' rate commands", False)):
        runs = [new.run for old, new in taken if ("table_rate" in old.channels) is has_table]
        if runs:
            text = (
                f"input_rate is taken from {source} {in_runs(runs, len(before))}: the table's axis is supposed to lie "
                "along the input axis, as far as the axis or position of a step does not say otherwise"
            )
            notes.append(Note("input_rate", text, "input_rate", tuple(runs), is_limit=True))
    return notes


def unresolved(
    run: RunBlocks, changes: FloatArray, interval_s: float, commanded: FloatArray, gone: BoolArray
) -> BoolArray:
    """Mark the blocks in which the reference rate changes faster than its readings show.

    Parameters
    ----------
    run: With ``input_rate``.
    changes: shape (blocks,); by how much the reference changes from the last reading before each block to the first
        after it, in its unit.
    interval_s: Between readings, seconds.
    commanded: shape (blocks,); rate that a step commanded throughout the block, deg/s, else NaN; a block that has it is
        kept.
    gone: shape (blocks,); blocks that count for nothing.

    Notes
    -----
    An edge somewhere between two readings leaves the mean of a block of T uncertain by edge*interval/(sqrt(12)*T). A
    block goes where that is beyond 3 standard deviations of the white noise of its mean, by the run's median, and
    beyond 10 times what is usual in the run (a tenth of its blocks are better). Where samples come as seldom as the
    readings, they may be means over the same times, and show every edge as it is: then the samples tell, see
    `is_followed`.
    """
    channel = run.channels.get("input_rate")
    none = np.zeros(len(run), dtype=np.bool_)
    if channel is None or not is_angular_rate(run.unit_of_measure) or not is_angular_rate(channel.unit_of_measure):
        return none
    factor = conversion(channel.unit_of_measure, run.unit_of_measure)[0]
    edges = np.nan_to_num(changes) * factor
    unsure = edges * interval_s / (np.sqrt(12.0) * run.block_s)
    of_samples = run.white_variance * run.n
    of_samples = of_samples[np.isfinite(of_samples)]
    noise = np.sqrt((np.median(of_samples) if len(of_samples) else 0.0) / run.n)
    usual = float(np.quantile(unsure, 0.1))
    is_seen = unsure <= np.maximum(_BEYOND_NOISE * noise, _BEYOND_USUAL * usual)
    is_seen |= is_steady(run.channels.get("table_rate", channel), commanded)
    across = np.asarray(~is_seen & ~gone)
    if interval_s > _AS_OFTEN * run.block_s / float(np.median(run.n)):
        return across
    reference, least = channel.mean * factor, conversion("deg/s", run.unit_of_measure)[0] * _MOVING_DEG_PER_S
    # where all of a run moves, no block stands out from what is usual
    is_still = is_steady(run.channels.get("table_rate", channel), commanded)
    moving = across | ((edges > least) & (unsure > _BEYOND_NOISE * noise) & ~is_still & ~gone)
    if is_followed(run.value, reference, edges, moving):
        return none
    known = np.isfinite(run.value) & np.isfinite(reference) & ~gone
    along = _line(reference[known], run.value[known]) if known.any() else None
    return moving if along is not None and abs(along) > _ALONG else across


def is_followed(value: FloatArray, reference: FloatArray, edges: FloatArray, rows: BoolArray) -> bool:
    """Whether a signal goes with its reference in blocks across edges as in others: both are means over one time.

    Readings at one moment of a block miss half of an edge within it by a third of the edge. The signal less the
    reference shows it; the line between them comes from the blocks without edges, where they turn at all. The scatter
    of those blocks is no miss.

    Parameters
    ----------
    value, reference: shape (blocks,); in one unit.
    edges: shape (blocks,); by how much the reference changes about each block.
    rows: shape (blocks,); blocks across edges.

    Examples
    --------
    >>> reference = np.array([0.0, 0.0, 4.0, 10.0, 10.0, 3.0, -10.0, -10.0])
    >>> edges = np.abs(np.gradient(reference)) * 2
    >>> means, readings = 1.001 * reference, np.array([0.0, 0.0, 10.0, 10.0, 10.0, 10.0, -10.0, -10.0])
    >>> [is_followed(value, reference, edges, np.arange(8) % 3 == 2) for value in (means, readings)]
    [True, False]
    """
    known = np.isfinite(value) & np.isfinite(reference)
    rows = rows & known & (edges > 0)
    if not rows.any():
        return True
    steady = known & ~rows
    scale = _line(reference[steady], value[steady]) if np.count_nonzero(steady) > 1 else None
    if scale is None:
        scale = _line(reference[known], value[known])
    if scale is None:
        return False
    missed = value - scale * reference
    missed = np.abs(missed - np.median(missed[steady] if steady.any() else missed[known]))
    noise = float(np.median(missed[steady])) if np.count_nonzero(steady) >= _FEWEST_STEADY else 0.0
    allowed = _FOLLOWED * max(1.0, abs(scale)) * edges + _BEYOND_NOISE * noise
    return bool(np.median(missed[rows] / allowed[rows]) <= 1.0)


def _line(x: FloatArray, y: FloatArray) -> float | None:
    """Slope of a line, None where nothing moves along it; an axis across the reference's own has nearly none."""
    off = x - x.mean()
    squares = float(off @ off)
    return float(off @ y) / squares if squares > 0 and np.ptp(x) > _AT_REST_DEG_PER_S else None


def kept(run: RunBlocks, rows: BoolArray) -> RunBlocks:
    """The run with these blocks only."""
    return replace(
        run,
        slot=run.slot[rows],
        value=run.value[rows],
        n=run.n[rows],
        white_variance=run.white_variance[rows],
        channels={
            name: Channel(
                each.mean[rows],
                each.spread[rows],
                each.unit_of_measure,
                None if each.phasors is None else each.phasors[:, rows],
            )
            for name, each in run.channels.items()
        },
    )


def split_at_power_ons(run: RunBlocks, power_on_ns: Sequence[int], fewest_blocks: int) -> list[RunBlocks]:
    """Power-ons within a run as runs of their own, ``RUN#1`` and so on: each has its own turn-on bias.

    Those with fewer blocks stay out, unless none has more.
    """
    at_ns = middle_ns(run)
    epoch = np.searchsorted(np.array(sorted(power_on_ns), np.int64), at_ns, side="right")
    found: list[FloatArray | BoolArray] = [epoch == each for each in np.unique(epoch)]
    if len(found) <= 1:
        return [run]
    parts = [kept(run, np.asarray(rows, np.bool_)) for rows in found]
    return [replace(part, run=f"{run.run}#{i}") for i, part in enumerate(parts, 1) if len(part) >= fewest_blocks]
