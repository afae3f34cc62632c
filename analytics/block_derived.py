"""Channels that nobody recorded but the record gives: input rate, gravity, acceleration, time since power-on, day."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from analytics.block_channels import slope
from analytics.block_checks import Note, in_runs
from analytics.block_means import SECOND_NS, Blocks
from analytics.run_blocks import Channel, RunBlocks
from analytics.step_channels import Step, by_position, commanded_rate, input_axis_up, unknown_positions
from stream.batch import BoolArray, FloatArray, IntArray
from stream.quantities import conversion, is_angular_rate

_DAY_NS = 86_400 * SECOND_NS
_SETTLED = 1e-3
_AT_REST_DEG_PER_S = 1e-3
_BEYOND_NOISE = 3.0
_BEYOND_USUAL = 10.0


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
    run : RunBlocks
        With the channels that were recorded.
    blocks : Blocks
        When the samples of each block were taken.
    steps : sequence of Step
        Of the unit in the run.
    turns : float or None
        Component of the table's axis along the input axis where positions do not tell; None where it is not known.
    numbers : mapping of str to float
        Number by which the channel ``position`` stands for a word.
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
    words = sorted({word for run in without for word in unknown_positions(steps.get(run.run, ()), run.signal)})
    names = tuple(run.run for run in without)
    if len(words) > 1:
        text = (
            f"no input_rate is recorded, and the positions {', '.join(words)} do not say how the input axis lies: "
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
                "along the input axis, as far as the position of a step does not say otherwise"
            )
            notes.append(Note("input_rate", text, "input_rate", tuple(runs), is_limit=True))
    return notes


def without_unresolved(
    run: RunBlocks, changes: FloatArray, interval_s: float, commanded: FloatArray
) -> tuple[RunBlocks, int]:
    """The run without the blocks in which the reference rate changes faster than its readings show, and how many.

    Parameters
    ----------
    run : RunBlocks
        With ``input_rate``.
    changes : array of shape (blocks,)
        By how much the reference changes from the last reading before each block to the first after it, in its unit.
    interval_s : float
        Between readings, seconds.
    commanded : array of shape (blocks,)
        Rate that a step commanded throughout the block, deg/s, else NaN; a block that has it is kept.

    Notes
    -----
    An edge somewhere between two readings leaves the mean of a block of T uncertain by edge*interval/(sqrt(12)*T). A
    block goes where that is beyond 3 standard deviations of the white noise of its mean, by the run's median, and
    beyond 10 times what is usual in the run (a tenth of its blocks are better).
    """
    channel = run.channels.get("input_rate")
    if channel is None or not is_angular_rate(run.unit_of_measure) or not is_angular_rate(channel.unit_of_measure):
        return run, 0
    factor = conversion(channel.unit_of_measure, run.unit_of_measure)[0]
    unsure = np.nan_to_num(changes) * factor * interval_s / (np.sqrt(12.0) * run.block_s)
    of_samples = run.white_variance * run.n
    of_samples = of_samples[np.isfinite(of_samples)]
    noise = np.sqrt((np.median(of_samples) if len(of_samples) else 0.0) / run.n)
    usual = float(np.quantile(unsure, 0.1))
    is_seen = unsure <= np.maximum(_BEYOND_NOISE * noise, _BEYOND_USUAL * usual)
    is_kept = is_seen | is_steady(run.channels.get("table_rate", channel), commanded)
    return kept(run, is_kept), int((~is_kept).sum())


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
