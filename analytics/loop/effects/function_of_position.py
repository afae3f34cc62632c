"""A bias of its own in each position in which a unit was tested."""

from collections.abc import Mapping, Sequence

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, Kind, Shape, ShapeParameter
from analytics.loop.effects.shape_values import numbers
from stream.batch import FloatArray

_POSITIONS = "positions"


class FunctionOfPosition(Effect):
    """A constant for each position but the first, which the bias stands for; positions are told apart by number."""

    name = "function_of_position"
    en = "bias by position"
    zh = "随位置而异的零偏"
    needs = ("position",)
    kind = Kind.FUNCTION
    parameters = (ShapeParameter(_POSITIONS, "1", (), "positions", "位置"),)
    cause = (
        "Each position has a bias of its own: gravity along the axes, the earth's rate or field, or what mounting and "
        "powering anew leave behind. Positions that were mounted once each do not tell these from one another."
    )
    cause_zh = "每个位置各有零偏：各轴重力、地速或地磁场，或重新安装、通电所致。各位置只安装一次时无法区分这些原因。"
    reference = "HIT 2012 (2)-(9); IEEE 517-1974, multi-position tests; IEEE 952-2020, bias repeatability"
    aliases = ("gravity_i", "gravity_o", "gravity_s", "gravity_o_squared", "gravity_s_squared")
    separating_test = (
        "mount every position anew at least three times, with a power-on each, and add the opposite ones: gravity "
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

    def simulate(
        self, time_s: FloatArray, channels: Mapping[str, FloatArray], coefficients: Sequence[float], shape: Shape
    ) -> FloatArray:
        error = np.zeros(time_s.size)
        for position, bias in zip(numbers(shape, _POSITIONS)[1:], coefficients, strict=True):
            error += np.where(channels["position"] == position, bias, 0.0)
        return error
