"""An attitude unit on the simulated station, by JJF 1536-2015: procedures, figures, compensation and certificate."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from analytics.certificate.statement.standards import standards
from analytics.evaluation.inner_page import inner_page_titles
from tests.analytics.certificate.conftest import ORDER
from tests.analytics.certificate.pdf_checks import lacking_items, pages_of, plain
from tests.e2e.conftest import Bench, finish

# of X, Y, Z: ppm, deg/h; leans of each input axis towards the next two axes, arcsec
SCALES_PPM = {"x": 250.0, "y": -180.0, "z": 90.0}
BIASES = {"x": 6.0, "y": -3.0, "z": 1.5}
LEANS = {"x": (400.0, -200.0), "y": (-410.0, 620.0), "z": (310.0, -515.0)}
INSTRUMENTS = """
serial = "T-881"
certificate = "2026-RT-0113"
traceable_to = "NIM, rate"
calibration_due = 2099-09-30
[instruments.table.uncertainty]
rate = { U = 5e-5, k = 2.0, unit = "1" }
rate_nonuniformity = { U = 2e-5, k = 2.0, unit = "1" }
"""
STANDARDS = """
[standards.site]
serial = "N-3"
certificate = "2026-GEO-7"
traceable_to = "NIM, length and angle"
calibration_due = 2099-05-31
[standards.site.uncertainty]
levelling = { half_width = 5.0, unit = "arcsec" }
mounting = { U = 5.0, k = 2.0, unit = "arcsec" }
clock = { U = 1.0, k = 2.0, unit = "ppm" }
"""
RUNS = {
    "attitude_unit_scale_factor": ("warm_up_s=1",),
    "attitude_unit_bias": ("position_record_s=60", "position_settle_s=2"),
    "attitude_unit_bias_many": ("position_record_s=40", "position_settle_s=2", "angles_deg=0,90,180,270"),
    "attitude_unit_misalignment": (),
}


def fleet() -> str:
    """The plan of one unit with known errors."""
    parts = ['[fleet]\nseed = 5\nunits = ["SIM-0001"]\nsample_interval_ns = 50000000\n']
    for axis in "xyz":
        towards, further = LEANS[axis]
        parts.append(
            f"[fleet.gyro_{axis}.scale]\nerror_ppm = {SCALES_PPM[axis]}\n"
            f"[fleet.gyro_{axis}.bias]\nconstant_deg_per_h = {BIASES[axis]}\n"
            f"[fleet.gyro_{axis}.misalignment]\ny_arcsec = {towards}\nz_arcsec = {further}\n"
            f"[fleet.gyro_{axis}.noise]\nangle_random_walk_deg_per_sqrt_h = 0.002\n"
            f"[fleet.gyro_{axis}.readout]\ncarries_rest = true\n"
        )
    return "".join(parts)


def own_part(axis: str) -> float:
    """Cosine of the lean of an input axis."""
    return math.sqrt(1.0 - sum(math.sin(math.radians(each / 3600)) ** 2 for each in LEANS[axis]))


def planted(row: dict[str, Any]) -> float:
    """What the simulator has for a row of the metrics: K, B in deg/h, or L in arcmin."""
    axis = row["signal"][-1]
    if row["metric"] == "scale_factor":
        return (1.0 + SCALES_PPM[axis] * 1e-6) * own_part(axis)
    if row["metric"] == "attitude_unit_bias":
        return BIASES[axis] / ((1.0 + SCALES_PPM[axis] * 1e-6) * own_part(axis))
    turned = row["parameters"]["element"][-1]
    lean = LEANS[axis][("xyz".index(turned) - "xyz".index(axis)) % 3 - 1]
    return math.sin(math.radians(lean / 3600)) / own_part(axis) * 180 / math.pi * 60


@pytest.fixture(scope="module")
def laboratory(
    tmp_path_factory: pytest.TempPathFactory, simulated: Callable[..., Bench], run_command: Callable[..., Any]
) -> Path:
    """The folder of a store S in which the simulated unit has been calibrated by all four procedures."""
    here = tmp_path_factory.mktemp("attitude")
    (here / "sim").mkdir()
    (here / "sim" / "fleet.toml").write_text(fleet())
    # twenty times real time: a busy machine hands samples over late, and must not be late by a step
    bench = simulated(here / "sim", "--units", 1, "--device", "imu", "--speed", 20, "--rate-hz", 20)
    station = here / "sim" / "station.toml"
    text = station.read_text().replace("[instruments.table.positions]", f"{INSTRUMENTS}\n[instruments.table.positions]")
    # a certificate of a simulated run is a draft: here the station plays a real one
    station.write_text(text.replace("simulated = true\n", "") + STANDARDS)
    try:
        for procedure, changes in RUNS.items():
            more = [word for each in changes for word in ("--set", each)]
            done = run_command(*bench.run(procedure, *more), cwd=here)
            assert done.code == 0, done.err
    finally:
        finish(bench)
    return here


@pytest.mark.long
def test_what_is_planted_comes_back_within_the_stated_uncertainty(
    laboratory: Path, run_command: Callable[..., Any]
) -> None:
    truth = json.loads((laboratory / "sim" / "truth.jsonl").read_text().splitlines()[-1])
    for axis, gyro in truth["gyros"].items():
        assert gyro["parameters"]["bias"]["constant_deg_per_h"] == BIASES[axis]
    asked = run_command("metrics", "--store", "S", "--standard", "JJF 1536", "--json", cwd=laboratory)
    assert asked.code == 0, asked.err
    wanted = {"scale_factor": 3, "attitude_unit_bias": 6, "attitude_unit_misalignment": 6}
    for metric, n in wanted.items():
        rows = [row for row in asked.json if row["metric"] == metric]
        assert len(rows) == n
        for row in rows:
            assert row["value"] is not None, row
            assert row["U"] is not None, row
            assert abs(row["value"] - planted(row)) <= row["U"], (row["signal"], row["parameters"], row["value"])


@pytest.mark.long
def test_the_compensated_unit_keeps_its_attitude(laboratory: Path, run_command: Callable[..., Any]) -> None:
    """By the calibration of the other runs, in positions that it was not made of."""
    runs = run_command("sql", "--store", "S", "--json", "select run, procedure from runs", cwd=laboratory).json
    named = {row["procedure"]: row["run"] for row in runs}
    words = ["attitude", "--unit", "SIM-0001", "--run", named["attitude_unit_bias_many"], "--store", "S", "--json"]
    for procedure in ("attitude_unit_scale_factor", "attitude_unit_bias", "attitude_unit_misalignment"):
        words += ["--calibration", named[procedure]]
    done = run_command(*words, cwd=laboratory)
    assert done.code == 0, done.err
    assert len(done.json["steps"]) == 12
    for step in done.json["steps"]:
        left, as_given = (
            max(abs(step[which][name]) for name in ("heading_deg", "pitch_deg", "roll_deg"))
            for which in ("compensated_error", "raw_error")
        )
        # 6 deg/h for 40 s
        assert as_given > 0.05
        assert left < 0.03 * as_given
        # 36 values share their biases: a 99.99 % interval
        for name, u in step["expanded_deg"].items():
            assert abs(step["compensated_error"][name]) < 2.0 * u


@pytest.mark.long
def test_its_certificate_is_whole_in_both_languages(laboratory: Path, run_command: Callable[..., Any]) -> None:
    stated = 'deviations = { en = "shorter records, as agreed", zh = "按约定缩短记录时间" }'
    order = "\n".join(stated if line.startswith("deviations") else line for line in ORDER.splitlines())
    (laboratory / "order.toml").write_text(order, encoding="utf-8")
    words = ("certificate", "--unit", "SIM-0001", "--standard", "JJF1536", "--order", "order.toml", "--lang", "both")
    done = run_command(*words, "--out", "unit.pdf", "--store", "S", "--json", cwd=laboratory)
    assert done.code == 0, done.err
    assert (done.json["is_draft"], done.json["missing"]) == (False, [])
    assert any("records of 40 s: the clause has 1200 s" in each for each in done.json["deviations"])
    text = "".join(pages_of(laboratory / "unit.pdf"))
    for language in ("zh", "en"):
        assert lacking_items(text, standards()["JJF1536"], language) == []
        names = [getattr(title, language) for title in inner_page_titles("JJF1536")]
        assert [name for name in names if plain(name) not in text] == []
    assert "未校准" not in text
    verified = run_command("certificate", "verify", "unit.pdf", "--store", "S", "--json", cwd=laboratory)
    assert (verified.code, verified.json["valid"], verified.json["changed"]) == (0, True, [])
