"""One rotation: where it rests and turns, and what is refused."""

import math

import numpy as np
import pytest

from analytics.system_level.calibration import Way, results
from analytics.system_level.rotation_record import ImuSeries, Rotation, around_the_turn, evaluated, kernels_of
from stream.errors import BadInput
from tests.analytics.system_level.rotation_kinematics import GRAVITY, LATITUDE_DEG, Planted, axes_of, turned

NOMINAL = (axes_of("ENU"), math.radians(0.1))


def first(planted: Planted | None = None, speed: float = 30.0) -> ImuSeries:
    return turned("ENU", 0, 1, speed, planted or Planted())


def joined(*parts: ImuSeries) -> ImuSeries:
    rates = np.concatenate([part.rates_rad_per_s for part in parts], axis=1)
    return ImuSeries(parts[0].dt_s, rates, np.concatenate([part.forces_m_per_s2 for part in parts], axis=1))


def test_a_table_that_still_comes_to_its_angle_is_cut_off() -> None:
    whole = first()
    coming = ImuSeries(0.01, np.repeat([[0.1], [0.0], [0.0]], 30, axis=1), whole.forces_m_per_s2[:, :30])
    settling = ImuSeries(0.01, whole.rates_rad_per_s[:, :50], whole.forces_m_per_s2[:, :50])
    cut, rests = around_the_turn(joined(coming, settling, whole), "r")
    assert np.array_equal(cut.rates_rad_per_s, whole.rates_rad_per_s)
    assert (rests.first, rests.second) == (1500, 2100)


def test_a_table_that_overshoots_and_comes_back_has_turned_further() -> None:
    """A gyro sees the asymmetry of the way there and back: A follows from the path, not from half a turn."""
    planted = Planted(symmetric=np.zeros(3), accelerometer_m_per_s2=np.zeros(3))
    plain = evaluated(first(planted), LATITUDE_DEG, NOMINAL, "r")
    beyond, back = (np.radians(sign * 30.0) for sign in (1, -1))
    over = first(planted)
    extra = round(10.0 / 30.0 / 0.01)  # 10 deg too far, and back
    rates, forces = over.rates_rad_per_s, over.forces_m_per_s2
    angle = np.pi + np.concatenate([np.arange(extra) + 0.5, extra - np.arange(extra) - 0.5]) * beyond * 0.01
    way = np.concatenate([np.full(extra, beyond), np.full(extra, back)])
    more_rates = np.zeros((3, 2 * extra))
    more_rates[0] = way + planted.asymmetric[0] * np.abs(way)
    more_forces = GRAVITY * np.stack([np.zeros(2 * extra), np.sin(angle), np.cos(angle)])
    overshot = evaluated(
        ImuSeries(
            0.01, np.concatenate([rates[:, :2100], more_rates, rates[:, 2100:]], axis=1),
            np.concatenate([forces[:, :2100], more_forces, forces[:, 2100:]], axis=1),
        ),
        LATITUDE_DEG, NOMINAL, "r",
    )  # fmt: skip
    assert math.degrees(overshot.path_rad) == pytest.approx(180.0 + 2 * extra * 0.3, abs=1e-3)
    change = overshot.change - plain.change
    assert change == pytest.approx(-GRAVITY * planted.asymmetric[0] * (overshot.path_rad - math.pi), rel=0.02)


def test_the_kernels_are_what_noise_comes_through_by() -> None:
    """Each sample's error, navigated on its own, moves dv'(T2) - dv'(T1) and both dv'' by its kernel."""
    series = first()
    plain = evaluated(series, LATITUDE_DEG, NOMINAL, "r")
    for sample in (100, 1400, 1800, 2200, 3500):
        for is_rate in (True, False):
            rates, forces = series.rates_rad_per_s.copy(), series.forces_m_per_s2.copy()
            step = 1e-6
            if is_rate:
                rates[0, sample] += step
            else:
                # along north, wherever the body is
                angle = np.clip((sample + 0.5 - 1500) / 600, 0, 1) * np.pi
                forces[:, sample] += step * np.array([0.0, np.cos(angle), -np.sin(angle)])
            found = evaluated(ImuSeries(0.01, rates, forces), LATITUDE_DEG, NOMINAL, "r")
            moved = np.array([found.change, *found.curvatures]) - np.array([plain.change, *plain.curvatures])
            # a rate about east tilts what points up towards the south; levelling takes a mean force out again
            kernel = -found.kernels.rate[:, sample] if is_rate else found.kernels.force[:, sample]
            assert moved / step == pytest.approx(kernel, abs=2e-3 * np.abs(found.kernels.rate).max())


def test_the_walk_of_the_angle_limits_the_asymmetry_as_it_should() -> None:
    """u(A) = N sqrt(T2 - T1)/(pi sqrt(2)) for a perfect slope; that of a parabola over each rest is 10 % more."""
    kernels = kernels_of(4800, around_the_turn(first(speed=10.0), "r")[1], 0.01, GRAVITY)
    noise = 0.02 * math.radians(1.0) / 60.0
    u = noise / math.sqrt(0.01) * float(np.linalg.norm(kernels.rate[0])) / (math.sqrt(2.0) * GRAVITY * math.pi)
    ideal = noise * math.sqrt(33.0) / (math.pi * math.sqrt(2.0))
    assert ideal * 1e6 == pytest.approx(7.5, abs=0.05)
    assert u / ideal == pytest.approx(1.10, abs=0.01)


@pytest.mark.parametrize(
    ("series", "reason"),
    [
        (joined(first(), first()), "2 turns in one record; name each by its position"),
        (ImuSeries(0.01, first().rates_rad_per_s * 1e-3, first().forces_m_per_s2), "no gyro sees a turn"),
        (ImuSeries(0.01, first().rates_rad_per_s * 0.9, first().forces_m_per_s2), "turns by 162 deg"),
        (ImuSeries(0.01, first().rates_rad_per_s, first().forces_m_per_s2 * 0.9), "not gravity; is one saturated"),
        (ImuSeries(0.02, first().rates_rad_per_s, first().forces_m_per_s2), "sampled at 50 Hz"),
        (ImuSeries(0.01, -first().rates_rad_per_s, first().forces_m_per_s2), "do not follow the turn"),
        (ImuSeries(0.01, first().rates_rad_per_s, first().forces_m_per_s2[[1, 2, 0]]), "do not follow the turn"),
        (ImuSeries(0.01, first().rates_rad_per_s, first().forces_m_per_s2[[2, 1, 0]]), "is not level at rest"),
    ],
)
def test_what_is_no_rotation_is_refused(series: ImuSeries, reason: str) -> None:
    with pytest.raises(BadInput, match=reason):
        evaluated(series, LATITUDE_DEG, NOMINAL, "r")


def test_gyros_too_coarse_for_the_earth_need_words() -> None:
    coarse = turned("ENU", 0, 1, 30.0, Planted(walk_deg_per_sqrt_h=0.3), rng=np.random.default_rng(3))
    with pytest.raises(BadInput, match="its heading is unknown: the position word names no position"):
        evaluated(coarse, LATITUDE_DEG, None, "r")
    assert evaluated(coarse, LATITUDE_DEG, NOMINAL, "r").axis == 0


def test_one_rotation_of_three_tells_nothing_and_says_so() -> None:
    one: list[Rotation] = [evaluated(first(), LATITUDE_DEG, NOMINAL, "r")]
    for result in results(one, LATITUDE_DEG):
        if result.way is not Way.REST:
            assert not result.budgets
            assert result.reason
