"""Misalignment by error separation, from steps to rows: the published tables, and tests that lack something."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analytics.specifications.entering import add_specification
from storage.store import Store
from tests.analytics.conftest import START_NS
from tests.hit2012_separation import ACCELEROMETER_SCALE, GYRO_SCALE, POSITIONS, TABLE_1, TABLE_2

ARCSEC = math.pi / 180 / 3600
GYRO = f'[product.GYRO]\nscale_factor = {GYRO_SCALE}\nscale_factor_unit = "V"\n'


@pytest.fixture
def product(tmp_path: Path) -> Any:
    """Nominal scale factors of products, in the store that `recorded` fills."""

    def write(text: str) -> None:
        path = tmp_path / "specification.toml"
        path.write_text(f'revision = "A"\n{text}')
        add_specification(Store.create(tmp_path / "records"), path)

    return write


def turnings(*rates: float, run: str = "r1", without: str | None = None) -> list[dict[str, Any]]:
    return [
        {"run": run, "unit": "G1", "signal": "rate", "product": "GYRO", "procedure": "gyro_separation", "mean": volts,
         "position": position, "input_rate": sign * rate, "unit_of_measure": "V", "duration_s": 90.0}
        for rate in rates
        for sign, outputs in ((1, TABLE_1[rate][0]), (-1, TABLE_1[rate][1]))
        for position, volts in zip(POSITIONS, outputs, strict=True)
        if position != without
    ]  # fmt: skip


def tumbles(outputs: tuple[float, ...], run: str = "r1", **words: Any) -> list[dict[str, Any]]:
    reported = {
        "run": run, "unit": "A1", "signal": "acceleration", "product": "ACC", "unit_of_measure": "V",
        "procedure": "accelerometer_separation", "duration_s": 60.0,
    } | words  # fmt: skip
    return [reported | {"position": f"beta{90 * i}", "mean": volts} for i, volts in enumerate(outputs)]


def angles(rows: list[dict[str, Any]], *names: str, run: str = "r1") -> list[float]:
    found = {row["angle"]: row["value"] for row in rows if row["run"] == run}
    assert list(found) == list(names)
    return list(found.values())


ACCELEROMETER_ANGLES = ("y2", "z2", "twice_beta", "gamma")
GYRO_ANGLES = ("y0", "x0", "y1", "y2", "z2", "gamma")


def test_the_published_gyro_table_comes_out(recorded: Any, product: Any) -> None:
    product(GYRO)
    rows = recorded([step for rate in TABLE_1 for step in turnings(rate, run=f"r{rate:.0f}")], "gyro_separation")
    for rate, (_, _, printed) in TABLE_1.items():
        found = angles(rows, *GYRO_ANGLES, run=f"r{rate:.0f}")
        np.testing.assert_allclose(found, printed, atol=0.1)
    for row in rows:
        # ten readings, five angles and five offsets: one speed has no interval
        assert (row["n"], row["freedom"], row["unit_of_measure"]) == (10, 0, "arcsec")
        assert (row["lo"], row["hi"]) == (None, None)
        assert row["standard"] == "HIT2012"
        assert row["scale_factor"] == "nominal of product GYRO"


@pytest.mark.long
def test_one_least_squares_over_all_speeds(recorded: Any, product: Any) -> None:
    product(GYRO)
    steps = turnings(20.0, 30.0, 40.0)
    rows = recorded(steps, "gyro_separation")
    design, outputs = [], []
    for step in steps:
        a, b = (math.radians(each) for each in POSITIONS[step["position"]])
        kw = GYRO_SCALE * step["input_rate"]
        offsets = [float(step["position"] == place) for place in POSITIONS]
        design.append([*offsets, -kw * math.cos(b), kw * math.sin(b), -kw, -kw * math.cos(a), kw * math.sin(a)])
        outputs.append(step["mean"])
    x, y = np.array(design), np.array(outputs)
    solved, left = np.linalg.lstsq(x, y)[:2]
    covariance = np.linalg.inv(x.T @ x) * left[0] / (len(y) - 10)
    expected = [*solved[5:] / ARCSEC, math.hypot(*solved[8:]) / ARCSEC]
    np.testing.assert_allclose(angles(rows, *GYRO_ANGLES), expected, rtol=1e-9)
    errors = [row["standard_uncertainty"] for row in rows][:5]
    np.testing.assert_allclose(errors, np.sqrt(np.diag(covariance)[5:]) / ARCSEC, rtol=1e-8)
    assert rows[0]["steps"] == list(range(1, 31))


@pytest.mark.long
def test_the_published_accelerometer_table_comes_out(recorded: Any, product: Any) -> None:
    product(f'[product.ACC]\nscale_factor = {ACCELEROMETER_SCALE}\nscale_factor_unit = "V"\n')
    steps = [step for i, (outputs, _) in enumerate(TABLE_2) for step in tumbles(outputs, run=f"r{i}")]
    rows = recorded(steps, "accelerometer_separation")
    for i, (_, printed) in enumerate(TABLE_2):
        y2, z2, _, gamma = angles(rows, *ACCELEROMETER_ANGLES, run=f"r{i}")
        np.testing.assert_allclose((y2, z2, gamma), printed, atol=0.1)
    gammas = [row["value"] for row in rows if row["angle"] == "gamma"]
    assert np.mean(gammas) == pytest.approx(21.1, abs=0.1)  # erratum: 21.5 is printed


@pytest.mark.long
@pytest.mark.parametrize(("measure", "per_g"), [("g_0", 1.0), ("m/s^2", 9.80665), ("mm/s^2", 9806.65)])
def test_accelerations_need_no_scale_factor(recorded: Any, measure: str, per_g: float) -> None:
    outputs = tuple(per_g * each for each in (0.001, 0.0013, 0.0012, 0.0009))
    rows = recorded(tumbles(outputs, unit_of_measure=measure, signal="acceleration_x"), "accelerometer_separation")
    y2, z2 = 0.0001 / ARCSEC, 0.0002 / ARCSEC
    twice = (0.001 + 0.0012 - 0.0013 - 0.0009) / 4 / ARCSEC
    expected = [y2, z2, twice, math.hypot(y2, z2)]
    np.testing.assert_allclose(angles(rows, *ACCELEROMETER_ANGLES), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.long
def test_the_term_in_twice_the_angle_has_an_uncertainty(recorded: Any, product: Any) -> None:
    """Of one tumble that of the four readings, u/(2 k); of three, their scatter, a display's step of 1 uV."""
    product(f'[product.ACC]\nscale_factor = {ACCELEROMETER_SCALE}\nscale_factor_unit = "V"\n')
    noise = {"standard_uncertainty": 2e-6, "freedom": 50.0}
    one = tumbles(TABLE_2[0][0], run="one", **noise)
    three = [step for outputs, _ in TABLE_2 for step in tumbles(outputs, run="three", standard_uncertainty=1e-9)]
    rows = recorded([*one, *three], "accelerometer_separation")
    alone = {row["angle"]: row for row in rows if row["run"] == "one"}
    assert alone["twice_beta"]["standard_uncertainty"] == pytest.approx(1e-6 / ACCELEROMETER_SCALE / ARCSEC)
    assert alone["y2"]["standard_uncertainty"] == pytest.approx(2e-6 / 2**0.5 / ACCELEROMETER_SCALE / ARCSEC)
    assert alone["gamma"]["lo"] < alone["gamma"]["value"] < alone["gamma"]["hi"]
    together = {row["angle"]: row for row in rows if row["run"] == "three"}
    assert together["twice_beta"]["value"] == pytest.approx(13.354, abs=0.01)
    outputs = np.array([volts for volts, _ in TABLE_2])
    scatter = math.sqrt(((outputs - outputs.mean(axis=0)) ** 2).sum() / 8)
    u = scatter / math.sqrt(12) / ACCELEROMETER_SCALE / ARCSEC
    assert (together["twice_beta"]["standard_uncertainty"], together["twice_beta"]["freedom"]) == (pytest.approx(u), 8)


@pytest.mark.long
def test_a_simulated_run_gives_what_was_planted(tested: Any) -> None:
    """Whole turns with the Earth's rate and noise, through the store; the truth is inside the limits."""
    truth = {"y0": 20.0, "x0": -15.0, "y1": 40.0, "y2": 120.0, "z2": -80.0}
    y0, x0, y1, y2, z2 = (each * ARCSEC for each in truth.values())
    rng = np.random.default_rng(8)
    tested.run("r1", procedure="gyro_separation")
    t_ns = START_NS
    for position, (alpha, beta) in POSITIONS.items():
        a, b = math.radians(alpha), math.radians(beta)
        seen = -y0 * math.cos(b) + x0 * math.sin(b) - y1 + z2 * math.sin(a) - y2 * math.cos(a)
        for rate in (20.0, -20.0, 40.0, -40.0):
            n = round(360 / abs(rate) * 100)
            earth = 11.5 * np.cos(np.radians(rate * np.arange(n) / 100))
            output = 3600 * rate * seen + earth + 7.0 + 5.0 * rng.standard_normal(n)  # deg/h
            t_ns = tested.step(
                "r1", "U1", output, t0_ns=t_ns, dt_ns=10**7, procedure="gyro_separation", position=position,
                rate_command_deg_per_s=rate,
            )  # fmt: skip
    rows = {row["angle"]: row for row in tested.metric("gyro_separation")}
    for name, value in (truth | {"gamma": math.hypot(120, 80)}).items():
        assert rows[name]["value"] == pytest.approx(value, abs=4 * rows[name]["standard_uncertainty"])
        assert 0 < rows[name]["standard_uncertainty"] < 2


@pytest.mark.long
def test_what_is_missing_is_said_once(recorded: Any, product: Any) -> None:
    product(GYRO)
    (row,) = recorded(turnings(20.0, without="alpha90_beta180"), "gyro_separation")
    assert row["reason"] == "position alpha90_beta180 was not measured"
    forwards = [step for step in turnings(20.0) if step["input_rate"] > 0 or step["position"] != "alpha0_beta0"]
    (row,) = recorded(forwards, "gyro_separation")
    assert row["reason"] == "position alpha0_beta0 was turned one way only, the method turns it forwards and backwards"
    (row,) = recorded(tumbles((0.1, 0.2, 0.3)), "accelerometer_separation")
    assert row["reason"] == "position beta270 was not measured"
    assert (row["value"], row["lo"], row["hi"]) == (None, None, None)


@pytest.mark.long
def test_no_scale_factor_is_said(recorded: Any) -> None:
    (row,) = recorded(turnings(20.0), "gyro_separation")
    assert row["reason"].startswith("no scale factor for an output in V")
    (row,) = recorded(tumbles((0.1, 0.2, 0.3, 0.4)), "accelerometer_separation")
    assert row["reason"].startswith("no scale factor for an output in V: give the nominal one of the product, per g")


@pytest.mark.long
def test_what_was_never_tested_has_no_row(recorded: Any) -> None:
    assert recorded([{"mean": 1.0}], "gyro_separation") == []
    assert recorded([{"mean": 1.0, "position": "IRA_up"}], "accelerometer_separation") == []
