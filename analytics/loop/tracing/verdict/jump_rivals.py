"""Channels that step where the bias jumps: the data cannot separate a jump from them."""

from collections.abc import Iterator, Sequence

import msgspec
import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.tracing.result.diagnosis_result import FoundEffect
from analytics.loop.tracing.search.fitted_candidates import JUMP
from stream.batch import FloatArray

_LEAST_STEP = 0.001  # of a channel's range in the run
_PLATEAU = 6  # blocks before and after a step in which the channel has to be constant


def with_coincidences(found: FoundEffect, runs: Sequence[RunBlocks]) -> FoundEffect:
    """A jump with the channels that step at the same time; another effect as it is."""
    if found.name != JUMP:
        return found
    run = next(each for each in runs if each.run == str(found.parameters["run"]))
    at = int(np.searchsorted(run.slot, round(float(found.parameters["at_s"]) / run.block_s)))
    stepping = tuple(each for each in sorted(run.channels) if _steps_at(run.mean(each), at))
    return msgspec.structs.replace(found, coincides=stepping)


def coincidences(effects: Sequence[FoundEffect]) -> Iterator[Bilingual]:
    """Channels that step where the bias jumps: what they cause may differ in that run."""
    for found in (each for each in effects if each.coincides):
        name, at_s = str(found.parameters["run"]), float(found.parameters["at_s"])
        channels, channels_zh = ", ".join(found.coincides), "、".join(found.coincides)
        verb = "steps" if len(found.coincides) == 1 else "step"
        yield Bilingual(
            f"jump in run {name} at {at_s:,.0f} s: {channels} {verb} there, so that the coefficient of an effect "
            "of it, such as the scale factor, may differ in this run instead",
            f"试验{name}在{at_s:,.0f} s处的跳变：{channels_zh}在该处阶跃，也可能是其效应的系数"
            "（如标度因数）在该次试验中不同",
        )


def _steps_at(values: FloatArray, at: int) -> bool:
    """Whether a channel changes within two blocks of a place, between plateaus that it stays at."""
    before, after = values[max(at - _PLATEAU, 0) : max(at - 1, 0)], values[at + 2 : at + 1 + _PLATEAU]
    if before.size < 2 or after.size < 2 or not np.isfinite([*before, *after]).all():
        return False
    step, range_ = abs(float(np.median(after) - np.median(before))), float(np.nanmax(values) - np.nanmin(values))
    return step > _LEAST_STEP * range_ > 0 and step > 3 * max(float(np.ptp(before)), float(np.ptp(after)))
