"""Simulated units in the tests of the standards: records of their steps as the store would keep them, and the truth.

Each step's samples are drawn and reduced by `series_statistics`; only the way through a store is left out.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa

from analytics.evaluation.evaluation import define_views, evaluate
from analytics.metric_registry.registry import metrics
from analytics.step_records.series_statistics import series_statistics
from analytics.step_records.step_table import step_means
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.batch import FloatArray
from tests.bench.attitude_steps import attitude_tests

SECOND_NS = 10**9
DAY_NS = 86_400 * SECOND_NS
START_NS = 1_763_683_200 * SECOND_NS  # 2025-11-21 00:00 UTC
NOISE = 2.0  # deg/h at 1 Hz, white
PAUSE_S = 60  # between steps
SHORT_S = 52  # of a record that is too short
RATES = tuple(round(float(rate), 6) for rate in np.geomspace(1.0, 100.0, 11))
TEMPERATURES = (20.0, -40.0, 0.0, 40.0, 60.0)
AXES = ("X", "Y", "Z")


class Unit(NamedTuple):
    """What is true of a unit; deg/h, deg/h/degC, deg/h/g, ppm, and misalignments in arcmin."""

    name: str
    bias: float = 7.0
    bias_per_degree: float = 0.05
    bias_per_g: tuple[float, float, float] = (3.0, -4.0, 5.0)
    bias_change: tuple[float, float, float] = (2.0, -3.0, 4.0)
    scale_ppm: float = 300.0
    scale_ppm_per_degree: float = 40.0
    scale_ppm_per_g: float = 500.0
    scale_change_ppm: tuple[float, float, float] = (400.0, -500.0, 600.0)
    asymmetry_ppm: float = 0.0
    misalignment_arcmin: tuple[float, float] = (30.0, -40.0)
    fixture_arcmin: tuple[float, float] = (5.0, 7.0)
    turn_on: float = 0.5
    from_day_to_day: float = 1.0
    scale_scatter_ppm: float = 100.0
    misalignment_scatter_arcmin: float = 2.0


class Step(NamedTuple):
    """A step that is to be done: its words, and how the output departs from that of the unit at rest at 20 degC."""

    words: dict[str, Any]
    rate: float = 0.0
    zero: float = 0.0
    scale_ppm: float = 0.0
    seconds: int = 60
    signal: str = "rate"


def still(words: dict[str, Any], zero: float = 0.0, seconds: int = 60) -> Step:
    return Step(words, zero=zero, seconds=seconds)


def rates(words: dict[str, Any], scale_ppm: float = 0.0, asymmetry_ppm: float = 0.0) -> Iterator[Step]:
    """A rest, the rates in both directions, and a rest."""
    yield Step(words | {"rate_command": 0.0})
    for rate in RATES:
        for way in (1, -1):
            yield Step(words | {"rate_command": way * rate}, way * rate, scale_ppm=scale_ppm + way * asymmetry_ppm / 2)
    yield Step(words | {"rate_command": 0.0})


def tests_of(unit: Unit, rng: np.random.Generator) -> dict[str, list[list[Step]]]:
    """The tests of a unit by procedure: a list of runs, each a list of steps."""
    daily = rng.normal(0, unit.from_day_to_day, 4)
    up_down = (("up", 1), ("down", -1))
    before_after = (("before", 0), ("after", 1))
    turns = [(0.0, ""), (1.0, "_turned_180")]
    found: dict[str, list[list[Step]]] = {
        "static_bias": [
            [
                still({"epoch": f"{day}-{on}", "position": "IRA_east"}, day_zero + rng.normal(0, unit.turn_on), 3600)
                for on in range(2)
            ]
            for day, day_zero in enumerate(daily)
        ],
        "bias_repeatability": [
            [
                still({"epoch": f"short-{on}", "position": "IRA_east"}, zero, SHORT_S)
                for on, zero in enumerate(rng.normal(0, unit.turn_on, 8))
            ]
        ],
        "bias_temperature_sensitivity": [
            [
                still({"temperature_command": t, "room": t == 20.0}, unit.bias_per_degree * (t - 20.0))
                for t in TEMPERATURES
            ]
        ],
        "bias_acceleration_sensitivity": [
            [
                still({"axis": axis, "position": f"{axis}_{side}"}, g * per_g)
                for axis, per_g in zip(AXES, unit.bias_per_g, strict=True)
                for side, g in up_down
            ]
        ],
        "scale_factor": [list(rates({})), list(rates({}))],
        "scale_factor_repeatability": [
            [
                step
                for repeat in range(1, 8)
                for step in rates({"repeat": repeat}, rng.normal(0, unit.scale_scatter_ppm))
            ]
        ],
        "scale_factor_temperature_sensitivity": [
            [
                step
                for t in TEMPERATURES
                for step in rates({"temperature_command": t, "room": t == 20.0}, unit.scale_ppm_per_degree * (t - 20.0))
            ]
        ],
        "scale_factor_acceleration_sensitivity": [
            [step for side, g in up_down for step in rates({"position": f"IRA_{side}"}, g * unit.scale_ppm_per_g)]
        ],
        "polarity": [[Step({"rate_command": way * 10.0}, way * 10.0) for way in (1, -1)]],
        "misalignment_repeatability": [
            [
                _across(unit, mounting, turned, suffix, 100.0 * way, repeat, scatter)
                for repeat, scatter in enumerate(rng.normal(0, unit.misalignment_scatter_arcmin, 7), start=1)
                for turned, suffix in turns
                for mounting in (0, 1)
                for way in (1, -1)
            ]
        ],
        "threshold": [
            [
                Step({"step": step, "rate_command": rate}, rate)
                for step, rate in [
                    ("rest", 0.0),
                    *(("small", way * size / 3600) for size in (20, 10, 5, 2, 1) for way in (1, -1)),
                ]
            ]
        ],
        "resolution": [
            [
                Step({"step": "increment", "rate_command": way * (1.0 + size / 3600)}, way * (1.0 + size / 3600))
                for way in (1, -1)
                for size in (0, 20, 10, 5, 2, 1)
            ]
        ],
        "gyro_separation": [
            [
                Step({"position": f"alpha{a}_beta{b}", "rate_command": way * 10.0}, zero=way * tilt)
                for a, b, tilt in ((0, 0, 10), (0, 180, 20), (180, 180, -15), (90, 180, 5), (0, 90, 8))
                for way in (1, -1)
            ]
        ],
    }
    for procedure, steps in attitude_tests().items():
        found[procedure] = [[Step(each.words, each.rate, each.zero, signal=each.signal) for each in steps]]
    for cause in ("shock", "vibration"):
        found[f"bias_{cause}"] = [
            [
                still({"axis": axis, "phase": phase}, done * change)
                for axis, change in zip(AXES, unit.bias_change, strict=True)
                for phase, done in before_after
            ]
        ]
        found[f"scale_factor_{cause}"] = [
            [
                step
                for axis, change in zip(AXES, unit.scale_change_ppm, strict=True)
                for phase, done in before_after
                for step in rates({"axis": axis, "phase": phase}, done * change)
            ]
        ]
    return found


def _across(unit: Unit, mounting: int, turned: float, suffix: str, rate: float, repeat: int, scatter: float) -> Step:
    """The input axis across the table's: what is the unit's changes its sign with the turn, the fixture's does not."""
    own = unit.misalignment_arcmin[mounting] * (1 + scatter / np.hypot(*unit.misalignment_arcmin))
    angle = (own * (1 - 2 * turned) + unit.fixture_arcmin[mounting]) / 60 * np.pi / 180
    words = {"position": f"o{'xy'[mounting]}_up{suffix}", "rate_command": rate, "repeat": repeat}
    return Step(words, zero=angle * rate * 3600 * (1 + unit.scale_ppm * 1e-6))


def records_of(
    units: Iterable[Unit],
    rng: np.random.Generator,
    procedures: Sequence[str] | None = None,
    cut: int | None = None,
    flicker: float = 0.0,
) -> list[dict[str, Any]]:
    """Records of the units' steps, with `flicker` deg/h of bias instability; of `cut` only so many of each run."""
    return [
        record
        for unit in units
        for procedure, runs in tests_of(unit, rng).items()
        if procedures is None or procedure in procedures
        for number, steps in enumerate(runs)
        for record in _run(unit, procedure, number, steps[:cut], rng, flicker)
    ]


def flicker_noise(n: int, bias_instability: float, rng: np.random.Generator) -> FloatArray:
    """Samples 1 s apart of a power spectral density of B**2/(2 pi f) (IEEE 952-2020 C.3), by its spectrum.

    It goes down to a sixteenth of the record's own lowest frequency, so that the record has a mean.
    """
    whole = 16 * n
    frequencies = np.fft.rfftfreq(whole)
    two_sided = np.zeros(frequencies.size)
    two_sided[1:] = bias_instability**2 / (2 * np.pi * frequencies[1:])
    normal = rng.standard_normal((2, frequencies.size))
    spectrum = np.sqrt(two_sided * whole / 2) * (normal[0] + 1j * normal[1])
    return np.asarray(np.fft.irfft(spectrum, whole)[:n])


def _run(
    unit: Unit, procedure: str, number: int, steps: Sequence[Step], rng: np.random.Generator, flicker: float
) -> Iterator[dict[str, Any]]:
    at_ns = START_NS + number * DAY_NS
    wander = np.zeros(0)
    if flicker:
        wander = flicker_noise(sum(step.seconds + PAUSE_S for step in steps), flicker, rng)
    for index, step in enumerate(steps, start=1):
        true_ppm = unit.scale_ppm + step.scale_ppm
        mean = unit.bias + step.zero + step.rate * 3600 * (1 + true_ppm * 1e-6)
        values = mean + rng.normal(0, NOISE, step.seconds)
        if flicker:
            begin = (at_ns - START_NS - number * DAY_NS) // SECOND_NS
            values += wander[begin : begin + step.seconds]
        end_ns = at_ns + (step.seconds - 1) * SECOND_NS
        found = series_statistics(
            at_ns + np.arange(step.seconds) * SECOND_NS,
            np.ones(step.seconds, np.int64),
            values,
            np.zeros(step.seconds),
            base_ns=SECOND_NS,
            samples_per_block=1.0,
            window_ns=(at_ns, end_ns),
        )._asdict()
        for average, each in zip((1, 10, 100), found.pop("averages"), strict=True):
            found |= {f"{name}_{average}s": value for name, value in each._asdict().items()}
        yield {
            "run": f"{procedure}-{number}", "unit": unit.name, "signal": step.signal, "index": index,
            "procedure": procedure, "date_known": True, "time_zone": "UTC", "room": False, "station": "station-1",
            "t_start_ns": at_ns, "t_from_ns": at_ns, "t_to_ns": end_ns, "duration_s": (end_ns - at_ns) / 1e9,
            "unit_of_measure": "deg/h", "input_rate": step.words.get("rate_command"),
            "temperature": step.words.get("temperature_command"),
        } | {name: None if value != value else value for name, value in found.items()} | step.words  # fmt: skip
        at_ns = end_ns + PAUSE_S * SECOND_NS


def metrics_of(store: Store, records: Sequence[dict[str, Any]], names: Iterable[str] | None = None) -> pa.Table:
    """Metrics of records of steps, of all names or some; the store says of checks, products and samples."""
    with Catalog(store) as catalog:
        catalog._unfilled.clear()  # else it would fill itself with what the store holds
        steps = pa.Table.from_pylist(list(records), schema=step_means(catalog).schema)
        define_views(catalog, steps)
        every = metrics()
        return evaluate(catalog, [every[name] for name in (every if names is None else names)])
