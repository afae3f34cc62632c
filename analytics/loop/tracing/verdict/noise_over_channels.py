"""Whether the white noise changes with a channel within runs: then it is not that declared everywhere.

The logarithm of the scatter within each block is regressed on each channel, both less their means in each run and class
of rate. Noise that changes by itself, as in bursts, moves as slowly as a temperature: what the regression leaves is
tested for that, and widens the error. Flicker and random walk do not change the scatter within a block.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from operator import methodcaller

import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.effects.channel_names import channel_name
from analytics.loop.tracing.search.evidence import redness
from analytics.loop.tracing.verdict.noise_agreement import MOST_APART, NOISE_P_VALUE
from analytics.loop.tracing.whitening.stack import Stack, common_channels
from analytics.loop.tracing.whitening.white_variance import rate_classes
from analytics.methods.distributions import chi_square_sf
from stream.batch import FloatArray, IntArray

# the noise over the classes of rate is in the weights of the blocks; a date does not change within a run
_NOT_TRIED = frozenset({"input_rate", "table_rate", "rate_o", "rate_s", "table_acceleration", "position", "day"})
_LEAST_LEFT = 0.1  # of the length of a channel's column, in the runs but the one that shows most
_ALIKE = 0.8  # of the largest strength, from which another channel is named as well
_FAR = 6.0  # median deviations, beyond which a logarithm counts no more
_END = 0.2  # share of the blocks at either end of a channel


@dataclass(frozen=True)
class NoiseTrend:
    """White noise N at either end of a channel, and other channels that it follows about as well."""

    channel: str
    others: tuple[str, ...]
    low: tuple[float, float]  # the channel and N there
    high: tuple[float, float]
    unit_of_measure: str  # of the channel

    @property
    def sentence(self) -> Bilingual:
        """What is not as declared."""
        names = [channel_name(each) for each in (self.channel, *self.others)]
        en, zh = (" or ".join(each[0] for each in names), "或".join(each[1] for each in names))
        ends = (f"{each[0]:.3g} {self.unit_of_measure}".rstrip() for each in (self.low, self.high))
        first, last = ends
        before, after = f"{self.low[1]:.2g}", f"{self.high[1]:.2g}"
        grows = Bilingual("grows", "增大") if self.high[1] > self.low[1] else Bilingual("falls", "减小")
        return Bilingual(
            f"the noise is not the same everywhere: its white part N {grows} with {en}, from {before} at {first} to "
            f"{after} at {last}, so that no single N holds",
            f"噪声并非处处相同：其白噪声N随{zh}{grows.zh}，由{first}处的{before}变为{last}处的{after}，没有单一的N可用",
        )


def noise_trend(stack: Stack) -> NoiseTrend | None:
    """The channel with which the scatter within blocks changes in several runs, at 1 in 1000; None if with none."""
    scatter = stack.column(lambda run: run.white_variance)
    number = stack.run_number
    if len(stack.runs) < 2 or not np.all(np.isfinite(scatter) & (scatter > 0)):
        return None
    _, turning = rate_classes(stack)
    group = number * (int(turning.max()) + 1) + turning
    logarithm = np.log(scatter)
    channels = {name: stack.column(methodcaller("mean", name)) for name in common_channels(stack.runs)}
    moving = {
        name: each for name, each in channels.items()
        if name not in _NOT_TRIED and np.isfinite(each).all() and np.ptp(each) > 0
    }  # fmt: skip
    strengths = _strengths(logarithm, moving, group, number)
    if not strengths:
        return None
    best = max(strengths, key=lambda name: abs(strengths[name]))
    block_h = stack.noise_model.block_h
    low, high = ((float(np.mean(moving[best][rows])), _size(logarithm[rows], block_h)) for rows in _ends(moving[best]))
    ratio = high[1] / low[1]
    if max(ratio, 1.0 / ratio) < MOST_APART or (ratio > 1.0) is not (strengths[best] > 0.0):
        return None
    others = tuple(
        name for name, each in strengths.items() if name != best and abs(each) > _ALIKE * abs(strengths[best])
    )
    return NoiseTrend(best, others, low, high, stack.runs[0].channels[best].unit_of_measure)


def _strengths(
    logarithm: FloatArray, channels: Mapping[str, FloatArray], group: IntArray, runs: IntArray
) -> dict[str, float]:
    """Regression coefficient on each channel over its error; empty if none is significant, or in one run only."""
    own = _less_means(logarithm, group)
    most = _FAR * float(np.median(np.abs(own)))
    own = np.clip(own, -most, most)  # a step of rate within a block is no noise
    found, others = {}, {}
    for name, values in channels.items():
        column = _less_means(values, group)
        if (size := float(np.linalg.norm(column))) <= 1e-9 * float(np.linalg.norm(values)):
            continue
        column = column / size
        left = own - column * float(column @ own)
        if (spread := float(left.std())) == 0.0:
            continue
        products = np.bincount(runs, column * own)
        error = spread * float(np.sqrt(redness([column[:, None]], [left / spread], [runs])))
        found[name] = float(products.sum()) / error
        without = int(np.argmax(products * np.sign(found[name])))
        kept = float(np.linalg.norm(column[runs != without]))
        others[name] = float(products.sum() - products[without]) / (error * kept) if kept > _LEAST_LEFT else 0.0
    if not found:
        return {}
    best = max(found, key=lambda name: abs(found[name]))
    is_significant = len(found) * float(chi_square_sf(found[best] ** 2, 1)) < NOISE_P_VALUE
    repeats = found[best] * others[best] > 0 and float(chi_square_sf(others[best] ** 2, 1)) < NOISE_P_VALUE
    return found if is_significant and repeats else {}


def _less_means(values: FloatArray, group: IntArray) -> FloatArray:
    """Values less the mean of their group."""
    _, at = np.unique(group, return_inverse=True)
    return np.asarray(values - (np.bincount(at, values) / np.bincount(at))[at])


def _ends(values: FloatArray) -> tuple[IntArray, IntArray]:
    """The blocks with the lowest and the highest values."""
    order, count = np.argsort(values, kind="stable"), max(1, round(_END * values.size))
    return order[:count], order[-count:]


def _size(logarithm: FloatArray, block_h: float) -> float:
    """N by logarithms of the variance of a block mean."""
    return float(np.sqrt(np.exp(np.median(logarithm)) * block_h))
