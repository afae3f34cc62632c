"""Misalignment, threshold and resolution against NumPy from the samples, against the truth, and on bad input."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from analytics.evaluation.evaluation import define_views, evaluate
from analytics.methods.half_error import Direction, smallest_within_half, threshold_in_turn
from analytics.metric_registry.registry import metrics
from analytics.step_records.step_table import step_means

SECOND_NS = 10**9
START_NS = 1_763_683_200 * SECOND_NS
ARCMIN = 10800 / np.pi
EARTH_DEG_PER_H = 15.041067


def rows_of(tested: Any, metric: str) -> list[dict[str, Any]]:
    """Rows of one metric over what was written, its parameters among the columns."""
    with tested.catalog() as catalog:
        steps = step_means(catalog)
        catalog._unfilled.clear()
        define_views(catalog, steps)
        found = evaluate(catalog, [metrics()[metric]]).to_pylist()
    return [json.loads(row["parameters"] or "{}") | row for row in found]


class Bench:
    """Steps of unit U1 one after the other; outputs in V at 0.02 V/(deg/s) unless another unit is named."""

    def __init__(
        self, tested: Any, run: str = "r1", *, latitude_deg: float | None = 40.0, t_ns: int = START_NS, seed: int = 7
    ):
        tested.run(run, t_ns=t_ns, latitude_deg=latitude_deg)
        tested.mount(run, "U1", product="FOG-V")
        tested.product("[product.FOG-V]\nscale_factor = 0.02\nscale_factor_unit = 'V'\n")
        self.tested, self.run, self.t_ns = tested, run, t_ns
        self.rng = np.random.default_rng(seed)

    def step(self, output: float, *, noise: float, n: int = 100, dt_ns: int = 10**8, **words: Any) -> float:
        """A step whose samples scatter about an output, V; their mean."""
        values = output + noise * self.rng.standard_normal(n)
        self.t_ns = self.tested.step(self.run, "U1", values, t0_ns=self.t_ns, dt_ns=dt_ns, unit_of_measure="V", **words)
        return float(values.mean())

    def position(self, position: str, angle: float, **words: Any) -> float:
        """Both directions of 100 deg/s in a position in which the input axis is off by an angle; delta, rad."""
        means = [
            self.step(
                0.02 * (0.003 + angle * rate), noise=1e-5, rate_command_deg_per_s=rate, position=position, **words
            )
            for rate in (100.0, -100.0)
        ]
        return (means[0] - means[1]) / (2 * 0.02 * 100.0)


# misalignment towards x and y, and the fixture's error, rad
OF_X, OF_Y, FIXTURE_X, FIXTURE_Y = 3e-4, -2e-4, 1e-3, -5e-4


@pytest.mark.parametrize(
    ("procedure", "names"),
    [
        ("misalignment", ("ox_up", "oy_up", "ox_down", "oy_down")),
        ("misalignment_four_positions", ("OX_up", "OY_up", "OX_up_turned_180", "OY_up_turned_180")),
    ],
)
def test_misalignment_of_two_and_four_positions(tested: Any, procedure: str, names: Sequence[str]) -> None:
    bench = Bench(tested)
    angles = (OF_X + FIXTURE_X, OF_Y + FIXTURE_Y, -OF_X + FIXTURE_X, -OF_Y + FIXTURE_Y)
    delta = [bench.position(name, angle, procedure=procedure) for name, angle in zip(names, angles, strict=True)]
    found = {row["positions"]: row for row in rows_of(tested, "misalignment")}
    four = found[4]
    expected = np.hypot((delta[0] - delta[2]) / 2, (delta[1] - delta[3]) / 2) * ARCMIN
    assert four["value"] == pytest.approx(expected, rel=1e-9)
    assert four["arcsec"] == pytest.approx(60 * expected, rel=1e-9)
    assert four["lo"] < np.hypot(OF_X, OF_Y) * ARCMIN < four["hi"]
    assert four["hi"] - four["lo"] < 0.05 * four["value"]
    if procedure == "misalignment":
        assert found[2]["value"] == pytest.approx(np.arcsin(np.hypot(delta[0], delta[1])) * ARCMIN, rel=1e-9)
        assert found[2]["standard"] == "GJB2426A"
    else:
        assert 2 not in found


def test_misalignment_uncertainty_against_simulation(tested: Any) -> None:
    for number in range(9):
        bench = Bench(tested, f"r{number}", t_ns=START_NS + number * 3600 * SECOND_NS, seed=number)
        for name, angle in (("ox_up", OF_X), ("oy_up", OF_Y)):
            bench.position(name, angle, procedure="misalignment")
    rows = rows_of(tested, "misalignment")
    assert len(rows) == 9
    rng = np.random.default_rng(3)
    u_delta = 1e-5 / np.sqrt(100) * np.sqrt(2) / (2 * 0.02 * 100.0)
    draws = (
        np.hypot(OF_X + u_delta * rng.standard_normal(20_000), OF_Y + u_delta * rng.standard_normal(20_000)) * ARCMIN
    )
    # one step in some says up to 3.3 times its true uncertainty, as its noise may be drift; half of the runs have none
    assert np.median([row["standard_uncertainty"] for row in rows]) == pytest.approx(draws.std(), rel=0.3)


def test_misalignment_near_zero_covers_zero(tested: Any) -> None:
    bench = Bench(tested)
    for name in ("ox_up", "oy_up"):
        bench.position(name, 0.0, procedure="misalignment")
    (row,) = rows_of(tested, "misalignment")
    assert row["value"] > 0
    assert row["lo"] == 0


def test_misalignment_with_a_missing_position_or_direction(tested: Any) -> None:
    bench = Bench(tested)
    bench.position("OY_up", OF_Y, procedure="misalignment_four_positions")
    bench.step(0.0, noise=1e-5, rate_command_deg_per_s=100.0, position="OX_up", procedure="misalignment_four_positions")
    (row,) = rows_of(tested, "misalignment")
    assert row["value"] is None
    assert row["reason"] == "position OX_up: measured in one direction only"


def test_misalignment_without_a_scale_factor(tested: Any) -> None:
    bench = Bench(tested)
    bench.tested.product("[product.OTHER]\nscale_factor = 1.0")
    for name in ("ox_up", "oy_up"):
        bench.position(name, OF_X, procedure="misalignment")
    (row,) = rows_of(tested, "misalignment")
    assert row["value"] is None
    assert "no scale factor for an output in V" in row["reason"]


@pytest.mark.in_gate("6")
@pytest.mark.parametrize("repeats", [7, 6])
def test_misalignment_repeatability(tested: Any, repeats: int) -> None:
    bench = Bench(tested)
    gammas = []
    for repeat in range(1, repeats + 1):
        shift = 1e-5 * bench.rng.standard_normal(2)
        words = {"procedure": "misalignment_repeatability", "repeat": repeat}
        angles = {"OY_up": OF_Y + shift[1], "OX_up": OF_X + shift[0]}
        delta = {}
        for name, angle in angles.items():
            delta[name] = bench.position(name, angle + FIXTURE_X, **words)
            delta[f"{name}_turned_180"] = bench.position(f"{name}_turned_180", -angle + FIXTURE_X, **words)
        halves = [(delta[name] - delta[f"{name}_turned_180"]) / 2 for name in angles]
        gammas.append(np.hypot(halves[0], halves[1]) * ARCMIN)
    (row,) = rows_of(tested, "misalignment_repeatability")
    if repeats == 7:
        assert row["value"] == pytest.approx(np.std(gammas, ddof=1), rel=1e-9)
        assert (row["n"], row["run"]) == (7, "r1")
    else:
        assert row["reason"] == "6 misalignments measured, the clause asks for 7 or more"


def dead_zone(rate_deg_per_h: float, half_width: float) -> float:
    return float(np.sign(rate_deg_per_h) * max(abs(rate_deg_per_h) - half_width, 0.0))


def test_threshold_on_the_rate_table(tested: Any) -> None:
    bench = Bench(tested)
    rates = [36.0 * 10 ** (-i / 10) for i in range(12)]  # deg/h
    words: dict[str, Any] = {"procedure": "threshold", "noise": 1e-8}
    volt = 0.02 / 3600
    zero = 1.3e-3
    bench.step(zero, step="rest", rate_command_deg_per_s=0.0, **words)
    means = {}
    for sign, half_width in ((1, 3.0), (-1, 4.0)):
        for rate in rates:
            means[sign * rate] = bench.step(
                zero + volt * dead_zone(sign * rate, half_width), step="small_rate",
                rate_command_deg_per_s=sign * rate / 3600, **words,
            )  # fmt: skip
    bench.step(zero, step="rest", rate_command_deg_per_s=0.0, **words)
    (row,) = rows_of(tested, "threshold")
    held = [[r for r in rates if abs(s * r - (means[s * r] - zero) / volt) / r <= 0.5] for s in (1, -1)]
    assert row["value"] == pytest.approx(max(min(each) for each in held), rel=1e-9)
    # a dead zone of half width D follows by half at 2 D
    assert row["lo"] < 2 * 4.0 <= row["hi"]
    assert row["method"] == "rate_table"
    assert row["standard"] == "GJB2426A, JJF2014"


def test_threshold_without_rest_or_direction(tested: Any) -> None:
    bench = Bench(tested)
    words: dict[str, Any] = {"procedure": "threshold", "noise": 1e-7, "step": "small_rate"}
    bench.step(0.02 * 0.01, rate_command_deg_per_s=0.01, **words)
    (row,) = rows_of(tested, "threshold")
    assert row["reason"].startswith("no record of the table at rest")
    bench.step(0.0, procedure="threshold", noise=1e-7, step="rest", rate_command_deg_per_s=0.0)
    (row,) = rows_of(tested, "threshold")
    assert row["reason"] == "no rate backwards was measured, the clause asks for both directions"


@pytest.mark.parametrize("latitude_deg", [40.0, None])
def test_threshold_on_the_indexing_head(tested: Any, latitude_deg: float | None) -> None:
    bench = Bench(tested, latitude_deg=latitude_deg)
    level = EARTH_DEG_PER_H * np.cos(np.radians(40.0))
    angles = (0.0, 30.0, 60.0, 75.0, 80.0, 84.0, 86.0, 88.0, 89.0, 89.5)
    for angle in (*angles, *(180 + each for each in angles)):
        rate = level * np.cos(np.radians(angle))
        bench.step(
            0.02 * (0.7 + dead_zone(rate, 0.5) / 3600), noise=1e-8, procedure="threshold_indexing_head",
            step="small_rate", position=f"{angle:g} deg",
        )  # fmt: skip
    (row,) = rows_of(tested, "threshold")
    if latitude_deg is None:
        assert "latitude" in row["reason"]
        return
    expected = min(level * np.cos(np.radians(a)) for a in angles if level * np.cos(np.radians(a)) >= 1.0)
    assert row["value"] == pytest.approx(expected, rel=1e-9)
    assert (row["method"], row["standard"]) == ("indexing_head", "GJB2426A")


def test_threshold_in_one_slow_turn(tested: Any) -> None:
    bench = Bench(tested)
    level = EARTH_DEG_PER_H * np.cos(np.radians(40.0))
    t_s = np.arange(3600 * 2) / 2
    rate = level * np.cos(np.radians(0.1 * t_s) + 0.4)
    output = np.sign(rate) * np.maximum(np.abs(rate) - 0.4, 0)
    volts = 0.02 * (0.5 + output / 3600) + 1e-9 * bench.rng.standard_normal(t_s.size)
    tested.step(
        "r1", "U1", volts, t0_ns=START_NS, dt_ns=SECOND_NS // 2, unit_of_measure="V", procedure="threshold_slow_turn",
        step="slow_turn", rate_command_deg_per_s=0.1,
    )  # fmt: skip
    (row,) = rows_of(tested, "threshold")
    # half a step of 1 s is 0.01 deg/h; the fitted phase and zero of a sine that lacks its middle add less than 0.1
    assert row["value"] == pytest.approx(0.8, abs=0.1)
    assert row["method"] == "slow_turn"
    # the step ends with its last sample, half a second before the last second does
    means = volts.reshape(-1, 2).mean(axis=1)[:-1]
    found = threshold_in_turn(np.arange(3599.0) + 0.5, means * 3600 / 0.02, 0.1, float(level))
    assert row["value"] == pytest.approx(found["value"], rel=1e-9)


@pytest.mark.parametrize(("half_width", "noise"), [(0.0, 1.0), (0.0, 3.0), (1.5, 1.0)])
def test_noise_of_single_seconds_is_no_threshold(half_width: float, noise: float) -> None:
    rng = np.random.default_rng(7)
    level = float(EARTH_DEG_PER_H * np.cos(np.radians(40.0)))
    t_s = np.arange(3600.0) + 0.5
    rate = level * np.cos(np.radians(0.1 * t_s) + 0.4)
    output = 30.0 + np.sign(rate) * np.maximum(np.abs(rate) - half_width, 0) + rng.normal(0, noise, t_s.size)
    found = threshold_in_turn(t_s, output, 0.1, level)
    if half_width:
        assert found["lo"] < 2 * half_width <= found["hi"]
        assert found["value"] == pytest.approx(2 * half_width, rel=0.2)
        return
    # a perfect gyro: the input changes by 0.02 deg/h a second at the crossing, so that the end of a straight piece over
    # an octave x to 2 x is known to about 2 noise sqrt(0.02/x), and to a sixth of x at (12 noise sqrt(0.02))^(2/3)
    assert found["lo"] == 0.0
    assert found["value"] < 1.2 * (12 * noise * 0.02**0.5) ** (2 / 3)


def test_half_a_turn_is_too_little(tested: Any) -> None:
    bench = Bench(tested)
    bench.step(0.0, noise=1e-9, n=1800, dt_ns=SECOND_NS, procedure="threshold_slow_turn", rate_command_deg_per_s=0.1)
    (row,) = rows_of(tested, "threshold")
    assert row["reason"] == "the table turned by 180 deg, the clause asks for one turn (5.10.3.3)"


def test_resolution(tested: Any) -> None:
    bench = Bench(tested)
    bench.tested.product(
        "[product.FOG-V]\nscale_factor = 0.02\nscale_factor_unit = 'V'\nexpected_threshold_deg_per_h = 3.6\n"
    )
    volt = 0.02 / 3600
    words: dict[str, Any] = {"procedure": "resolution", "noise": 1e-8}
    increments = [36.0 * 10 ** (-i / 10) for i in range(12)]
    means: dict[tuple[int, float], float] = {}
    for sign in (1, -1):
        bases = [bench.step(volt * sign * 360, step="base", rate_command_deg_per_s=sign * 0.1, **words)]
        for each in increments:
            means[sign, each] = bench.step(
                volt * sign * (360 + dead_zone(each, 2.0)), step="increment",
                rate_command_deg_per_s=sign * (0.1 + each / 3600), **words,
            )  # fmt: skip
        bases.append(bench.step(volt * sign * 360, step="base", rate_command_deg_per_s=sign * 0.1, **words))
        base = sum(bases) / 2
        held = [e for e in increments if abs(e - sign * (means[sign, e] - base) / volt) / e <= 0.5]
        means[sign, 0.0] = min(held)
    found = {row["standard"]: row for row in rows_of(tested, "resolution")}
    assert found["GJB2426A"]["value"] == pytest.approx(max(means[1, 0.0], means[-1, 0.0]), rel=1e-9)
    assert found["GJB2426A"]["lo"] < 4.0 <= found["GJB2426A"]["hi"]
    assert found["JJF2014"]["reason"] == (
        "the base rate is 100 times the expected threshold of 3.6 deg/h, the clause asks for 20 to 50 times"
    )


def test_resolution_in_one_direction(tested: Any) -> None:
    bench = Bench(tested)
    for rate in (0.1, 0.11):
        bench.step(0.02 * rate, noise=1e-8, procedure="resolution", rate_command_deg_per_s=rate)
    for row in rows_of(tested, "resolution"):
        assert row["reason"] == "no increment backwards was measured, the clause asks for both directions"


def test_a_gap_in_the_middle_ends_what_holds() -> None:
    size = np.array([8.0, 4.0, 2.0, 1.0])
    found = smallest_within_half(
        {"forwards": Direction(size, np.array([0.1, 0.1, 1.5, 0.1]), np.full(4, 1e-3), np.full(4, 50.0))}
    )
    assert (found["value"], found["lo"], found["hi"]) == (4.0, 2.0, 4.0)


def test_nothing_follows() -> None:
    size = np.array([8.0, 4.0])
    found = smallest_within_half({"forwards": Direction(size, size, np.full(2, 1e-3), np.full(2, 50.0))})
    assert found["reason"] == "at no input forwards is the output within 50 % of what it should be"
