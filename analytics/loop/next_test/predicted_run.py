"""The blocks of a run that has not been done yet: its channels, from the settings and the unit's own runs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from analytics.loop.blocks.run_blocks import HARMONICS, SECOND_NS, Channel, RunBlocks
from analytics.loop.blocks.step_channels import input_axis_up
from analytics.loop.next_test.timeline import STEP_S, Timeline
from stream.batch import FloatArray, IntArray

CHAIN = ("chamber_setpoint", "chamber_temperature", "case_temperature", "temperature")
"""Each channel of temperature follows the one before it that is recorded, as a first-order lag."""
_USUAL_LAG_S = {"chamber_temperature": 200.0, "case_temperature": 900.0, "temperature": 900.0}
_LAGS_S = np.geomspace(15.0, 7200.0, 40)
_LEAST_MOVED = 2.0
_DAY_NS = 86_400 * SECOND_NS


@dataclass(frozen=True)
class ThermalChain:
    """Time constants in seconds, and offsets, between the channels of temperature."""

    lag_s: dict[str, float]
    offset: dict[str, float]

    @classmethod
    def of_runs(cls, runs: Sequence[RunBlocks]) -> "ThermalChain":
        """Fit each lag to the runs in which the channel before it moves; a usual one where none does."""
        lag_s, offset = {}, {}
        for name, before in zip(CHAIN[1:], CHAIN[:-1], strict=True):
            lag_s[name], offset[name] = _USUAL_LAG_S[name], 0.0
            both = [run for run in runs if name in run.channels and before in run.channels]
            moved = [run for run in both if np.ptp(run.mean(before)) > _LEAST_MOVED]
            if moved:
                errors = [sum(_lag_error(run, before, name, float(lag)) for run in moved) for lag in _LAGS_S]
                lag_s[name] = float(_LAGS_S[int(np.argmin(errors))])
            if both:
                apart = [run.mean(name)[-len(run) // 2 :] - run.mean(before)[-len(run) // 2 :] for run in both]
                offset[name] = float(np.nanmedian(np.concatenate(apart)))
        return cls(lag_s, offset)

    def play(self, air: FloatArray, setpoint: FloatArray) -> dict[str, FloatArray]:
        """Each channel of temperature while air and set-point change."""
        found = {"chamber_setpoint": setpoint, "chamber_temperature": air + self.offset["chamber_temperature"]}
        for name, before in zip(CHAIN[2:], CHAIN[1:-1], strict=True):
            found[name] = _lagged(found[before], self.lag_s[name]) + self.offset[name]
        return found


def _lagged(values: FloatArray, lag_s: float) -> FloatArray:
    from scipy.signal import lfilter  # slow to import

    share = -np.expm1(-STEP_S / lag_s)
    return np.asarray(lfilter([share], [1.0, share - 1.0], values, zi=[(1.0 - share) * values[0]])[0])


def _lag_error(run: RunBlocks, before: str, name: str, lag_s: float) -> float:
    """Variance that a lag leaves of a channel in a run, its offset free."""
    time_s, source, target = run.time_s, run.mean(before), run.mean(name)
    known = np.isfinite(source) & np.isfinite(target)
    if np.count_nonzero(known) < 10:
        return 0.0
    grid = np.arange(time_s[known][0], time_s[known][-1] + STEP_S, STEP_S)
    followed = np.interp(time_s[known], grid, _lagged(np.interp(grid, time_s[known], source[known]), lag_s))
    return float(np.var((target[known] - followed)[10:]))


def predicted_run(plan: Timeline, runs: Sequence[RunBlocks], chain: ThermalChain, name: str) -> RunBlocks:
    """The run as it would be reduced, its signal zero.

    Channels that the settings decide follow them; the others are as in the calmest run, repeated.
    """
    like = min(runs, key=_unrest)
    of_block = round(like.block_s / STEP_S)
    blocks = plan.rate_deg_per_s.size // of_block
    moved = _moved(plan, chain, like.signal)
    kept = plan.is_powered[: blocks * of_block].reshape(blocks, of_block).all(axis=1)
    slot = np.flatnonzero(kept)
    channels = {}
    for channel, own in like.channels.items():
        if channel == "day":
            series = np.nanmax([np.nanmax(run.mean("day")) for run in runs]) + 1.0 + plan.time_s / 86_400.0
            channels[channel] = _reduced(series, slot, of_block, own.unit_of_measure)
        elif channel in moved:
            channels[channel] = _reduced(moved[channel], slot, of_block, own.unit_of_measure, channel)
        else:
            rows = np.arange(slot.size) % len(like)
            phasors = None if own.phasors is None else own.phasors[:, rows]
            channels[channel] = Channel(own.mean[rows], own.spread[rows], own.unit_of_measure, phasors)
    return RunBlocks(
        unit=like.unit,
        run=name,
        signal=like.signal,
        slot=slot,
        block_s=like.block_s,
        t0_ns=max(run.t0_ns for run in runs) + _DAY_NS,
        value=np.zeros(slot.size),
        n=np.full(slot.size, int(np.median(like.n))),
        white_variance=np.full(slot.size, np.nan),
        unit_of_measure=like.unit_of_measure,
        channels=channels,
    )


def repeated_run(run: RunBlocks, name: str, last_ns: int) -> RunBlocks:
    """The run once more, on another day."""
    days = (last_ns + _DAY_NS - run.t0_ns) / _DAY_NS
    channels = dict(run.channels)
    if "day" in channels:
        day = channels["day"]
        channels["day"] = replace(day, mean=day.mean + days)
    return replace(run, run=name, t0_ns=last_ns + _DAY_NS, channels=channels, value=np.zeros(len(run)))


def _unrest(run: RunBlocks) -> float:
    """How much a run moves: turning and heating count most."""
    names = [name for name in ("input_rate", "table_rate", "temperature") if name in run.channels]
    return float(sum(np.nanstd(run.mean(name)) for name in names)) + 1e-9 / max(len(run), 1)


def _moved(plan: Timeline, chain: ThermalChain, signal: str) -> dict[str, FloatArray]:
    """The channels that the settings decide, at the instants of the plan."""
    found: dict[str, FloatArray] = {"time_since_power_on": np.nan_to_num(plan.since_power_on_s)}
    heated = np.isfinite(plan.air_deg_c)
    if heated.any():
        first = int(np.argmax(heated))
        air = np.where(heated, plan.air_deg_c, plan.air_deg_c[first])
        setpoint = np.where(heated, plan.setpoint_deg_c, plan.setpoint_deg_c[first])
        found |= chain.play(air, setpoint)
    rate = plan.rate_deg_per_s
    found |= {"input_rate": rate, "table_rate": rate, "table_acceleration": np.gradient(rate, STEP_S)}
    if np.any(rate != 0.0):
        found["table_angle"] = np.cumsum(rate) * STEP_S
        found |= {"rate_o": 0.0 * rate, "rate_s": 0.0 * rate}
    if any(plan.position):
        found |= _gravity(plan, signal)
    if np.isfinite(plan.volts).any():
        found["supply_voltage"] = np.asarray(plan.volts)
    return found


def _gravity(plan: Timeline, signal: str) -> dict[str, FloatArray]:
    """Components of the vertical along the axes, and the number of each position."""
    words = sorted(set(plan.position))
    at = np.searchsorted(words, plan.position)
    found = {"position": np.asarray(at + 1.0, dtype=np.float64)}
    for channel, axis in (("gravity_i", "IRA"), ("gravity_o", "OA"), ("gravity_s", "SA")):
        # the word of another axis counts for this one as that of its own
        ups = [input_axis_up(word.replace(axis, "IRA"), signal) if axis in word else 0.0 for word in words]
        found[channel] = np.array([np.nan if up is None else up for up in ups], dtype=np.float64)[at]
    return found


def _reduced(values: FloatArray, slot: IntArray, of_block: int, unit: str, name: str = "") -> Channel:
    parts = values[: values.size // of_block * of_block].reshape(-1, of_block)[slot]
    phasors = None
    if name == "table_angle":
        turned = np.exp(1j * np.deg2rad(parts))
        phasors = np.stack([(turned**k).mean(axis=1) for k in range(1, HARMONICS + 1)])
    return Channel(parts.mean(axis=1), parts.std(axis=1), unit, phasors)
