"""Start-up, warm-up, power and entered checks against what the samples themselves say."""

import math
from typing import Any

import numpy as np
import pytest

from stream.events import CheckEntered, Verdict
from tests.analytics.conftest import SECOND_NS, START_NS
from tests.analytics.metrics.metric_rows import EARTH_DEG_PER_H, one

UP = EARTH_DEG_PER_H * math.sin(math.radians(40.0))
DT_NS = 10**7
N = 6000
AFTER_NS = SECOND_NS // 2  # the first sample comes so long after power-on
TAU_S = 2.0
BIAS = 3.0
SPECIFICATION = '[product."FOG-70"]\nstartup_band_deg_per_h = 5.0\n'


def starting(rng: np.random.Generator, transient: float, level: float) -> np.ndarray:
    """Output after power-on, deg/h."""
    time_s = (AFTER_NS + np.arange(N) * DT_NS) / SECOND_NS
    return level + transient * np.exp(-time_s / TAU_S) + rng.normal(0, 0.3, N)


def last_outside(output: np.ndarray, level: float, band: float = 5.0) -> float:
    """When the output is in the band for good, s after power-on."""
    after = int(np.flatnonzero(np.abs(output - level) > band)[-1]) + 1
    return (AFTER_NS + after * DT_NS) / SECOND_NS


def power_cycle(tested: Any, unit: str, output: np.ndarray, t_ns: int, procedure: str, **words: Any) -> int:
    tested.power_on("r1", unit, t_ns)
    tested.step("r1", unit, output, t0_ns=t_ns + AFTER_NS, dt_ns=DT_NS, procedure=procedure, **words)
    return t_ns + 400 * SECOND_NS


def test_startup_time(tested: Any) -> None:
    rng = np.random.default_rng(21)
    tested.product(SPECIFICATION)
    tested.run("r0", procedure="static_bias")
    zero = rng.normal(BIAS + UP, 0.3, 14_400)
    t_ns = tested.step(
        "r0", "U1", zero, t0_ns=START_NS, dt_ns=SECOND_NS // 4, procedure="static_bias", position="IRA_up"
    )
    known = zero.mean() - UP
    tested.run("r1", procedure="startup_time", t_ns=t_ns)
    tested.mount("r1", "U1", product="FOG-70")
    rates = starting(rng, 50.0, BIAS + UP + 300 * 3600 * 1.0001)
    up, east = starting(rng, 100.0, BIAS + UP), starting(rng, 20.0, BIAS)
    t_ns = power_cycle(tested, "U1", rates, t_ns, "startup_time", rate_command_deg_per_s=300.0)
    t_ns = power_cycle(tested, "U1", up, t_ns, "startup_time", position="IRA_up")
    t_ns = power_cycle(tested, "U1", east, t_ns, "startup_time", position="IRA_east")
    of = tested.metrics("startup_time", "warmup_time")
    found = of["startup_time"]
    expected = {
        # without a measured scale factor the end of the record is what a rate test settles to
        "rate 300 deg/s": last_outside(rates, rates[-N // 4 :].mean()),
        "position IRA_up": last_outside(up, known + UP),
        "position IRA_east": last_outside(east, known),
    }
    for test, seconds in expected.items():
        row = one(found, test=test)
        assert row["value"] == pytest.approx(seconds, rel=1e-9)
        assert row["counted_from"] == "power-on"
    largest = one(found, test="largest")
    assert largest["value"] == pytest.approx(max(expected.values()), rel=1e-9)
    assert largest["steps"] == [1, 2, 3]
    assert one(found, test="position IRA_up")["reference"] == "bias of run r0"
    # what the output would do without its noise is within the limits
    assert one(found, test="position IRA_up")["lo"] <= TAU_S * math.log(100 / 5) <= largest["hi"]
    assert of["warmup_time"] == []


@pytest.mark.long
def test_the_limits_of_the_startup_time_hold_the_time_without_noise(tested: Any) -> None:
    rng = np.random.default_rng(22)
    tested.product(SPECIFICATION)
    tested.run("r1", procedure="startup_time")
    transients = rng.uniform(20, 200, 40)
    for unit, transient in enumerate(transients):
        tested.mount("r1", f"U{unit:02d}", product="FOG-70")
        power_cycle(tested, f"U{unit:02d}", starting(rng, transient, 0.0), START_NS, "startup_time", position="IRA_up")
    found = {row["unit"]: row for row in tested.metric("startup_time") if row["test"] == "largest"}
    for unit, transient in enumerate(transients):
        row = found[f"U{unit:02d}"]
        assert row["lo"] <= TAU_S * math.log(transient / 5) <= row["hi"] + DT_NS / SECOND_NS


@pytest.mark.long
def test_warmup_time_and_why_there_is_none(tested: Any) -> None:
    rng = np.random.default_rng(23)
    tested.product(SPECIFICATION + '[product."FOG-50"]\nscale_factor = 1.0\nscale_factor_unit = "mV"\n')
    tested.run("r1", procedure="warmup_time")
    good = starting(rng, 50.0, 1.0)
    for unit, product in (("U1", "FOG-70"), ("U2", "FOG-50"), ("U3", None), ("U4", "FOG-70")):
        tested.mount("r1", unit, product=product)
        power_cycle(tested, unit, good, START_NS, "warmup_time", position="IRA_east")
    wandering = 1.0 + 20 * np.sin(np.arange(N) / 50)
    power_cycle(tested, "U4", wandering, START_NS + 400 * SECOND_NS, "warmup_time", position="IRA_west")
    tested.step("r1", "U5", good, t0_ns=START_NS, dt_ns=DT_NS, procedure="warmup_time", position="IRA_east")
    tested.mount("r1", "U5", product="FOG-70")
    found = tested.metric("warmup_time")
    assert one(found, unit="U1", test="largest")["value"] == pytest.approx(last_outside(good, good[-N // 4 :].mean()))
    assert "no specification in the store has its startup_band" in one(found, unit="U2", test="largest")["reason"]
    assert "the product of the unit is unknown" in one(found, unit="U3", test="largest")["reason"]
    assert one(found, unit="U4", test="position IRA_east")["value"] is not None
    assert "position IRA_west: the output is outside +-5 deg/h" in one(found, unit="U4", test="largest")["reason"]
    assert one(found, unit="U5", test="position IRA_east")["counted_from"] == "step start"
    for row in found:
        assert (row["value"] is None) == (row["reason"] is not None)


def readings(tested: Any, run: str, supply: str, volts: np.ndarray, amperes: np.ndarray, t_ns: int) -> None:
    """An instrument that reads the current 20 ms after the voltage, once a second."""
    tested.samples(run, supply, "supply_voltage", volts, t0_ns=t_ns, dt_ns=SECOND_NS, unit_of_measure="V")
    later_ns = t_ns + 20_000_000
    tested.samples(run, supply, "supply_current", amperes, t0_ns=later_ns, dt_ns=SECOND_NS, unit_of_measure="A")


@pytest.mark.long
def test_power_is_the_mean_of_the_products(tested: Any) -> None:
    rng = np.random.default_rng(24)
    volts, amperes = rng.normal(5, 0.02, 60), rng.normal(0.3, 0.01, 60)
    words = {"procedure": "power_consumption", "step": "powered"}
    quiet = rng.normal(0, 1, 600)
    tested.run("r1")
    tested.step("r1", "U1", quiet, t0_ns=START_NS, **words)
    readings(tested, "r1", "PSU-1", volts, amperes, START_NS)
    readings(tested, "r1", "PSU-2", 3 * volts, amperes, START_NS)
    tested.run("r2")
    for unit in ("U2", "U3"):
        tested.step("r2", unit, quiet, t0_ns=START_NS, **words)
        tested.mount("r2", unit, details={"power": "PSU-1"} if unit == "U3" else {})
    readings(tested, "r2", "PSU-1", volts, amperes, START_NS)
    tested.run("r3")
    tested.step("r3", "U4", quiet, t0_ns=START_NS, **words)
    tested.run("r4")
    of_unit = {"rate": (quiet, "deg/h"), "supply_voltage": (volts, "V"), "supply_current": (amperes, "A")}
    tested.step("r4", "U5", of_unit, t0_ns=START_NS, **words)
    readings(tested, "r4", "PSU-1", 3 * volts, amperes, START_NS)
    found = tested.metric("power")
    expected = (volts * amperes).mean()
    first = one(found, unit="U1", supply="PSU-1")
    assert (first["value"], first["n"]) == (pytest.approx(expected, rel=1e-9), 60)
    assert first["lo"] < 1.5 < first["hi"]
    assert one(found, unit="U1", supply="PSU-2")["value"] == pytest.approx(3 * expected, rel=1e-9)
    assert "fed 2 units at once" in one(found, unit="U2")["reason"]
    assert one(found, unit="U3")["value"] == pytest.approx(expected, rel=1e-9)
    assert "no supply_voltage and supply_current" in one(found, unit="U4")["reason"]
    assert one(found, unit="U5", supply="U5")["value"] == pytest.approx(expected, rel=1e-9)


@pytest.mark.long
def test_entered_checks(tested: Any) -> None:
    about: dict[str, Any] = {"run": "", "t_ns": START_NS, "unit": "U1", "by": "Li"}
    tested.document(CheckEntered(item="visual", verdict=Verdict.FAIL, note="scratch", **about))
    tested.document(
        CheckEntered(
            item="insulation_resistance",
            verdict=Verdict.PASS,
            value=120.0,
            unit_of_measure="megaohm",
            lower=100.0,
            **about,
        )
    )
    tested.document(CheckEntered(item="dielectric_strength", verdict=Verdict.PASS, **about))
    visual = one(tested.metric("visual_check"))
    assert (visual["value"], visual["unit_of_measure"], visual["note"], visual["by"]) == (0.0, "1", "scratch", "Li")
    assert visual["at"] == "2025-11-21T00:00:00Z"
    electrical = tested.metric("electrical_check")
    row = one(electrical, item="insulation_resistance")
    assert (row["value"], row["unit_of_measure"], row["lower"], row["verdict"]) == (120.0, "megaohm", 100.0, "PASS")
    assert one(electrical, item="dielectric_strength")["value"] == 1.0
    assert len(electrical) == 2


def test_without_a_power_on_the_step_begins_the_time_also_where_it_settles(tested: Any) -> None:
    rng = np.random.default_rng(22)
    tested.product(SPECIFICATION)
    tested.run("r1", procedure="startup_time")
    tested.mount("r1", "U1", product="FOG-70")
    output = starting(rng, 100.0, BIAS + UP)
    tested.step(
        "r1", "U1", output, t0_ns=START_NS, dt_ns=DT_NS, procedure="startup_time", position="IRA_up", settle_s=2.0
    )
    row = one(tested.metric("startup_time"), test="position IRA_up")
    expected = last_outside(output, output[-N // 4 :].mean()) - AFTER_NS / SECOND_NS
    assert row["value"] == pytest.approx(expected, abs=0.5)
    assert row["counted_from"] == "step start"
