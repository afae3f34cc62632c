"""Preferred numbers against the standard's table, and what every list by rule keeps."""

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ingest.procedures.series import (
    linear_series,
    log_series,
    preferred_below,
    preferred_series,
    series,
    temperature_points,
)
from stream.errors import BadInput

# GB/T 321-2005 (ISO 3:1973) table 1, basic series, column R5, and R10's between them
TABLE_R5 = [1.00, 1.60, 2.50, 4.00, 6.30, 10.00, 16.0, 25.0, 40.0, 63.0, 100.0, 160.0, 250.0, 400.0, 630.0, 1000.0]
TABLE_R10 = [1.00, 1.25, 1.60, 2.00, 2.50, 3.15, 4.00, 5.00, 6.30, 8.00, 10.00]


def test_r5_and_r10_are_those_of_the_standard() -> None:
    assert [each for each in reversed(preferred_below("R5", 1000.0)) if each >= 1.0] == TABLE_R5
    assert [each for each in reversed(preferred_below("R10", 10.0)) if each >= 1.0] == TABLE_R10


@pytest.mark.parametrize(("kind", "steps"), [("R5", 5), ("R10", 10), ("R20", 20)])
def test_preferred_numbers_are_rounded_from_equal_ratios(kind: str, steps: int) -> None:
    """GB/T 321 rounds 10**(i/n) by 1.26 % at most."""
    found = sorted(each for each in preferred_below(kind, 99.0) if each >= 1.0)
    assert len(found) == 2 * steps
    for i, value in enumerate(found):
        assert abs(value / 10 ** (i / steps) - 1) <= 0.0127


def test_eleven_rates_up_to_300() -> None:
    assert preferred_series("R5", 300.0, count=11) == [
        4.0,
        6.3,
        10.0,
        16.0,
        25.0,
        40.0,
        63.0,
        100.0,
        160.0,
        250.0,
        300.0,
    ]


@given(st.floats(1e-3, 1e5), st.integers(2, 20))
def test_a_series_rises_to_its_maximum_without_a_gap_or_a_crowd(most: float, count: int) -> None:
    found = preferred_series("R5", most, count=count)
    assert len(found) == count
    assert found[-1] == most
    ratios = [b / a for a, b in pairwise(found)]
    # a step of R5 is 1.56 to 1.6; next to the maximum up to a step of R20 more, and no less than that
    assert all(1.12 < ratio < 1.6 * 1.13 for ratio in ratios)


@given(st.floats(-120.0, 0.0), st.floats(1.0, 200.0), st.floats(15.0, 35.0), st.floats(2.0, 20.0))
def test_temperature_points_keep_their_distance(least: float, most: float, room: float, apart: float) -> None:
    found = temperature_points(least, most, room, apart)
    assert found == sorted(found)
    assert all(least <= each <= most for each in found)
    assert all(b - a >= apart for a, b in pairwise(found) if (a, b) != (least, most))
    assert all(abs(each - room) >= apart for each in found)
    for end in (least, most):
        assert end in found or abs(end - room) < apart


@given(st.floats(0.01, 100.0), st.floats(1.5, 100.0), st.integers(2, 40))
def test_log_series_have_equal_ratios(least: float, factor: float, count: int) -> None:
    found = log_series(least, least * factor, count)
    assert (found[0], found[-1], len(found)) == (least, least * factor, count)
    wanted = math.log(factor) / (count - 1)
    assert all(math.log(b / a) == pytest.approx(wanted, abs=2e-5) for a, b in pairwise(found))


def test_linear_series_have_equal_steps() -> None:
    assert linear_series(-30.0, 60.0, 4) == [-30.0, 0.0, 30.0, 60.0]


@pytest.mark.parametrize(
    ("kind", "numbers", "reported"),
    [
        ("R5", {"count": 3.0}, "needs max"),
        ("R5", {"max": 3.0}, "exactly one"),
        ("R5", {"max": 3.0, "count": 3.0, "min": 1.0}, "exactly one"),
        ("R5", {"max": -3.0, "count": 3.0}, "not positive"),
        ("R5", {"max": 3.0, "count": 2.5}, "no whole number"),
        ("R5", {"max": 3.0, "count": 3.0, "room": 3.0}, "takes no room"),
        ("R5", {"max": 3.0, "min": 4.0}, "not between 0 and max"),
        ("log", {"min": 0.0, "max": 3.0, "count": 3.0}, "0 < min < max"),
        ("linear", {"min": 3.0, "max": 3.0, "count": 3.0}, "min < max"),
        ("temperatures", {"min": 3.0, "max": 30.0}, "needs room"),
        ("temperatures", {"min": 3.0, "max": 30.0, "room": 20.0, "apart": 0.0}, "not positive"),
    ],
)
def test_what_makes_no_list_is_refused(kind: str, numbers: dict[str, float], reported: str) -> None:
    with pytest.raises(BadInput, match=f"f.toml: .*{reported}"):
        series(kind, numbers, "f.toml: $.step[0].series")  # type: ignore[arg-type]
