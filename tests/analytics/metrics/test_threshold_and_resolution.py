"""Threshold and resolution against the inputs of a known dead zone, and on bad input."""

from typing import Any

import numpy as np
import pytest

from analytics.methods.half_error import Direction, smallest_within_half, threshold_in_turn
from tests.analytics.conftest import SECOND_NS, START_NS
from tests.analytics.metrics.metric_rows import EARTH_DEG_PER_H
from tests.analytics.metrics.volt_bench import Bench


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
    (row,) = tested.metric("threshold")
    held = [[r for r in rates if abs(s * r - (means[s * r] - zero) / volt) / r <= 0.5] for s in (1, -1)]
    assert row["value"] == pytest.approx(max(min(each) for each in held), rel=1e-9)
    # a dead zone of half width D follows by half at 2 D
    assert row["lo"] < 2 * 4.0 <= row["hi"]
    assert row["method"] == "rate_table"
    assert row["standard"] == "GJB2426A, JJF2014"


@pytest.mark.long
def test_threshold_without_rest_or_direction(tested: Any) -> None:
    bench = Bench(tested)
    words: dict[str, Any] = {"procedure": "threshold", "noise": 1e-7, "step": "small_rate"}
    bench.step(0.02 * 0.01, rate_command_deg_per_s=0.01, **words)
    (row,) = tested.metric("threshold")
    assert row["reason"].startswith("no record of the table at rest")
    bench.step(0.0, procedure="threshold", noise=1e-7, step="rest", rate_command_deg_per_s=0.0)
    (row,) = tested.metric("threshold")
    assert row["reason"] == "no rate backwards was measured, the clause asks for both directions"


@pytest.mark.long
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
    (row,) = tested.metric("threshold")
    if latitude_deg is None:
        assert "latitude" in row["reason"]
        return
    expected = min(level * np.cos(np.radians(a)) for a in angles if level * np.cos(np.radians(a)) >= 1.0)
    assert row["value"] == pytest.approx(expected, rel=1e-9)
    assert (row["method"], row["standard"]) == ("indexing_head", "GJB2426A")


@pytest.mark.long
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
    (row,) = tested.metric("threshold")
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


@pytest.mark.long
def test_half_a_turn_is_too_little(tested: Any) -> None:
    bench = Bench(tested)
    bench.step(0.0, noise=1e-9, n=1800, dt_ns=SECOND_NS, procedure="threshold_slow_turn", rate_command_deg_per_s=0.1)
    (row,) = tested.metric("threshold")
    assert row["reason"] == "the table turned by 180 deg, the clause asks for one turn (5.10.3.3)"


@pytest.mark.long
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
    found = {row["standard"]: row for row in tested.metric("resolution")}
    assert found["GJB2426A"]["value"] == pytest.approx(max(means[1, 0.0], means[-1, 0.0]), rel=1e-9)
    assert found["GJB2426A"]["lo"] < 4.0 <= found["GJB2426A"]["hi"]
    assert found["JJF2014"]["reason"] == (
        "the base rate is 100 times the expected threshold of 3.6 deg/h, the clause asks for 20 to 50 times"
    )


@pytest.mark.long
def test_resolution_in_one_direction(tested: Any) -> None:
    bench = Bench(tested)
    for rate in (0.1, 0.11):
        bench.step(0.02 * rate, noise=1e-8, procedure="resolution", rate_command_deg_per_s=rate)
    for row in tested.metric("resolution"):
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
