"""Channels that nobody recorded but the record gives: input rate, gravity, acceleration, time since power-on, day."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from analytics.block_channels import slope, unresolved
from analytics.block_checks import Note, in_runs
from analytics.block_means import SECOND_NS
from analytics.run_blocks import Channel, RunBlocks
from analytics.step_channels import Step, by_position, commanded_rate, unknown_positions
from stream.batch import BoolArray, FloatArray, IntArray
from stream.quantities import conversion, is_angular_rate

_DAY_NS = 86_400 * SECOND_NS
_BEYOND_NOISE = 3.0
_BEYOND_USUAL = 10.0


def middle_ns(run: RunBlocks) -> IntArray:
    """Middle of each block, ns UTC."""
    half = round(run.block_s * SECOND_NS) // 2
    return run.t0_ns + run.slot * round(run.block_s * SECOND_NS) + half


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


def with_motion(run: RunBlocks, steps: Sequence[Step], turns: float | None) -> RunBlocks:
    """The run with ``input_rate``, ``gravity_i`` and ``table_acceleration`` where they can be had from what is there.

    Parameters
    ----------
    run : RunBlocks
        With the channels that were recorded.
    steps : sequence of Step
        Of the unit in the run.
    turns : float or None
        Component of the table's axis along the input axis where positions do not tell; None where it is not known.
    """
    channels = dict(run.channels)
    none = np.zeros(len(run))
    up = by_position(steps, middle_ns(run), run.signal)
    if "gravity_i" not in channels and np.isfinite(up).any():
        channels["gravity_i"] = Channel(up, none, "g_0")
    table = channels.get("table_rate")
    along = up if np.isfinite(up).any() else np.full(len(run), np.nan if turns is None else turns)
    if "input_rate" not in channels and np.isfinite(along).any():
        if table is not None:
            spread = table.spread * np.abs(np.nan_to_num(along))
            channels["input_rate"] = Channel(table.mean * along, spread, table.unit_of_measure)
        else:
            block_ns = round(run.block_s * SECOND_NS)
            start_ns = run.t0_ns + run.slot * block_ns
            commanded = commanded_rate(steps, start_ns, start_ns + block_ns)
            if np.isfinite(commanded).any():
                channels["input_rate"] = Channel(commanded * along, none, "deg/s")
    if "table_acceleration" not in channels and table is not None:
        acceleration = slope(run.slot, run.block_s, table.mean)
        channels["table_acceleration"] = Channel(acceleration, none, f"{table.unit_of_measure}^2")
    return replace(run, channels=channels)


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


def without_unresolved(run: RunBlocks, interval_s: float) -> tuple[RunBlocks, int]:
    """The run without the blocks in which the reference rate changes faster than its readings show, and how many.

    A block goes where that makes its input rate uncertain by more than 3 standard deviations of the gyro's own white
    noise and by more than 10 times what is usual in the run (a tenth of its blocks are better).
    """
    channel = run.channels.get("input_rate")
    if channel is None or not is_angular_rate(run.unit_of_measure) or not is_angular_rate(channel.unit_of_measure):
        return run, 0
    if interval_s <= 0.0:
        return run, 0
    factor = conversion(channel.unit_of_measure, run.unit_of_measure)[0]
    unsure = unresolved(run.slot, run.block_s / interval_s, channel) * factor
    if not np.isfinite(unsure).any():
        return run, 0
    noise = np.sqrt(np.where(np.isfinite(run.white_variance), run.white_variance, 0.0))
    usual = float(np.nanquantile(unsure, 0.1))
    is_kept = ~(unsure > np.maximum(_BEYOND_NOISE * noise, _BEYOND_USUAL * usual))
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
