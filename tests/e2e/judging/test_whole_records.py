"""Records that lack samples, values whose U is known, and biases without the Earth's rate: what a verdict may claim."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stream.batch import FloatArray
from tests.e2e.judging.test_doubtful_records import of_unit, parameters, written

Ask = Callable[..., Any]
WHERE = ("--start", "2026-10-01T08:00:00+08:00")
UP = 15.041067 * math.sin(math.radians(40.0))
STATION = """
[station]
site = "plant"
name = "lab"
latitude_deg = 40.0

[instruments.table]
kind = "rate_table"
resource = "TCPIP::127.0.0.1::5025::SOCKET"
max_rate_deg_per_s = 400.0
uncertainty.rate = { U = 1e-2, k = 2, unit = "1" }

[standards.voltmeter]
uncertainty.voltage = { U = 1e-6, unit = "1" }
uncertainty.voltage_offset = { U = 1e-9, unit = "V" }
[standards.level]
uncertainty.levelling = { U = 5, k = 2, unit = "arcsec" }
[standards.north]
uncertainty.heading = { half_width = 3, unit = "arcmin" }
[standards.position]
uncertainty.latitude = { U = 36, k = 2, unit = "arcsec" }
"""
LIMITS = """
revision = "A"
[[limit]]
metric = "bias"
upper = {upper}
unit_of_measure = "deg/h"
parameters = {{ earth_rate = "{earth_rate}" }}
"""


def bias_of(answer: Any, unit: str) -> dict[str, Any]:
    (row,) = [each for each in answer["verdicts"] if each["unit"] == unit and each["metric"] == "bias"]
    return dict(row)


@pytest.mark.long  # in the gate among other doubtful records: `test_doubtful_records.py`
@pytest.mark.parametrize("rate_hz", [1, 10])
def test_a_pass_needs_most_of_its_record(ask: Ask, tmp_path: Path, rate_hz: int) -> None:
    """The step of each is an hour; of two units samples are missing at random, one falls silent."""
    rng = np.random.default_rng(1)
    time_s: FloatArray = np.arange(3600.0 * rate_hz) / rate_hz
    values = 5.0 + 2.0 * rng.standard_normal(time_s.size)
    keep = {
        "WHOLE": np.ones(time_s.size, bool), "GAPS": rng.random(time_s.size) > 0.06,
        "HOLES": rng.random(time_s.size) > 0.3, "DIED": (time_s < 1200.0) | (time_s == time_s[-1]),
    }  # fmt: skip
    paths = []
    for unit, kept in keep.items():
        kept[[0, -1]] = True
        paths.append(of_unit(written(tmp_path / f"{unit}.csv", time_s[kept], rate__dph=values[kept])))
    ask("import", *paths, *WHERE, "--procedure", "static_bias", "--position", "IRA_east_west")
    (tmp_path / "limits.toml").write_text(LIMITS.format(upper=6.0, earth_rate="none"))
    ask("limits", "add", tmp_path / "limits.toml")
    answer = ask("verdicts")
    found = {unit: bias_of(answer, unit) for unit in keep}
    verdicts = {unit: row["verdict"] for unit, row in found.items()}
    assert verdicts == {"WHOLE": "PASS", "GAPS": "PASS", "HOLES": "MARGINAL", "DIED": "MARGINAL"}
    for unit, kept in keep.items():
        remark = parameters(found[unit])["remark"] or ""
        assert (f"{kept.sum()} of {time_s.size} samples are there" in remark) == (unit != "WHOLE")
    n = int(keep["DIED"].sum())
    assert found["DIED"]["reason"] == f"{n} of {time_s.size} samples of its record are there: a PASS needs nine tenths"


@pytest.fixture
def measured(ask: Ask, tmp_path: Path) -> Ask:
    """A voltage with a scale factor from a table of 1 % and a bias of 2 deg/h, the axis up at 40 degrees."""
    rng = np.random.default_rng(2)
    (tmp_path / "station.toml").write_text(STATION)
    volt_per_deg_s = 0.02
    rows = ["time[s],rate[V],procedure,step,axis,rate_command[deg/s]"]
    steps = [float(sign * each) for each in range(10, 120, 10) for sign in (1, -1)]
    for at, commanded in enumerate(steps):
        output = volt_per_deg_s * commanded + 1e-6 * rng.standard_normal(20)
        rows += [f"{30.0 * at + k},{volt:.9f},scale_factor,rate,,{commanded}" for k, volt in enumerate(output)]
    (tmp_path / "scale.csv").write_text("\n".join(rows))
    still = volt_per_deg_s * (2.0 + UP) / 3600.0 + volt_per_deg_s * 0.3 / 3600.0 * rng.standard_normal(3600)
    path = written(tmp_path / "bias.csv", np.arange(3600.0), rate__V=still)
    station = ("--station", tmp_path / "station.toml", "--unit", "V1")
    ask("import", tmp_path / "scale.csv", *WHERE, *station)
    ask(
        "import",
        path,
        "--start",
        "2026-10-01T12:00:00+08:00",
        *station,
        "--procedure",
        "static_bias",
        "--position",
        "IRA_up",
    )
    return ask


@pytest.mark.long
def test_a_bias_without_the_earths_rate_is_no_surer_than_with_it(measured: Ask) -> None:
    answer = measured("metrics", "--metric", "bias")
    rows = answer["metrics"] if isinstance(answer, dict) else answer
    found = {parameters(row)["earth_rate"]: row for row in rows}
    assert found["removed"]["value"] == pytest.approx(2.0, abs=0.05)
    # of the table 0.5 % of F/K, which is 11.7 deg/h, whatever is subtracted from it; JCGM 100 5.1.2
    of_table = 0.005 * found["none"]["value"]
    for row in found.values():
        assert row["u_type_b"] == pytest.approx(of_table, rel=0.01)
        assert row["U"] == pytest.approx(2.0 * math.hypot(of_table, row["u_type_a"]), rel=0.01)


CASES = [
    (0.06, "MARGINAL"), *(pytest.param(*each, marks=pytest.mark.long) for each in
    [(0.2, "PASS"), (-0.06, "MARGINAL"), (-0.2, "FAIL")]),
]  # fmt: skip


@pytest.mark.parametrize(("above", "verdict"), CASES)
def test_a_limit_within_u_of_the_value_is_not_decided(
    measured: Ask, tmp_path: Path, above: float, verdict: str
) -> None:
    """The scatter of the value is 0.005 deg/h, its U 0.12 deg/h."""
    (tmp_path / "limits.toml").write_text(LIMITS.format(upper=2.0 + UP + above, earth_rate="none"))
    measured("limits", "add", tmp_path / "limits.toml")
    row = bias_of(measured("verdicts"), "V1")
    assert row["verdict"] == verdict
    assert row["hi"] - row["value"] == pytest.approx(0.117, rel=0.02)
