"""Coherence of the residual with each channel, over frequency, and the lag at which they agree most."""

from collections.abc import Sequence

import msgspec
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from analytics.loop.residuals import Residuals
from stream.batch import FloatArray

_SEGMENT_BLOCKS, _FEWEST_SEGMENTS = 64, 4
_OVERLAP_COST = (
    1.056  # variance of a Hann-windowed spectrum with half-overlapping segments, relative to independent ones
)
_MOST_LAG_BLOCKS = 20
_COPIED = 0.95
"""Squared coherence at every frequency from which a channel is a copy: a cause does not follow the gyro's noise."""
_LEAST_OWN = 1e-6  # share of a channel that the declared terms leave, for it to be compared


class ChannelCoherence(msgspec.Struct, frozen=True, kw_only=True):
    """Agreement of the residual of the model found with a channel, both whitened by the fitted noise.

    Parameters
    ----------
    coherence: Largest magnitude-squared coherence over frequency, at `frequency_hz`.
    p_value: Of a coherence as large by chance, corrected for the number of frequencies and channels.
    lag_s: Lag of the residual behind the channel at which their `correlation` is largest.
    """

    channel: str
    coherence: float
    frequency_hz: float
    p_value: float
    lag_s: float
    correlation: float


def channel_coherence(residuals: Residuals) -> tuple[ChannelCoherence, ...]:
    """Coherence with each channel in the runs in which it changes, the least likely by chance first.

    Welch's method, Hann windows of 64 blocks, half overlapping, pooled over runs (Carter, Proc. IEEE 75(2), 1987,
    236-255: of independent series it exceeds c with probability (1 - c)^(segments - 1)).
    """
    stack = residuals.record.stack
    names = sorted(residuals.channels)
    columns = np.column_stack([residuals.after, *(residuals.channel(name) for name in names)])
    columns = residuals.record.whitener(residuals.noise)(np.nan_to_num(columns))
    runs = [columns[stack.run_number == number] for number in range(len(stack.runs))]
    runs = [run - run.mean(axis=0) for run in runs if len(run) >= _SEGMENT_BLOCKS]
    changing = {at: [run[:, [0, at]] for run in runs if np.ptp(run[:, at]) > 0] for at in range(1, columns.shape[1])}
    changing = {at: own for at, own in changing.items() if sum(map(_segments, own)) >= _FEWEST_SEGMENTS}
    block_s = residuals.record.noise_model.block_s
    found = []
    for at, own in changing.items():
        frequency, coherence = _pooled(own, block_s)
        best = int(np.argmax(coherence))
        by_chance = (1.0 - coherence[best]) ** (sum(map(_segments, own)) / _OVERLAP_COST - 1.0)
        lag, correlation = _lag(own)
        found.append(
            ChannelCoherence(
                channel=names[at - 1],
                coherence=float(coherence[best]),
                frequency_hz=float(frequency[best]),
                p_value=float(-np.expm1(frequency.size * len(changing) * np.log1p(-min(by_chance, 1.0 - 1e-15)))),
                lag_s=lag * block_s,
                correlation=correlation,
            )
        )
    return tuple(sorted(found, key=lambda each: (each.p_value, -each.coherence)))


def copies_of_signal(residuals: Residuals, channels: Sequence[str]) -> tuple[str, ...]:
    """Channels that follow the signal at every frequency without a lag, its noise included.

    Both are compared beside the declared model, so that a reference that the signal measures is no copy of it.
    """
    record, stack = residuals.record, residuals.record.stack
    names = [name for name in channels if name in residuals.channels]
    columns = np.column_stack([stack.value, *(residuals.channel(name) for name in names)])
    columns = columns - columns.mean(axis=0)
    if not names or not np.isfinite(columns).all():
        return ()
    left = columns - record.design @ np.linalg.lstsq(record.design, columns, rcond=None)[0]
    is_own = np.linalg.norm(left, axis=0) > _LEAST_OWN * np.linalg.norm(columns, axis=0)
    whole = record.whitener(residuals.noise)(left)
    runs = [whole[stack.run_number == number] for number in range(len(stack.runs))]
    runs = [run - run.mean(axis=0) for run in runs if len(run) >= _SEGMENT_BLOCKS]
    if sum(map(_segments, runs)) < _FEWEST_SEGMENTS:
        return ()
    raw = [columns[stack.run_number == number] for number in range(len(stack.runs))]
    pairs = {
        name: [run[:, [0, at]] for run in runs]
        for at, name in enumerate(names, 1)
        if is_own[at] and _follows_small_changes([run[:, [0, at]] for run in raw])
    }
    block_s = record.noise_model.block_s
    return tuple(name for name, own in pairs.items() if _pooled(own, block_s)[1].min() > _COPIED and _lag(own)[0] == 0)


def _follows_small_changes(runs: list[FloatArray]) -> bool:
    """Whether the two columns agree in the smaller half of the changes of the second.

    The steps of a rate table agree with what leaks of them into the signal at every frequency; between the steps they
    do not follow the signal's noise.

    >>> noise, steps = np.random.default_rng(1).standard_normal(300), np.repeat([0.0, 900.0, -900.0], 100)
    >>> _follows_small_changes([np.column_stack([noise, 3 * noise])])
    True
    >>> _follows_small_changes([np.column_stack([noise + steps, steps])])
    False
    """
    changes = np.concatenate([np.diff(run, axis=0) for run in runs])
    size = np.abs(changes[:, 1])
    own, other = changes[size <= np.median(size)].T
    together = float(np.sqrt(own @ own * (other @ other)))
    return together > 0 and float(own @ other) ** 2 > _COPIED * together**2


def _segments(run: FloatArray) -> int:
    return 1 + (len(run) - _SEGMENT_BLOCKS) // (_SEGMENT_BLOCKS // 2)


def _pooled(runs: list[FloatArray], block_s: float) -> tuple[FloatArray, FloatArray]:
    """Frequencies without zero, and the squared coherence of the two columns over runs."""
    # scipy.signal.csd gives the same, but the import of scipy.signal takes as long as the search
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(_SEGMENT_BLOCKS) / _SEGMENT_BLOCKS)
    size = _SEGMENT_BLOCKS // 2 + 1
    powers, cross = np.zeros((2, size)), np.zeros(size, dtype=np.complex128)
    for run in runs:
        segments = sliding_window_view(run, _SEGMENT_BLOCKS, axis=0)[:: _SEGMENT_BLOCKS // 2]
        spectra = np.fft.rfft((segments - segments.mean(axis=-1, keepdims=True)) * window)
        powers += np.sum(np.abs(spectra) ** 2, axis=0)
        cross += np.sum(spectra[:, 0].conj() * spectra[:, 1], axis=0)
    frequency = np.fft.rfftfreq(_SEGMENT_BLOCKS, block_s)
    squared = np.abs(cross) ** 2 / np.maximum(powers[0] * powers[1], 1e-300)
    return np.asarray(frequency[1:], dtype=np.float64), np.asarray(np.minimum(squared[1:], 1.0))


def _lag(runs: list[FloatArray]) -> tuple[int, float]:
    """Lag in blocks of the first column behind the second, and the correlation there."""
    lags = np.arange(-_MOST_LAG_BLOCKS, _MOST_LAG_BLOCKS + 1)
    products = np.zeros(lags.size)
    squares = np.zeros(2)
    for run in runs:
        own, channel = run.T
        padded = np.pad(own, _MOST_LAG_BLOCKS)
        products += sliding_window_view(padded, len(run)) @ channel
        squares += own @ own, channel @ channel
    correlation = products / max(float(np.sqrt(squares.prod())), 1e-300)
    best = int(np.argmax(np.abs(correlation)))
    return int(lags[best]), float(correlation[best])
