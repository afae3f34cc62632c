"""Runs in which an effect is planted by its own simulator, and its columns beside the declared model."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from analytics.loop.effects.base import EffectKind, Role, Shape
from analytics.loop.effects.registry import effect
from stream.batch import FloatArray
from tests.bench.loop_campaign import Campaign, DenseWhitener, Planted
from tests.bench.loop_drives import UNITS

ALL_CHANNELS = tuple(UNITS)


@cache
def campaign() -> Campaign:
    return Campaign(5, runs=10, duration_s=7200.0)


@cache
def recorded(name: str) -> list[RunBlocks]:
    """The noiseless runs with the effect at work, as far as it alters what is recorded."""
    planted = [Planted(name, [0.0] * len(columns_of(name)), shape_of(name))] if effect(name).role is Role.ALIAS else []
    return campaign().runs(planted, noiseless=True, channels=ALL_CHANNELS)


@cache
def clean() -> list[RunBlocks]:
    return campaign().runs(noiseless=True, channels=ALL_CHANNELS)


def shapes_of(name: str) -> Sequence[Shape]:
    if effect(name).kind is EffectKind.LINE:
        return [{"frequency_hz": 1.0 / 700.0}]
    if effect(name).kind is EffectKind.EVENT:
        return [{"run": campaign().names[3], "at_s": 3007.0}]
    return effect(name).shapes(clean())


def shape_of(name: str) -> Shape:
    shapes = shapes_of(name)
    return shapes[len(shapes) // 2]


def columns_of(name: str) -> tuple[str, ...]:
    return effect(name).columns(shape_of(name))


def direction_of(name: str) -> FloatArray:
    """Proportions of the coefficients: of a function of a channel a smooth course."""
    return (
        np.asarray([0.7, -1.1]) if len(columns_of(name)) == 2 else np.cos(np.linspace(0.0, 3.0, len(columns_of(name))))
    )


def stacked(name: str, runs: list[RunBlocks], shape: Shape | None = None) -> FloatArray:
    wanted = shape_of(name) if shape is None else shape
    return np.concatenate([effect(name).regressors(run, wanted) for run in runs])


def declared(name: str) -> Callable[[RunBlocks], FloatArray]:
    """Columns of the declared model, without the effect that is looked for."""
    terms: dict[str, Callable[[RunBlocks], FloatArray]] = {
        "bias": lambda run: np.ones(len(run)),
        "scale_factor": lambda run: run.mean("input_rate"),
        "temperature": lambda run: run.mean("temperature") - 25.0,
    }
    return lambda run: np.column_stack([column(run) for term, column in terms.items() if term != name])


@cache
def whitener() -> DenseWhitener:
    return DenseWhitener(campaign().slots, campaign().block_s, campaign().noise)


def beside(name: str, columns: FloatArray) -> FloatArray:
    """White, and free of what the declared model can say."""
    known = np.concatenate([declared(name)(run) for run in recorded(name)])
    white = whitener()(np.column_stack([known, columns]))
    basis, _ = np.linalg.qr(white[:, : known.shape[1]] / np.linalg.norm(white[:, : known.shape[1]], axis=0))
    left = white[:, known.shape[1] :]
    return np.asarray(left - basis @ (basis.T @ left))


def simulated(name: str, coefficients: FloatArray, shape: Shape) -> FloatArray:
    return np.concatenate(campaign().added(Planted(name, coefficients.tolist(), shape)))


def ramp(unit_of_measure: Callable[[str], str] = lambda name: UNITS[name]) -> RunBlocks:
    """Every channel runs straight, so that a gap hides nothing."""
    slot = np.arange(400)
    share = slot / 400.0
    channels = {
        name: Channel(1.0 + (2.0 + k) * share, np.full(slot.size, 1e-9), unit_of_measure(name))
        for k, name in enumerate(ALL_CHANNELS)
    }
    return RunBlocks(
        "FOG-1", "01-ramp", "rate", slot, 30.0, 0, share, np.ones(400, int), 0.0 * share, "deg/h", channels
    )


def without_blocks(run: RunBlocks, gone: slice) -> RunBlocks:
    keep = np.ones(len(run), bool)
    keep[gone] = False
    channels = {n: Channel(c.mean[keep], c.spread[keep], c.unit_of_measure) for n, c in run.channels.items()}
    arrays = {each: getattr(run, each)[keep] for each in ("slot", "value", "n", "white_variance")}
    return replace(run, **arrays, channels=channels)


def without_channel(run: RunBlocks, name: str) -> RunBlocks:
    return replace(run, channels={each: channel for each, channel in run.channels.items() if each != name})
