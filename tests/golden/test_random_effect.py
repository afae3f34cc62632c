"""Random effect of a coefficient over units, against published values and against simulation."""

import numpy as np
import pytest
from scipy import stats

from analytics.loop.tracing.random_effect import presence, random_effect

# 13 trials of a vaccine, log risk ratios and their variances: Viechtbauer, Stat. Med. 26, 2007, 37-52, data of Colditz
EFFECTS = np.array([
    -0.8893, -1.5854, -1.3481, -1.4416, -0.2175, -0.7861, -1.6209, 0.0120, -0.4694, -1.3713, -0.3394, 0.4459, -0.0173
])  # fmt: skip
VARIANCES = np.array([
    0.3256, 0.1946, 0.4154, 0.0200, 0.0512, 0.0069, 0.2230, 0.0040, 0.0564, 0.0730, 0.0124, 0.5325, 0.0714
])  # fmt: skip


def test_spread_and_bounds_are_those_published() -> None:
    """Paule and Mandel 0.318, Q-profile 0.120 to 1.112 (variances)."""
    found = random_effect(EFFECTS, np.sqrt(VARIANCES))
    assert found is not None
    assert found.spread**2 == pytest.approx(0.318, abs=0.001)
    assert found.spread_lo**2 == pytest.approx(0.120, abs=0.001)
    assert found.spread_hi**2 == pytest.approx(1.112, abs=0.002)
    assert found.mean == pytest.approx(-0.715, abs=0.002)


def test_bounds_hold_mean_and_spread_as_often_as_stated() -> None:
    """400 fleets of eight units: misses of 5 % within the 99.9 % interval of the binomial distribution."""
    rng = np.random.default_rng(8)
    errors = np.array([0.5, 0.5, 0.7, 0.7, 1.0, 1.0, 1.4, 1.4])
    missed = np.zeros(2, dtype=np.int64)
    for _ in range(400):
        values = rng.normal(2.0, 0.8, 8) + errors * rng.standard_normal(8)
        found = random_effect(values, errors)
        assert found is not None
        missed += not found.lo < 2.0 < found.hi, not found.spread_lo <= 0.8 <= found.spread_hi
    most = stats.binom.ppf(0.9995, 400, 0.05)
    assert np.all(missed <= most), missed


def test_a_unit_without_the_effect_is_known_where_the_data_can_tell() -> None:
    errors = np.full(8, 1.0)
    values = np.array([6.0, 6.5, 5.5, 6.2, 5.8, 6.1, 5.9, 0.3])
    assert presence(7, values, errors) < 0.001
    assert presence(0, values[:7], errors[:7]) > 0.999
    weak = np.array([2.0, 2.2, 1.8, 2.1, 1.9, 2.0, 2.0, 1.0])
    assert 0.3 < presence(7, weak, errors) < 0.7
    assert presence(0, values[:3], errors[:3]) == 0.5
