"""The digital certificate: every result has its U and k there, in whatever unit its metric is."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET
from xml.etree.ElementTree import Element

import numpy as np
import pytest

from analytics.certificate.document.digital import measured_quantity
from analytics.certificate.document.si_units import si_unit
from analytics.certificate.statement.results import Result
from analytics.certificate.statement.words import Words
from analytics.metric_registry.registry import metrics
from tests.analytics.certificate.conftest import ORDER, RATES_DEG_PER_S, STATION

DCC = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}
OUTPUTS = ("V/(deg/s)", "mV/(deg/s)", "A/(deg/s)", "count/(deg/s)", "LSB/(deg/s)", "V/(deg/s)/g", "smoot/(deg/s)")


@pytest.mark.parametrize(
    ("unit", "written"),
    [
        ("V/(deg/s)", r"\volt\degree\tothe{-1}\second"),
        ("uV/(deg/s)", r"\micro\volt\degree\tothe{-1}\second"),
        ("LSB/(deg/s)", r"\degree\tothe{-1}\second"),
        ("deg/h/sqrt(h)", r"\degree\hour\tothe{-1.5}"),
        ("deg/h/(degC/s)", r"\degree\hour\tothe{-1}\kelvin\tothe{-1}\second"),
        ("%", r"\percent"),
        ("1", r"\one"),
        ("count", r"\one"),
        ("1/g", None),  # of gravity: neither gram nor metre per second squared as the value stands
        ("ug_0", None),
        ("mdeg", None),  # no prefix on a unit that is not of the SI
        ("smoot", None),
    ],
)
def test_units_are_composed_as_d_si_writes_them(unit: str, written: str | None) -> None:
    assert si_unit(unit) == written


def test_no_unit_of_a_metric_loses_u_or_k() -> None:
    units = {each.header.unit for each in metrics().values() if each.header.unit} | set(OUTPUTS)
    assert len(units) > len(OUTPUTS) + 10
    for unit in sorted(units):
        result = Result(
            signal="rate", value=0.05, unit_of_measure=unit, expanded=5.6e-6, k=2.0, p=0.9545,
            conditions=Words("averages of 10 s", "平均时间 10 s"), runs=("R1",),
        )  # fmt: skip
        parent = Element("data")
        measured_quantity(parent, Words("Scale factor", "标度因数"), result)
        texts = [(each.text or "").strip() for each in parent.iter()]
        real = parent.find(".//si:real", DCC)
        if real is None:
            assert any(
                f"0.0500000 {result.unit}, U = 0.0000056 {result.unit}, k = 2, p = 0.9545" == each for each in texts
            )
        else:
            assert {"0.0500000", "0.0000056", "2", "0.9545"} <= set(texts)
            if re.search("count|LSB", unit):
                assert any(f"unit of measure {unit}" in each for each in texts)


@pytest.mark.long  # the gate has the units
def test_a_gyro_with_volts_keeps_its_u_in_the_xml(run_command: Callable[..., Any], tmp_path: Path) -> None:
    rng = np.random.default_rng(59)
    lines, t_s = ["time[s],rate[V],procedure,step,rate_command[deg/s]"], 0
    for rate in (*RATES_DEG_PER_S, *(-each for each in RATES_DEG_PER_S)):
        for value in 0.05 * rate + 0.01 + rng.normal(0.0, 1e-5, 12):
            lines.append(f"{t_s},{value:.8f},scale_factor_jjf2014,rate,{rate}")
            t_s += 1
    (tmp_path / "scale.csv").write_text("\n".join(lines))
    voltmeter = '[standards.dmm]\nuncertainty.voltage = { half_width = 60, unit = "ppm" }\n'
    (tmp_path / "station.toml").write_text(STATION + voltmeter, encoding="utf-8")
    (tmp_path / "order.toml").write_text(ORDER, encoding="utf-8")
    at = ("--unit", "V-1", "--station", "station.toml", "--store", "lab", "--start", "2026-03-02T09:00:00+08:00")
    assert run_command("import", "scale.csv", *at, cwd=tmp_path).code == 0
    words = ("certificate", "--unit", "V-1", "--standard", "JJF2014", "--order", "order.toml", "--out", "v.pdf")
    done = run_command(*words, "--lang", "en", "--store", "lab", "--json", cwd=tmp_path)
    assert done.code == 0, done.err
    root = ET.parse(tmp_path / "v.xml").getroot()
    quantities = root.findall(".//dcc:result//dcc:quantity", DCC)
    in_volts = [each for each in quantities if r"\volt" in each.findtext("si:real/si:unit", "", DCC)]
    assert in_volts
    assert all(float(each.findtext(".//si:valueExpandedMU", "nan", DCC)) > 0 for each in quantities)
    assert all(float(each.findtext(".//si:coverageFactor", "nan", DCC)) >= 2 for each in quantities)
    assert float(in_volts[0].findtext("si:real/si:value", "nan", DCC)) == pytest.approx(0.05, rel=1e-4)
