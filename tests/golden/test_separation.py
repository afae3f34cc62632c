"""Misalignment separation against the published tables of HIT 2012 (Li, Ren, Zhao), read to 0.1 arcsec, and against
independent computations from their voltages, to 0.0001 arcsec."""

import math

import numpy as np
import pytest

from analytics.methods.separation import (
    ARCSEC_PER_RAD,
    AccelerometerReading,
    GyroReading,
    Separation,
    accelerometer_separation,
    gyro_separation,
)
from stream.errors import BadInput
from tests.hit2012_separation import (
    ACCELEROMETER_ARCSEC,
    ACCELEROMETER_SCALE,
    GYRO_ARCSEC,
    GYRO_SCALE,
    INVERSE_ARCSEC,
    INVERSE_OFFSET,
    INVERSE_OUTPUTS,
    POSITIONS,
    TABLE_1,
    TABLE_2,
)


def gyro_readings(rate: float) -> list[GyroReading]:
    forwards, backwards, _ = TABLE_1[rate]
    return [
        GyroReading(alpha, beta, sign * rate, volts)
        for sign, outputs in ((1, forwards), (-1, backwards))
        for (alpha, beta), volts in zip(POSITIONS.values(), outputs, strict=True)
    ]


def accelerometer_angles(outputs: tuple[float, ...]) -> Separation:
    readings = [AccelerometerReading(90.0 * i, volts) for i, volts in enumerate(outputs)]
    return accelerometer_separation(readings, ACCELEROMETER_SCALE)


def reported(found: Separation, *names: str) -> list[float]:
    return [*(found.angles[name].value for name in names), found.gamma.value]


@pytest.mark.parametrize("rate", TABLE_1)
def test_gyro_table_is_reproduced(rate: float) -> None:
    found = gyro_separation(gyro_readings(rate), GYRO_SCALE)
    np.testing.assert_allclose(reported(found, "y0", "x0", "y1", "y2", "z2"), TABLE_1[rate][2], atol=0.1)
    np.testing.assert_allclose(reported(found, "y0", "x0", "y1", "y2", "z2"), GYRO_ARCSEC[rate], atol=1e-4)


def test_the_inverse_case_of_the_gyro() -> None:
    """Outputs that were computed from the angles give them back; backwards is V0 less the rest."""
    readings = [
        GyroReading(alpha, beta, sign * 20.0, INVERSE_OFFSET + sign * (volts - INVERSE_OFFSET))
        for sign in (1, -1)
        for (alpha, beta), volts in zip(POSITIONS.values(), INVERSE_OUTPUTS, strict=True)
    ]
    found = gyro_separation(readings, GYRO_SCALE)
    # the outputs are given to 1e-9 V, which are 3.5e-6 arcsec
    expected = [*INVERSE_ARCSEC, math.hypot(-162.0, 56.0)]
    np.testing.assert_allclose(reported(found, "y0", "x0", "y1", "y2", "z2"), expected, atol=1e-5)
    assert found.offset == pytest.approx(INVERSE_OFFSET, abs=1e-12)


@pytest.mark.parametrize(("outputs", "printed"), TABLE_2)
def test_accelerometer_table_is_reproduced(outputs: tuple[float, ...], printed: tuple[float, ...]) -> None:
    np.testing.assert_allclose(reported(accelerometer_angles(outputs), "y2", "z2"), printed, atol=0.1)


@pytest.mark.parametrize("tumble", range(3))
def test_accelerometer_angles_to_a_ten_thousandth_of_an_arcsecond(tumble: int) -> None:
    found = accelerometer_angles(TABLE_2[tumble][0])
    np.testing.assert_allclose(reported(found, "y2", "z2"), ACCELEROMETER_ARCSEC[tumble], atol=1e-4)


def test_the_accelerometer_has_a_term_in_twice_the_angle() -> None:
    """13.1 to 13.5 arcsec, which the paper's model lacks; of one tumble without uncertainties it has no error."""
    found = [accelerometer_angles(outputs).angles["twice_beta"] for outputs, _ in TABLE_2]
    for angle, (outputs, _) in zip(found, TABLE_2, strict=True):
        level, up, turned, down = outputs  # 0, 90, 180, 270 deg
        closed = (level + turned - up - down) / 4 / ACCELEROMETER_SCALE * ARCSEC_PER_RAD
        assert angle.value == pytest.approx(closed, abs=1e-9)
        assert math.isnan(angle.standard_uncertainty)
    assert [round(angle.value, 1) for angle in found] == [13.1, 13.4, 13.5]


def test_three_tumbles_together_have_standard_errors() -> None:
    readings = [AccelerometerReading(90.0 * i, volts) for outputs, _ in TABLE_2 for i, volts in enumerate(outputs)]
    found = accelerometer_separation(readings, ACCELEROMETER_SCALE)
    outputs = np.array([volts for volts, _ in TABLE_2])
    scatter = math.sqrt(((outputs - outputs.mean(axis=0)) ** 2).sum() / (12 - 4)) / ACCELEROMETER_SCALE * ARCSEC_PER_RAD
    errors = [found.angles[name].standard_uncertainty for name in ("y2", "z2", "twice_beta")]
    assert errors == pytest.approx([scatter / math.sqrt(6), scatter / math.sqrt(6), scatter / math.sqrt(12)])
    assert found.gamma.standard_uncertainty == pytest.approx(scatter / math.sqrt(6))
    assert found.freedom == 8


def test_mean_gamma_of_the_accelerometer_is_21_1() -> None:
    gammas = [accelerometer_angles(outputs).gamma.value for outputs, _ in TABLE_2]
    assert np.mean(gammas) == pytest.approx(21.163, abs=5e-4)


def test_one_least_squares_over_all_speeds_is_the_closed_form_weighted_by_rate() -> None:
    every = [reading for rate in TABLE_1 for reading in gyro_readings(rate)]
    found = gyro_separation(every, GYRO_SCALE)
    closed = 0.0
    for rate, (forwards, backwards, _) in TABLE_1.items():
        d = [a - b for a, b in zip(forwards, backwards, strict=True)]
        closed += rate**2 * (d[2] - d[1]) / (4 * GYRO_SCALE * rate)
    closed *= ARCSEC_PER_RAD / sum(rate**2 for rate in TABLE_1)
    assert found.angles["y2"].value == pytest.approx(closed, rel=1e-9)
    # 30 readings less 5 angles and a V0 for each of 5 positions
    assert found.freedom == 20
    assert reported(found, "y0", "x0", "y1", "y2", "z2") == pytest.approx(
        [-7.4602, 2.3853, -53.7849, -162.0727, 56.0242, 171.4826], abs=1e-4
    )
    errors = [found.angles[name].standard_uncertainty for name in ("y0", "x0", "y1", "y2", "z2")]
    assert errors == pytest.approx([0.093, 0.161, 0.093, 0.093, 0.161], abs=1e-3)
    # what is left is about the display's step of 0.1 mV
    assert found.rms == pytest.approx(0.116e-3, abs=0.001e-3)


def test_offsets_that_differ_between_positions_are_no_error_of_the_angles() -> None:
    readings = [reading for rate in TABLE_1 for reading in gyro_readings(rate)]
    plain = gyro_separation(readings, GYRO_SCALE)
    shift = {place: 0.01 * at for at, place in enumerate(POSITIONS.values())}
    moved = [each._replace(output=each.output + shift[each.alpha_deg, each.beta_deg]) for each in readings]
    found = gyro_separation(moved, GYRO_SCALE)
    assert found.gamma == pytest.approx(plain.gamma, rel=1e-9)
    assert found.offset == pytest.approx(plain.offset + np.mean(list(shift.values())))


def test_limits_hold_the_truth_as_often_as_they_say() -> None:
    rng = np.random.default_rng(4)
    truth = {"y0": -7.5, "x0": 2.4, "y1": -54.0, "y2": -162.0, "z2": 56.0}
    y0, x0, y1, y2, z2 = (value / ARCSEC_PER_RAD for value in truth.values())
    held = 0
    for _ in range(500):
        readings = []
        for rate in (-40.0, -30.0, -20.0, 20.0, 30.0, 40.0):
            for alpha, beta in POSITIONS.values():
                a, b = math.radians(alpha), math.radians(beta)
                angle = -y0 * math.cos(b) + x0 * math.sin(b) - y1 + z2 * math.sin(a) - y2 * math.cos(a)
                readings.append(GyroReading(alpha, beta, rate, GYRO_SCALE * rate * angle + rng.normal(0, 1e-4)))
        gamma = gyro_separation(readings, GYRO_SCALE).gamma
        held += gamma.lo <= math.hypot(-162.0, 56.0) <= gamma.hi
    # 500 x 0.95: four standard deviations of the binomial
    assert abs(held - 475) < 4 * math.sqrt(500 * 0.95 * 0.05)


def test_positions_that_tell_too_little_are_refused() -> None:
    with pytest.raises(BadInput, match="tell 4 of 7 unknowns"):
        gyro_separation([each for each in gyro_readings(20.0) if each.alpha_deg == 0.0 and each.beta_deg != 90], 1.0)
