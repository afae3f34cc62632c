"""Files of screening limits: what is refused, and how the others are converted to a specification."""

from pathlib import Path

import pytest

from storage.specifications.live_limits import live_limits
from storage.specifications.specification import parse_specification, read_specification
from stream.errors import BadInput
from stream.events import Limit

GOOD = """
revision = "A"
[[limit]]
characteristic = "bias_stability"
signal = "rate"
tau_s = 10.0
upper = 0.5
unit_of_measure = "deg/h"
"""


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"bias_stability"', '"bias_stabilty"', r"x\.toml: Invalid enum value 'bias_stabilty' - at `\$\.limit\[0\]"),
        ("upper = 0.5", "upper = -1", r"Expected `float` > 0.0 - at `\$\.limit\[0\]\.upper`"),
        ("upper = 0.5", "upper = inf", r"\$\.limit\[0\] \(bias_stability\): upper and tau_s are finite"),
        ("upper = 0.5", "uper = 0.5", r"unknown field `uper` - at `\$\.limit\[0\]`"),
        ("tau_s = 10.0", "", r"\$\.limit\[0\] \(bias_stability\): tau_s is missing"),
        ('"deg/h"', '"degg/h"', "unit of measure 'degg/h' is not known"),
        ('"deg/h"', '"degC"', "'degC' is no angular rate"),
        ('revision = "A"', "", "missing required field `revision`"),
        ('"bias_stability"', '"angle_random_walk"', r"unit_of_measure is 'deg/sqrt\(h\)', not 'deg/h'"),
        ("[[limit]]", "[[limit", "x.toml: "),
    ],
)
def test_a_wrong_table_is_refused_with_the_place(old: str, new: str, message: str) -> None:
    with pytest.raises(BadInput, match=message):
        parse_specification(GOOD.replace(old, new), "x.toml")


def test_angle_random_walk_takes_no_tau_but_one_second() -> None:
    text = GOOD.replace("bias_stability", "angle_random_walk").replace("deg/h", "deg/sqrt(h)")
    with pytest.raises(BadInput, match="it is read at 1 s; leave tau_s out"):
        parse_specification(text, "x.toml")
    assert parse_specification(text.replace("tau_s = 10.0", ""), "x.toml").limits[0].parameters == {}


def test_limits_are_read_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "limits.toml"
    with pytest.raises(BadInput, match=r"limits\.toml: cannot be read \(No such file"):
        read_specification(path)
    path.write_text(GOOD, encoding="utf-8")
    assert parse_specification(read_specification(path), str(path)).label == "limits-A"
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(BadInput, match=r"limits\.toml: "):
        parse_specification(read_specification(path), str(path))


def test_a_limit_is_the_same_after_conversion() -> None:
    (limit,) = parse_specification(GOOD, "x.toml").limits
    (live,) = live_limits(limit, ["rate_x"])
    assert live == Limit(characteristic="bias_stability", signal="rate", tau_s=10.0, upper=0.5, unit_of_measure="deg/h")
