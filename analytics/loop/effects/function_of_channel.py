"""General functions of one channel, for errors that no named effect describes."""

from collections.abc import Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, EffectKind, Inputs, Shape, ShapeParameter, numbers, range_over
from analytics.loop.effects.block_kernels import block_means, mean_excess
from analytics.loop.effects.channel_names import channel_name
from stream.batch import FloatArray, IntArray

_KNOTS, _POSITIONS = "knots", "positions"
_RATE_PARTS = (0.01, 0.025, 0.05, 0.25, 0.5, 1.0)
_DEGREE = 3
_NEAR = 0.45  # share of the way to the next knot within which data are a knot's own


class FunctionOfChannel(Effect):
    """Any smooth function of one channel, up to a constant; named ``function_of_CHANNEL``.

    The columns are cubic B-splines except the first, which the bias replaces. Beyond the knots, whose positions are
    `parts` of the channel's range over all runs, the function is constant.
    """

    kind = EffectKind.FUNCTION
    cause = (
        "The error is a function of this channel that no named effect describes. The record does not show the cause, "
        "but the curve shows the range to examine."
    )
    cause_zh = "误差沿某一曲线随该通道变化，与已命名的效应均不符。记录无法说明成因，但曲线指出了应查的范围。"
    reference = "de Boor, A Practical Guide to Splines, Springer 1978"
    separating_test = "step this channel finely over its range in both directions, with all others held constant"
    separating_test_zh = "保持其他条件不变，在该通道全范围内双向细分步进"

    def __init__(self, channel: str, parts: tuple[float, ...]) -> None:
        en, zh = channel_name(channel)
        self.name = f"function_of_{channel}"
        self.en = f"function of {en}"
        self.zh = f"{zh}的未知函数"
        self.needs = (channel,)
        self.parts = parts
        self.parameters = (ShapeParameter(_KNOTS, f"{{{channel}}}", (), "knots", "节点"),)

    def shapes(self, runs: Sequence[RunBlocks]) -> Sequence[Shape]:
        found = range_over(self.needs[0], runs)
        if found is None or found[0] == found[1]:
            return []
        low, high = found
        knots = [float(f"{low + part * (high - low):.6g}") for part in self.parts]
        if len(set(knots)) < len(knots):  # the range is below the resolution of the knots
            return []
        return [{_KNOTS: knots}]

    def columns(self, shape: Shape) -> tuple[str, ...]:
        return tuple(f"spline_{k}" for k in range(1, len(numbers(shape, _KNOTS)) + 2))

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        channel, knots = run.channels[self.needs[0]], numbers(shape, _KNOTS)

        def splines(mean: FloatArray, spread: FloatArray) -> FloatArray:  # at two points of that mean and spread
            return 0.5 * (_spline_columns(mean - spread, knots) + _spline_columns(mean + spread, knots))

        return block_means(channel, splines)[:, 1:]

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        return _spline_value(channels[self.needs[0]], numbers(shape, _KNOTS), [0.0, *coefficients])


_EVEN = tuple(float(part) for part in np.linspace(0.0, 1.0, 7))
EFFECTS = (
    FunctionOfChannel("temperature", _EVEN),
    FunctionOfChannel("supply_voltage", _EVEN[::2]),
    FunctionOfChannel("vibration", _EVEN[::2]),
    FunctionOfChannel("time_since_power_on", (0.0, 0.016, 0.04, 0.1, 0.25, 0.5, 1.0)),
)


class FunctionOfInputRate(Effect):
    """Any piecewise linear function of the input rate, zero at the knot nearest zero and constant beyond the knots."""

    name, en, zh = "function_of_input_rate", "function of input rate", "输入角速率的未知函数"
    needs = ("input_rate",)
    kind = EffectKind.FUNCTION
    parameters = (ShapeParameter(_KNOTS, "{input_rate}", (), "knots", "节点"),)
    cause = (
        "The error is a function of the rate that no named effect describes, such as the steps of a converter. The "
        "curve shows which rates to examine."
    )
    cause_zh = "误差沿某一曲线随角速率变化，与已命名的效应均不符，例如转换器的台阶。曲线指出了应查的角速率。"
    reference = "IEEE 952-2020, scale-factor nonlinearity; GJB 2426A-2004 5.8"
    separating_test = "fine steps of rate over the whole range in both directions"
    separating_test_zh = "全量程内正反向细分角速率"

    def shapes(self, runs: Sequence[RunBlocks]) -> Sequence[Shape]:
        found = range_over("input_rate", runs)
        greatest = 0.0 if found is None else max(abs(found[0]), abs(found[1]))
        if greatest == 0.0:
            return []
        positive = [float(f"{part * greatest:.3g}") for part in _RATE_PARTS]
        knots = _knots_with_data(np.array([*(-knot for knot in reversed(positive)), 0.0, *positive]), runs)
        return [{_KNOTS: knots.tolist()}] if knots.size > 1 else []

    def columns(self, shape: Shape) -> tuple[str, ...]:
        knots = numbers(shape, _KNOTS)
        return tuple(f"at_{knot:g}" for knot in np.delete(knots, np.argmin(np.abs(knots))))

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        knots, rate = numbers(shape, _KNOTS), run.channels["input_rate"]
        excess = np.stack([mean_excess(rate, float(knot)) for knot in knots], axis=1)
        # the hat function of a knot rises from the knot before it and falls to the knot after it
        risen = -np.diff(excess, axis=1) / np.diff(knots)
        ones = np.where(np.isfinite(rate.mean), 1.0, np.nan)[:, None]
        hats = np.hstack([ones, risen]) - np.hstack([risen, 0.0 * ones])
        return np.delete(hats, np.argmin(np.abs(knots)), axis=1)

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        knots = numbers(shape, _KNOTS)
        heights = np.insert(np.asarray(coefficients, np.float64), int(np.argmin(np.abs(knots))), 0.0)
        slopes = np.diff(heights) / np.diff(knots)
        # the height at the first knot, then each piece up to the rate
        risen = np.clip(channels["input_rate"][:, None] - knots[:-1], 0.0, np.diff(knots))
        return np.asarray(heights[0] + risen @ slopes)


def _knots_with_data(knots: FloatArray, runs: Sequence[RunBlocks]) -> FloatArray:
    """Zero, and the knots nearest to the mean rate of some block.

    The value at another knot is not in the data: it would be a large number, and so would be what it compensates.
    """
    means = np.concatenate([run.mean("input_rate") for run in runs if "input_rate" in run.channels])
    rates = means[np.isfinite(means)]
    after = np.clip(np.searchsorted(knots, rates), 1, knots.size - 1)
    share = np.clip((rates - knots[after - 1]) / (knots[after] - knots[after - 1]), 0.0, 1.0)
    has_data = knots == 0.0
    has_data[(after - 1)[share <= _NEAR]] = True
    has_data[after[share >= 1.0 - _NEAR]] = True
    return np.asarray(knots[has_data], np.float64)


class FunctionOfPosition(Effect):
    """One offset per position relative to the first; positions are identified by number."""

    name, en, zh = "function_of_position", "bias by position", "随位置而异的零偏"
    needs = ("position",)
    kind = EffectKind.FUNCTION
    parameters = (ShapeParameter(_POSITIONS, "1", (), "positions", "位置"),)
    cause = (
        "Each position has its own bias: gravity along the axes, earth rate or magnetic field, or the effect of "
        "remounting and of a new power-on. If each position was mounted only once, these causes cannot be "
        "distinguished."
    )
    cause_zh = "每个位置各有零偏：各轴重力、地速或地磁场，或重新安装、通电所致。各位置只安装一次时无法区分这些原因。"
    reference = "HIT 2012 (2)-(9); IEEE 517-1974, multi-position tests; IEEE 952-2020, bias repeatability"
    aliases = ("gravity_i", "gravity_o", "gravity_s", "gravity_o_squared", "gravity_s_squared")
    separating_test = (
        "remount every position at least three times, with a power-on each, and add the opposite positions: gravity "
        "repeats and changes its sign, its square repeats, mounting and turn-on do not repeat"
    )
    separating_test_zh = (
        "每个位置至少重新安装并通电三次，并增加相反位置：重力项可重复且变号，其平方项可重复，安装与逐次通电偏差不可重复"
    )

    def shapes(self, runs: Sequence[RunBlocks]) -> Sequence[Shape]:
        found = np.concatenate([run.mean("position") for run in runs if "position" in run.channels] or [np.empty(0)])
        positions = np.unique(found[np.isfinite(found)]).tolist()
        return [{_POSITIONS: positions}] if len(positions) > 1 else []

    def columns(self, shape: Shape) -> tuple[str, ...]:
        return tuple(f"at_{position:g}" for position in numbers(shape, _POSITIONS)[1:])

    def regressors(self, run: RunBlocks, shape: Shape) -> FloatArray:
        position = run.mean("position")
        columns = np.equal.outer(position, numbers(shape, _POSITIONS)[1:]).astype(np.float64)
        columns[np.isnan(position)] = np.nan
        return columns

    def simulate(self, time_s: FloatArray, channels: Inputs, coefficients: Sequence[float], shape: Shape) -> FloatArray:
        error = np.zeros(time_s.size)
        for position, bias in zip(numbers(shape, _POSITIONS)[1:], coefficients, strict=True):
            error += np.where(channels["position"] == position, bias, 0.0)
        return error


def _spline_columns(value: FloatArray, knots: FloatArray) -> FloatArray:
    """Each B-spline at each value, shape (values, knots + 2); NaN in a row whose value is NaN. Rows sum to 1.

    >>> columns = _spline_columns(np.array([0.0, 0.5, 9.0]), np.array([0.0, 1.0, 2.0]))
    >>> columns.shape, columns.sum(axis=1)
    ((3, 5), array([1., 1., 1.]))
    """
    padded = _padded(knots)
    inside = np.clip(np.where(np.isfinite(value), value, knots[0]), knots[0], knots[-1])
    interval = _interval(inside, knots)
    # the recurrence of Cox and de Boor for the splines that are not zero; scipy.interpolate is slow to import
    splines = [np.ones(value.size)]
    for order in range(1, _DEGREE + 1):
        left = [inside - padded[interval + 1 - order + j] for j in range(order)]
        right = [padded[interval + 1 + j] - inside for j in range(order)]
        shares = [spline / (right[j] + left[j]) for j, spline in enumerate(splines)]
        rising = [np.zeros(value.size), *(left[j] * share for j, share in enumerate(shares))]
        falling = [*(right[j] * share for j, share in enumerate(shares)), np.zeros(value.size)]
        splines = [up + down for up, down in zip(rising, falling, strict=True)]
    columns = np.zeros((value.size, knots.size + _DEGREE - 1))
    for j, spline in enumerate(splines):
        columns[np.arange(value.size), interval - _DEGREE + j] = spline
    columns[~np.isfinite(value)] = np.nan
    return columns


def _interval(inside: FloatArray, knots: FloatArray) -> IntArray:
    """Number of the padded knot at or before each value."""
    return np.asarray(np.clip(np.searchsorted(knots, inside, side="right") - 1, 0, knots.size - 2) + _DEGREE)


def _spline_value(value: FloatArray, knots: FloatArray, coefficients: Sequence[float]) -> FloatArray:
    """The spline with these coefficients, by de Boor's recurrence."""
    padded = _padded(knots)
    inside = np.clip(value, knots[0], knots[-1])
    interval = _interval(inside, knots)
    weights = np.asarray(coefficients, np.float64)
    levels = [weights[interval - _DEGREE + j] for j in range(_DEGREE + 1)]
    for order in range(1, _DEGREE + 1):
        for j in range(_DEGREE, order - 1, -1):
            left = padded[interval - _DEGREE + j]
            right = padded[interval + 1 + j - order]
            share = (inside - left) / (right - left)
            levels[j] = (1.0 - share) * levels[j - 1] + share * levels[j]
    return np.asarray(levels[_DEGREE], np.float64)


def _padded(knots: FloatArray) -> FloatArray:
    return np.concatenate((np.full(_DEGREE, knots[0]), knots, np.full(_DEGREE, knots[-1])))
