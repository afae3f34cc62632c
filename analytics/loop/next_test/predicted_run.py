"""The blocks of a run that has not been done yet: its channels, from the settings and the unit's own runs."""

from collections.abc import Mapping, Sequence
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
_HEAT_S = np.geomspace(300.0, 7200.0, 12)
_FEWEST_HEATED, _LEFT_OF_HEAT, _MOST_HEAT_DEG_C = 20, 0.5, 30.0
_GRAVITY = ("gravity_i", "gravity_o", "gravity_s")
_RATE_UNIT = "deg/s"
_DAY_NS = 86_400 * SECOND_NS


@dataclass(frozen=True)
class ThermalChain:
    """Time constants in seconds, and offsets, between the channels of temperature; how far a unit heats itself."""

    lag_s: dict[str, float]
    offset: dict[str, float]
    heat_deg_c: float = 0.0
    heat_s: float = 1800.0

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
        return cls(lag_s, offset, *_self_heating(runs, lag_s["temperature"]))

    def play(self, air: FloatArray, setpoint: FloatArray, since_s: FloatArray) -> dict[str, FloatArray]:
        """Each channel of temperature while air and set-point change, and the unit heats itself after power-on."""
        found = {"chamber_setpoint": setpoint, "chamber_temperature": air + self.offset["chamber_temperature"]}
        for name, before in zip(CHAIN[2:], CHAIN[1:-1], strict=True):
            found[name] = _lagged(found[before], self.lag_s[name]) + self.offset[name]
        found["temperature"] = found["temperature"] - self.heat_deg_c * np.exp(-since_s / self.heat_s)
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


def _self_heating(runs: Sequence[RunBlocks], lag_s: float) -> tuple[float, float]:
    """Rise of the temperature after power-on, and its time constant: a decay that the case does not explain."""
    needed = {"temperature", "case_temperature", "time_since_power_on"}
    some = [run for run in runs if needed <= set(run.channels) and len(run) > _FEWEST_HEATED]
    # a run that begins long after power-on shows none of it
    some = [run for run in some if np.nanmin(run.mean("time_since_power_on")) < min(_HEAT_S)]
    best = (np.inf, 0.0, 1800.0)
    before = 0.0
    for tau in _HEAT_S if some else ():
        left = squares = products = before = 0.0
        for run in some:
            apart = run.mean("temperature") - _followed(run, "case_temperature", lag_s)
            decay = np.exp(-run.mean("time_since_power_on") / tau)
            known = np.isfinite(apart) & np.isfinite(decay)
            y, x = apart[known] - apart[known].mean(), decay[known] - decay[known].mean()
            before, squares, products = before + float(y @ y), squares + float(x @ x), products + float(x @ y)
        left = before - products**2 / max(squares, 1e-300)
        best = min(best, (left, -products / max(squares, 1e-300), float(tau)))
    is_seen = best[0] < _LEFT_OF_HEAT * before and 0.0 < best[1] < _MOST_HEAT_DEG_C
    return (best[1], best[2]) if is_seen else (0.0, 1800.0)


def _followed(run: RunBlocks, source: str, lag_s: float) -> FloatArray:
    """A channel of a run after a lag, at its blocks."""
    time_s, values = run.time_s, run.mean(source)
    known = np.isfinite(values)
    if not known.any():
        return values
    grid = np.arange(time_s[0], time_s[-1] + STEP_S, STEP_S)
    return np.interp(time_s, grid, _lagged(np.interp(grid, time_s[known], values[known]), lag_s))


def predicted_runs(
    plan: Timeline, runs: Sequence[RunBlocks], chain: ThermalChain, name: str, positions: Mapping[str, float]
) -> list[RunBlocks]:
    """The run as it would be reduced, its signal zero; each power-on is a run of its own.

    Channels that the settings decide follow them; the supply current follows voltage and temperature as in the unit's
    runs; the others stay at their median in the calmest run, and other rates than those of the library at 0 at rest.
    `positions` are the numbers of the words in the channel ``position``.
    """
    like = min(runs, key=_unrest)
    of_block = round(like.block_s / STEP_S)
    blocks = plan.rate_deg_per_s.size // of_block
    moved = _moved(plan, chain, like)
    if any(plan.position):
        moved |= _mounted(plan, runs, positions)
    kept = plan.is_powered[: blocks * of_block].reshape(blocks, of_block).all(axis=1)
    word = np.unique(plan.position, return_inverse=True)[1][: blocks * of_block].reshape(blocks, of_block)
    kept &= (word == word[:, :1]).all(axis=1)
    slot = np.flatnonzero(kept)
    channels = {}
    is_turning = bool(np.any(plan.rate_deg_per_s != 0.0))
    for channel, own in like.channels.items():
        if channel == "day":
            series = np.nanmax([np.nanmax(run.mean("day")) for run in runs]) + 1.0 + plan.time_s / 86_400.0
            channels[channel] = _reduced(series, slot, of_block, own.unit_of_measure)
        elif channel in moved:
            channels[channel] = _reduced(moved[channel], slot, of_block, own.unit_of_measure, channel)
        else:
            # what no setting moves is not counted on to move
            share = float(is_turning) if own.unit_of_measure == _RATE_UNIT else 1.0
            held = np.full(slot.size, share * float(np.nanmedian(own.mean)))
            channels[channel] = Channel(held, np.full(slot.size, float(np.nanmedian(own.spread))), own.unit_of_measure)
    whole = RunBlocks(
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
        channels=channels | _following(runs, like, channels),
    )
    epoch = plan.power_on[slot * of_block]
    numbers = np.unique(epoch)
    if numbers.size <= 1:
        return [whole]
    return [replace(whole.part(epoch == each), run=f"{name}#{k}") for k, each in enumerate(numbers, 1)]


def _following(runs: Sequence[RunBlocks], like: RunBlocks, played: Mapping[str, Channel]) -> dict[str, Channel]:
    """The supply current, as a linear function of voltage and temperature in the unit's runs."""
    drivers = [name for name in ("supply_voltage", "temperature") if all(name in run.channels for run in runs)]
    if not drivers or not all("supply_current" in run.channels for run in runs):
        return {}
    design = np.column_stack([np.concatenate([run.mean(name) for run in runs]) for name in drivers])
    current = np.concatenate([run.mean("supply_current") for run in runs])
    known = np.isfinite(design).all(axis=1) & np.isfinite(current)
    if np.count_nonzero(known) < 10:
        return {}
    middle, scale = design[known].mean(axis=0), design[known].std(axis=0) + 1e-12
    slopes = np.linalg.lstsq((design[known] - middle) / scale, current[known] - current[known].mean(), rcond=1e-6)[0]
    own = like.channels["supply_current"]
    before = np.array([np.nanmedian(like.mean(name)) for name in drivers])
    after = np.column_stack([played[name].mean for name in drivers])
    mean = float(np.nanmedian(own.mean)) + (after - before) / scale @ slopes
    spread = np.full(mean.size, float(np.nanmedian(own.spread)))
    return {"supply_current": Channel(mean, spread, own.unit_of_measure)}


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


def _moved(plan: Timeline, chain: ThermalChain, like: RunBlocks) -> dict[str, FloatArray]:
    """The channels that the settings decide, at the instants of the plan."""
    found: dict[str, FloatArray] = {"time_since_power_on": np.nan_to_num(plan.since_power_on_s)}
    heated = np.isfinite(plan.air_deg_c)
    if heated.any():
        first = int(np.argmax(heated))
        air = np.where(heated, plan.air_deg_c, plan.air_deg_c[first])
        setpoint = np.where(heated, plan.setpoint_deg_c, plan.setpoint_deg_c[first])
        found |= chain.play(air, setpoint, np.nan_to_num(plan.since_power_on_s))
    # without a word the unit stays as it was mounted
    held = {name: np.full(plan.time_s.size, _first(like, name)) for name in (*_GRAVITY, "position")}
    found |= {name: values for name, values in held.items() if np.isfinite(values).all()}
    rate = plan.rate_deg_per_s
    found |= {"table_rate": rate, "table_acceleration": np.gradient(rate, STEP_S)}
    found |= {"input_rate": rate, "rate_o": 0.0 * rate, "rate_s": 0.0 * rate}
    start = 0.0 if np.isfinite(plan.angle_deg).all() else _first(like, "table_angle")
    found["table_angle"] = start + np.cumsum(rate) * STEP_S
    if np.isfinite(plan.volts).any():
        found["supply_voltage"] = np.asarray(plan.volts)
    return found


def _first(run: RunBlocks, name: str) -> float:
    """First value of a channel; NaN without one."""
    values = run.mean(name) if name in run.channels else np.empty(0)
    values = values[np.isfinite(values)]
    return float(values[0]) if values.size else float("nan")


def _mounted(plan: Timeline, runs: Sequence[RunBlocks], positions: Mapping[str, float]) -> dict[str, FloatArray]:
    """Components of the vertical along the axes, rates about them, and the number of each position.

    A position of the unit's runs has what they recorded in it; others follow from their words.
    """
    words = sorted(set(plan.position))
    at = np.searchsorted(words, plan.position)
    last = max([0.0, *positions.values()])
    numbers = [positions.get(word, last + 1.0 + k) for k, word in enumerate(words)]
    found = {"position": np.array(numbers)[at]}
    for channel, axis in zip(_GRAVITY, ("IRA", "OA", "SA"), strict=True):
        ups = [_recorded_in(runs, channel, positions.get(word)) for word in words]
        # the word of another axis counts for this one as that of its own
        declared = [input_axis_up(word.replace(axis, "IRA"), runs[0].signal) if axis in word else 0.0 for word in words]
        both = [other if own is None else own for own, other in zip(ups, declared, strict=True)]
        found[channel] = np.array([np.nan if up is None else up for up in both], dtype=np.float64)[at]
    names = ("input_rate", "rate_o", "rate_s")
    return found | {name: plan.rate_deg_per_s * found[of] for name, of in zip(names, _GRAVITY, strict=True)}


def _recorded_in(runs: Sequence[RunBlocks], channel: str, number: float | None) -> float | None:
    """Median of a channel in a position of the runs; None if they do not have it."""
    both = [run for run in runs if channel in run.channels and "position" in run.channels]
    values = np.concatenate([run.mean(channel)[run.mean("position") == number] for run in both] or [np.empty(0)])
    return float(np.median(values)) if values.size and np.isfinite(values).all() else None


def _reduced(values: FloatArray, slot: IntArray, of_block: int, unit: str, name: str = "") -> Channel:
    parts = values[: values.size // of_block * of_block].reshape(-1, of_block)[slot]
    phasors = None
    if name == "table_angle":
        turned = np.exp(1j * np.deg2rad(parts))
        phasors = np.stack([(turned**k).mean(axis=1) for k in range(1, HARMONICS + 1)])
    return Channel(parts.mean(axis=1), parts.std(axis=1), unit, phasors)
