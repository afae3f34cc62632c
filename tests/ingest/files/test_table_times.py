"""Times to nanoseconds, exactly rounded."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ingest.tables.columns import TableOptions
from ingest.tables.file import TableFile
from ingest.tables.times import (
    MAX_NS,
    UTC_FROM_NS,
    RunClock,
    decimal_places,
    ns_from_decimals,
    ns_from_floats,
    ns_from_index,
    ns_from_integers,
    ns_from_stamp,
    ns_from_stamps,
    ns_from_text,
    ns_from_timestamps,
    ns_per_unit,
)
from stream.errors import BadInput

UNITS = [1, 10**3, 10**6, 10**9, 60 * 10**9]


@given(st.floats(-4e9, 4e9), st.sampled_from(UNITS))
def test_floats_are_rounded_once(time: float, ns: int) -> None:
    exact = Fraction(time) * ns
    if abs(exact) > MAX_NS:
        return
    times_ns, wrong = ns_from_floats(np.array([time]), ns)
    assert not wrong[0]
    assert abs(int(times_ns[0]) - exact) <= Fraction(1, 2) + Fraction(1, 10**6)


@given(st.decimals(-4 * 10**9, 4 * 10**9, places=15), st.sampled_from([1, 10**3, 10**6, 10**9]))
def test_text_and_decimals_are_rounded_half_to_even(time: Decimal, ns: int) -> None:
    places = decimal_places(ns)
    assert places is not None
    exact = round(Fraction(time) * ns)
    times_ns, wrong = ns_from_decimals(pa.array([time], pa.decimal128(38, 24)), places)
    assert ns_from_text(str(time), ns) == (exact if abs(exact) <= MAX_NS else None)
    assert wrong[0] == (abs(exact) > MAX_NS)
    assert wrong[0] or times_ns[0] == exact


def test_integers_do_not_pass_through_float() -> None:
    times_ns, wrong = ns_from_integers(np.array([1763683200000000001, 2**63 - 1, -(2**63)]), 1)
    assert times_ns[0] == 1763683200000000001
    assert wrong.tolist() == [False, True, True]


@pytest.mark.parametrize("text", ["1e300", "-1e300", "9e9", "1e999999999"])
def test_text_out_of_range_is_none(text: str) -> None:
    assert ns_from_text(text, 10**9) is None


@pytest.mark.parametrize(("text", "ns"), [("1e-300", 0), ("0.0000000005", 0), ("0.0000000015", 2), ("1e-999999999", 0)])
def test_tiny_text(text: str, ns: int) -> None:
    assert ns_from_text(text, 10**9) == ns


def test_floats_that_are_no_times() -> None:
    assert ns_from_floats(np.array([np.nan, np.inf, -np.inf, 1e30, 0.0]), 10**9)[1].tolist() == [True] * 4 + [False]


@given(st.integers(0, 10**9), st.sampled_from([0.1, 1.0, 3.0, 100.0, 102.4, 200.0, 1000.0]))
def test_index_over_rate(index: int, rate_hz: float) -> None:
    exact = Fraction(index) / Fraction(rate_hz) * 10**9
    if exact > UTC_FROM_NS:
        return
    assert abs(int(ns_from_index(np.array([index]), rate_hz)[0]) - exact) <= Fraction(1, 2) + Fraction(1, 10**5)


@pytest.mark.parametrize("unit", ["deg", "ps", "degC", "1"])
def test_units_that_are_no_time(unit: str) -> None:
    with pytest.raises(BadInput):
        ns_per_unit(unit)


def test_the_first_time_decides_for_the_file() -> None:
    clock = RunClock(None)
    clock.settle(10**17)
    assert clock.date_known
    assert clock.misplaced(np.array([10**17 - 1, 10**17])).tolist() == [True, False]
    with pytest.raises(BadInput, match="leave out --start"):
        RunClock(0).settle(10**17)


def test_stamps_are_dates_in_any_year(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    """They had counted from an unknown start where they lay before 1973-03-03, 1e8 s after 1970."""
    moments = [datetime(1973, 3, 3, 9, 46, 35, tzinfo=UTC) + timedelta(seconds=second) for second in range(10)]
    first = write(tmp_path / "a.csv", moments)
    (found,) = gyrofleet("import", first, "--unit", "U", "--run", "r", "--json").json["files"]
    assert (found["date_known"], found["signals"][0]["in_lake"]) == (True, 10)
    later = write(tmp_path / "b.csv", [each + timedelta(days=1) for each in moments])
    (found,) = gyrofleet("import", later, "--unit", "U", "--run", "r", "--json").json["files"]
    assert found["signals"][0]["in_lake"] == 20
    dated = TableOptions(unit="U", start_ns=10**18)
    with pytest.raises(BadInput, match=r"UTC already \(the first is 1973-03-03T09:46:35Z\): leave out --start"):
        TableFile(first, dated).check()
    unset = [each.replace(year=1970, month=1, day=1) for each in moments]
    assert "where a clock that was never set begins" in TableFile(write(first, unset), WHOSE).check().remarks[0]
    with pytest.raises(BadInput, match="expected a time within 3 years of the first one, 1970-01-01T09:46:35Z"):
        TableFile(write(first, [*unset, *(each + timedelta(days=1) for each in moments)]), WHOSE).check()


def write(path: Path, moments: list[datetime]) -> Path:
    path.write_text("time,rate[deg/s]\n" + "".join(f"{each.isoformat()},{each.second}\n" for each in moments))
    return path


WHOSE = TableOptions(unit="U")
STAMPS = st.datetimes(datetime(1971, 1, 1), datetime(2100, 1, 1))
FRACTIONS = st.text("0123456789", min_size=1, max_size=12).map(".{}".format) | st.just("")


@pytest.mark.long
@given(
    st.lists(st.tuples(STAMPS, FRACTIONS), min_size=1, max_size=5),
    st.sampled_from(["", "Z", "+08:00", "-0330", " +05"]),
    st.sampled_from(["T", " "]),
    st.sampled_from(["UTC", "Asia/Shanghai", "Europe/Berlin"]),
)
def test_time_stamps_read_at_once_are_those_read_one_by_one(
    moments: list[tuple[datetime, str]], zone: str, blank: str, where: str
) -> None:
    texts = [f"{moment:%Y-%m-%d}{blank}{moment:%H:%M:%S}{fraction}{zone}" for moment, fraction in moments]
    one_by_one = [ns_from_stamp(text, where) for text in texts]
    found = ns_from_stamps(pa.array(texts), where)
    if found is not None:
        assert found.tolist() == one_by_one
    else:
        is_late = not zone and any(moment.year >= 2038 for moment, _ in moments)
        assert is_late or None in one_by_one or any(len(fraction) > 10 for _, fraction in moments)


def test_clock_changes_of_a_time_zone() -> None:
    """In Berlin 2026-03-29 02:30 does not exist, and 2026-10-25 02:30 comes twice: the first one is meant."""
    assert ns_from_stamp("2026-03-29 02:30:00", "Europe/Berlin") is None
    assert ns_from_stamps(pa.array(["2026-03-29 02:30:00"]), "Europe/Berlin") is None
    first = ns_from_stamp("2026-10-25T00:30:00Z", "UTC")
    assert ns_from_stamp("2026-10-25 02:30:00", "Europe/Berlin") == first
    moments = pa.array([datetime(2026, 3, 29, 2, 30), datetime(2026, 10, 25, 2, 30)], pa.timestamp("us"))
    times_ns, wrong = ns_from_timestamps(moments, "Europe/Berlin")
    assert (wrong.tolist(), times_ns[1]) == ([True, False], first)
