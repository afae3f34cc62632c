"""The plan of a simulated fleet, and the truth about it."""

import ast
import json
import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from ingest.simulator.physics.environment import StaticEnvironment
from ingest.simulator.physics.gyro import GyroParameters
from ingest.simulator.physics.plan import Plan, load_plan, parse_plan
from ingest.simulator.physics.truth import truth, write_truth
from stream.errors import BadInput
from tests.sources import SOURCES

FLEET = """
[fleet]
seed = 7
units = ["FOG-0230", "FOG-0232"]
power_ons_per_day = 2
hours_per_power_on = 50.0
sample_interval_ns = 10_000_000
scale.counts_per_deg_per_s = 1e8
scale.error_ppm = {mean = 10.0, sd = 30.0}

[fleet.bias]
constant_deg_per_h = {mean = 0.5, sd = 0.2}
turn_on_deg_per_h = 0.1
day_deg_per_h = 0.3
jumps = {rate_per_h = 60.0, sd_deg_per_h = 2.0}
step = [{at_s = 20.0, size_deg_per_h = -4.0}]
ageing_deg_per_h_per_decade = 1.0

[fleet.readout]
dropout = {probability = 0.001, mean_samples = 3.0}
stuck = {probability = 0.0005, mean_samples = 3.0}

[unit."FOG-0231"]
off = ["bias.jumps", "readout.dropout"]
bias.constant_deg_per_h = -9.0
thermal.bias_polynomial_deg_per_h = [{mean = 0.2, sd = 0.01}, 0.001]
"""


def parsed(text: str) -> Plan:
    return parse_plan(text, "fleet.toml")


def test_fleet_units_and_overrides() -> None:
    plan = parsed(FLEET)
    assert plan.units == ("FOG-0230", "FOG-0232", "FOG-0231")
    own, common = plan.parameters["FOG-0231"], plan.parameters["FOG-0230"]
    assert own.bias is not None
    assert common.bias is not None
    assert own.bias.constant_deg_per_h == -9.0
    assert own.bias.jumps is None
    assert own.bias.step == common.bias.step
    assert common.bias.jumps is not None
    assert common.thermal is None
    assert own.thermal is not None
    assert own.thermal.bias_polynomial_deg_per_h[0] == pytest.approx(0.2, abs=0.05)
    assert own.readout is not None
    assert own.readout.dropout is None
    assert own.readout.stuck is not None
    assert {p.sample_interval_ns for p in plan.parameters.values()} == {10_000_000}


def test_what_is_drawn_for_a_unit_depends_on_nothing_else_in_the_plan() -> None:
    plan = parsed(FLEET)
    fewer = parsed('[fleet]\nseed = 7\nunits = ["FOG-0232"]\nscale.error_ppm = {mean = 10.0, sd = 30.0}')
    assert fewer.parameters["FOG-0232"].scale.error_ppm == plan.parameters["FOG-0232"].scale.error_ppm
    other = parsed(FLEET.replace("seed = 7", "seed = 8"))
    assert other.parameters["FOG-0232"].scale.error_ppm != plan.parameters["FOG-0232"].scale.error_ppm


def test_what_is_drawn_differs_from_number_to_number_and_from_unit_to_unit() -> None:
    units = [f"U{i}" for i in range(400)]
    text = f"[fleet]\nseed = 1\nunits = {json.dumps(units)}\n"
    text += "misalignment = {y_arcsec = {mean = 0, sd = 1}, z_arcsec = {mean = 0, sd = 1}}\n"
    text += "thermal.bias_polynomial_deg_per_h = [{mean = 0, sd = 1}, {mean = 0, sd = 1}]"
    drawn = []
    for parameters in parsed(text).parameters.values():
        assert parameters.misalignment is not None
        assert parameters.thermal is not None
        lean = parameters.misalignment
        drawn.append([lean.y_arcsec, lean.z_arcsec, *parameters.thermal.bias_polynomial_deg_per_h])
    table = np.array(drawn)
    assert len(np.unique(table)) == table.size
    assert np.abs(np.corrcoef(table.T) - np.eye(4)).max() < 5 / math.sqrt(400)


def test_distributions_have_their_mean_deviation_and_bounds() -> None:
    units = [f"U{i}" for i in range(1000)]
    text = f"[fleet]\nseed = 1\nunits = {json.dumps(units)}\nscale.error_ppm = {{mean = 10.0, sd = 30.0}}\n"
    text += "noise.angle_random_walk_deg_per_sqrt_h = {mean = 0.01, sd = 0.02, low = 0.0, high = 0.03}"
    plan = parsed(text)
    error = np.array([plan.parameters[unit].scale.error_ppm for unit in units])
    assert error.mean() == pytest.approx(10.0, abs=5 * 30 / math.sqrt(1000))
    assert error.std(ddof=1) == pytest.approx(30.0, rel=5 / math.sqrt(2 * 999))
    noise = [plan.parameters[unit].noise for unit in units]
    walk = np.array([each.angle_random_walk_deg_per_sqrt_h for each in noise if each is not None])
    assert len(walk) == 1000
    assert walk.min() >= 0.0
    assert walk.max() <= 0.03
    # a normal cut to (-0.5, 1) of its sd has the mean mean + sd (phi(-0.5) - phi(1))/(Phi(1) - Phi(-0.5))
    density = [math.exp(-(z**2) / 2) / math.sqrt(2 * math.pi) for z in (-0.5, 1.0)]
    inside = (math.erf(1 / math.sqrt(2)) + math.erf(0.5 / math.sqrt(2))) / 2
    assert walk.mean() == pytest.approx(
        0.01 + 0.02 * (density[0] - density[1]) / inside, abs=5 * 0.0086 / math.sqrt(1000)
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("seed = 1", r"one \[fleet\] and any number"),
        ("[fleet]\nseed = 1\n[units.A]", "nothing else: units"),
        ("[fleet]\nseed = ", "fleet.toml: "),
        ("[fleet]\nseed = 1", "it has no unit"),
        ("[fleet]\nseed = -1\n[unit.A]", r"`\$\.fleet\.seed`"),
        ("[fleet]\n[unit.A]", r"missing required field `seed` - at `\$\.fleet`"),
        ("[fleet]\nseed = 1\nbais = {}\n[unit.A]", r"unknown field `bais` - at `\$\.fleet`"),
        ("[fleet]\nseed = 1\n[unit.A]\nbais = {}", r"unknown field `bais` - at `\$\.unit\.A`"),
        ("[fleet]\nseed = 1\n[unit.A.bias]\nconstant = 1.0", r"unknown field `constant` - at `\$\.unit\.A\.bias`"),
        ("[fleet]\nseed = 1\nbias.jumps.rate_per_h = 1\n[unit.A]", r"`sd_deg_per_h` - at `\$\.fleet\.bias\.jumps`"),
        (
            '[fleet]\nseed = 1\n[[unit."FOG-1".bias.line]]\nfrequency_hz = "50"\namplitude_deg_per_h = 1',
            r"Expected `float`, got `str` - at `\$\.unit\.FOG-1\.bias\.line\[0\]\.frequency_hz`",
        ),
        (
            "[fleet]\nseed = 1\nnoise.angle_random_walk_deg_per_sqrt_h = -1\n[unit.A]",
            r">= 0.*at `\$\.fleet\.noise\.angle_random_walk_deg_per_sqrt_h`",
        ),
        (
            "[fleet]\nseed = 1\nnoise.angle_random_walk_deg_per_sqrt_h = {mean = 0.0, sd = 1.0}\n"
            + "".join(f"[unit.A{i}]\n" for i in range(20)),
            r">= 0.*at `\$\.unit\.A\d+\.noise\.angle_random_walk_deg_per_sqrt_h`",
        ),
        (
            "[fleet]\nseed = 1\nscale.error_ppm = nan\n[unit.A]",
            r"nan is no finite number - at `\$\.fleet\.scale\.error_ppm`",
        ),
        (
            "[fleet]\nseed = 1\n[unit.A]\nscale.error_ppm = {mean = 1, sd = 1, low = 3}",
            r"mean does not lie from low to high - at `\$\.unit\.A\.scale\.error_ppm`",
        ),
        (
            "[fleet]\nseed = 1\n[unit.A]\nscale.error_ppm = {mean = 0, sd = 1e9, low = 0, high = 1e-9}",
            r"hardly any of the distribution - at `\$\.unit\.A\.scale\.error_ppm`",
        ),
        ("[fleet]\nseed = 1\n[unit.A]\nscale.error_ppm = {mean = 1, sd = -1}", r"`\$\.unit\.A\.scale\.error_ppm\.sd`"),
        (
            "[fleet]\nseed = 1\n[unit.A]\nscale.error_ppm = {mean = 1, std = 1}",
            r"`std` - at `\$\.unit\.A\.scale\.error_ppm`",
        ),
        (
            '[fleet]\nseed = 1\n[unit.A]\noff = ["bias.jumps"]',
            r"no bias\.jumps to switch off - at `\$\.unit\.A\.off\[0\]`",
        ),
        ('[fleet]\nseed = 1\n[unit.A]\noff = "bias"', r"list of names.*`\$\.unit\.A\.off`"),
        ('[fleet]\nseed = 1\n[unit."A/B"]', "unit 'A/B' cannot be used as a name"),
        ("[fleet]\nseed = 1\nunit = 3", r"unknown field `unit` - at `\$\.fleet`"),
        ("unit = 3\n[fleet]\nseed = 1", "one .fleet. and any number"),
        ("[fleet]\nseed = 1\n[unit]\nA = 3", r"a table is needed - at `\$\.unit\.A`"),
    ],
)
def test_mistakes_are_named_with_their_place(text: str, message: str) -> None:
    with pytest.raises(BadInput, match=message) as caught:
        parsed(text)
    assert "fleet.toml" in str(caught.value)


def test_plan_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="cannot be read"):
        load_plan(tmp_path / "absent.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(BadInput, match="save it as UTF-8"):
        load_plan(tmp_path / "binary.toml")
    (tmp_path / "fleet.toml").write_text(FLEET, encoding="utf-8")
    assert load_plan(tmp_path / "fleet.toml").parameters == parsed(FLEET).parameters


def test_power_ons_have_their_days_and_ages() -> None:
    plan = parsed(FLEET)
    gyros = [plan.gyro("FOG-0230", power_on=n) for n in (1, 2, 3)]
    assert [(gyro.day, gyro.age_h) for gyro in gyros] == [(1, 0.0), (1, 50.0), (2, 100.0)]
    given = plan.gyro("FOG-0230", 2, day=9, age_h=1.5, start_ns=4)
    assert (given.power_on, given.day, given.age_h, given.time_ns(1)) == (2, 9, 1.5, 10_000_004)
    with pytest.raises(BadInput, match="no unit 'FOG-1' in the plan; it has FOG-0230, FOG-0232, FOG-0231"):
        plan.gyro("FOG-1")
    with pytest.raises(BadInput, match="power-on 0 of unit FOG-0230"):
        plan.gyro("FOG-0230", 0)


@pytest.mark.long
def test_the_output_follows_from_the_truth_alone(tmp_path: Path) -> None:
    path = tmp_path / "truth.jsonl"
    plan = parsed(FLEET)
    write_truth(path, plan, power_ons=3, duration_s=200.0)
    lines: list[dict[str, Any]] = [json.loads(line) for line in path.read_text().splitlines()]
    assert [(line["unit"], line["power_on"]) for line in lines] == [(u, n) for u in plan.units for n in (1, 2, 3)]
    assert [entry.name for entry in tmp_path.iterdir()] == ["truth.jsonl"]
    t_s = np.arange(20_000) * 0.01
    for line in lines:
        bias, drawn = line["parameters"]["bias"], line["drawn"]
        expected = bias["constant_deg_per_h"] + drawn["bias_turn_on_deg_per_h"] + drawn["bias_day_deg_per_h"]
        expected = expected + np.log10(1 + line["age_h"] + t_s / 3600)
        for at_s, size in line["jumps"]:
            expected = expected + size * (t_s >= at_s)
        given = plan.gyro(line["unit"], line["power_on"]).samples(20_000)
        missing, stuck = np.zeros(20_000, bool), np.zeros(20_000, bool)
        for mask, stretches in ((missing, line["dropouts"]), (stuck, line["stuck"])):
            for first, stop in stretches:
                mask[first:stop] = True
        assert np.array_equal(given.present, ~missing)
        out = given.counts * 3600e-8
        assert out[~stuck] == pytest.approx(expected[~stuck], abs=0.5001 * 3600e-8)
        before = np.flatnonzero(stuck)
        assert (given.counts[before[before > 0]] == given.counts[before[before > 0] - 1]).all()
        assert msgspec.convert(line["parameters"], GyroParameters) == plan.parameters[line["unit"]]
    assert any(line["dropouts"] for line in lines)
    assert any(line["stuck"] for line in lines)
    assert sum(len(line["jumps"]) > 1 for line in lines) >= 6


def test_scale_draws_are_in_the_truth() -> None:
    plan = parsed("[fleet]\nseed = 1\nscale = {turn_on_ppm = 100.0, day_ppm = 50.0, error_ppm = 5.0}\n[unit.A]")
    drawn = truth(plan.gyro("A", 3), 1.0)["drawn"]
    gyro = plan.gyro("A", 3, environment=StaticEnvironment(rates_deg_per_s=(100.0, 0, 0)))
    ppm = (gyro.samples(1).counts[0] / 2e6 - 1) * 1e6
    assert ppm == pytest.approx(5.0 + drawn["scale_turn_on_ppm"] + drawn["scale_day_ppm"], abs=0.26)


def test_truth_that_cannot_be_written(tmp_path: Path) -> None:
    plan = parsed(FLEET)
    with pytest.raises(BadInput, match="cannot be written"):
        write_truth(tmp_path / "no" / "truth.jsonl", plan, power_ons=1, duration_s=1.0)
    with pytest.raises(BadInput, match="a duration of nan s"):
        write_truth(tmp_path / "truth.jsonl", plan, power_ons=1, duration_s=math.nan)


def test_nothing_but_the_simulation_reads_the_truth() -> None:
    readers = []
    for package in ("stream", "storage", "ingest", "analytics"):
        for path in (SOURCES / package).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            if "simulator" in path.parts or "truth" not in text:
                continue
            for node in ast.walk(ast.parse(text)):
                names = [alias.name for alias in node.names] if isinstance(node, ast.Import | ast.ImportFrom) else []
                module = node.module or "" if isinstance(node, ast.ImportFrom) else ""
                if any("physics.truth" in f"{module}.{name}" for name in names):
                    readers.append(path)
    assert readers == []


def test_the_physics_knows_nothing_of_analytics_or_estimators() -> None:
    for path in (SOURCES / "ingest/simulator/physics").glob("*.py"):
        text = path.read_text(encoding="utf-8")
        assert "analytics." not in text
        assert "stream.estimators" not in text
