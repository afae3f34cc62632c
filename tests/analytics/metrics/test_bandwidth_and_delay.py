"""Bandwidth and output delay from steps to rows: the clauses' formulas on raw arrays, and tests that lack something."""

import math
import re
from typing import Any

import numpy as np
import pytest
from scipy import optimize

from analytics.methods.dynamics import time_constant
from stream.batch import FloatArray
from stream.errors import BadInput
from tests.analytics.conftest import START_NS
from tests.analytics.metrics.angular_vibration import (
    BANDWIDTH_HZ,
    DELAY_S,
    DT_NS,
    FREQUENCIES,
    RATE_HZ,
    SCALE,
    Bench,
    fill,
    lag,
)


def by_hand(bench: Bench) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Frequencies, gains and phases from the raw arrays: each sine by its own normal equations."""

    def sine(frequency: float, values: FloatArray) -> complex:
        t_s = np.arange(len(values)) / RATE_HZ
        columns = np.column_stack(
            [np.cos(2 * np.pi * frequency * t_s), np.sin(2 * np.pi * frequency * t_s), np.ones(len(values))]
        )
        a, b, _ = np.linalg.solve(columns.T @ columns, columns.T @ values)
        return complex(b, a)

    ratios: dict[float, list[complex]] = {}
    for frequency, rate, output in bench.records:
        ratios.setdefault(frequency, []).append(sine(frequency, output) / sine(frequency, rate))
    gains = np.array([np.mean(np.abs(each)) for each in ratios.values()])
    # within a turn of each other here, and of 0 at the first
    phases = np.unwrap([np.mean(np.unwrap(np.angle(each))) for each in ratios.values()])
    return np.array(list(ratios)), gains, phases


def values(rows: list[dict[str, Any]], standard: str = "GJB2426A", **words: Any) -> dict[str, Any]:
    (row,) = [
        row for row in rows if row["standard"] == standard and all(row[name] == value for name, value in words.items())
    ]
    return row


@pytest.mark.long
@pytest.mark.parametrize("signals", [("rate", "table_rate"), ("rate", "table_angle")])
def test_an_exact_lag_with_delay_comes_back(tested: Any, signals: tuple[str, ...]) -> None:
    fill(tested, Bench(), signals=signals)
    bandwidths = tested.metric("bandwidth")
    assert len(bandwidths) == 3
    for row in bandwidths:
        if row["gain_1"] != "lowest frequency":
            assert row["value"] == pytest.approx(BANDWIDTH_HZ, rel=1e-9)
        assert row["reference"] == signals[1]
    # of the gain at 10 Hz: 1 + (f/B)^2 = 2 (1 + (10/B)^2)
    of_lowest = BANDWIDTH_HZ * math.sqrt(1 + 2 * (10 / BANDWIDTH_HZ) ** 2)
    assert values(bandwidths, gain_1="lowest frequency")["value"] == pytest.approx(of_lowest, rel=1e-9)
    for row in tested.metric("output_delay"):
        assert row["value"] == pytest.approx(DELAY_S * 1e3, rel=1e-9)
        assert row["n"] == 100
        assert len(row["steps"]) == 100


@pytest.mark.long
def test_metrics_are_the_clauses_formulas_on_the_raw_arrays(tested: Any) -> None:
    bench = Bench(seed=5, noise=2.0)
    fill(tested, bench)
    f, gains, phases = by_hand(bench)
    omega = 2 * np.pi * f
    (_, square), *_ = np.linalg.lstsq(np.column_stack([np.ones(10), -(omega**2) * gains**2]), gains**2)
    time_constant = math.sqrt(square)
    rows = tested.metric("bandwidth")
    first = values(rows, method="first_order")
    assert first["value"] == pytest.approx(1 / (2 * np.pi * time_constant), rel=1e-9)
    # 1/G^2 = c0 + c1 w^2 + c2 w^4, all points of one relative weight
    terms = np.polynomial.polynomial.polyfit((f / 100) ** 2, 1 / gains**2, 2, w=gains**2)
    for row, one in ((values(rows, gain_1="lowest frequency"), gains[0]), (values(rows, "JJF2014"), terms[0] ** -0.5)):
        root = optimize.brentq(lambda x, one=one: np.polynomial.polynomial.polyval(x, terms) - 2 / one**2, 0.01, 1.0)
        assert row["value"] == pytest.approx(100 * math.sqrt(root), rel=1e-9)
        assert row["lo"] < row["value"] < row["hi"]
    delay = omega @ (-phases - np.arctan(omega * time_constant)) / (omega @ omega)
    for standard in ("GJB2426A", "JJF2014"):
        assert values(tested.metric("output_delay"), standard)["value"] == pytest.approx(1e3 * delay, rel=1e-9)


@pytest.mark.long
def test_the_scale_factor_is_the_gain_at_zero_frequency(tested: Any) -> None:
    # rates of +-(1..110) deg/s, without noise: K = 3.03 V/(deg/s), 1 % above what the vibration gives
    rates = [sign * 10.0 * i for sign in (1, -1) for i in range(1, 12)]
    tested.run("r0", procedure="scale_factor")
    t_ns = START_NS - 10**13
    for rate in [0.0, *rates, 0.0]:
        t_ns = tested.step(
            "r0", "U1", np.full(100, 1.01 * SCALE * rate), t0_ns=t_ns, dt_ns=10**7, unit_of_measure="V",
            procedure="scale_factor", rate_command_deg_per_s=rate,
        )  # fmt: skip
    fill(tested, Bench())
    row = values(tested.metric("bandwidth"), "JJF2014")
    assert row["gain_1"] == "scale factor measured in run r0"
    f = np.array([0.0, *FREQUENCIES])
    gains = np.array([1.01 * SCALE, *(SCALE * abs(lag(each)) for each in FREQUENCIES)])
    terms = np.polynomial.polynomial.polyfit((f / 100) ** 2, 1 / gains**2, 2, w=gains**2)
    root = optimize.brentq(lambda x: np.polynomial.polynomial.polyval(x, terms) - 2 / gains[0] ** 2, 0.01, 1.0)
    assert row["value"] == pytest.approx(100 * math.sqrt(root), rel=1e-6)


@pytest.mark.long
def test_without_a_reference_the_amplitude_is_the_commanded_one(tested: Any) -> None:
    fill(tested, Bench(), signals=("rate",))
    row = values(tested.metric("bandwidth"), method="first_order")
    assert row["reference"] == "commanded amplitude"
    assert row["value"] == pytest.approx(BANDWIDTH_HZ, rel=1e-6)
    for row in tested.metric("output_delay"):
        assert row["value"] is None
        assert "record the table's angle or rate" in row["reason"]


@pytest.mark.long
def test_an_instrument_of_the_run_is_the_reference_of_all_units(tested: Any) -> None:
    """The table's trace is a signal of an instrument that has no steps; a slow one beside it is passed over."""
    bench = Bench(noise=0.01)
    fill(tested, bench, signals=("rate",))
    rate = np.concatenate([each for _, each, _ in bench.records])
    tested.samples("r1", "vibration", "table_rate", rate, t0_ns=START_NS, dt_ns=DT_NS, unit_of_measure="deg/s")
    tested.samples("r1", "table", "table_rate", np.zeros(20), t0_ns=START_NS, dt_ns=10**9, unit_of_measure="deg/s")
    for row in tested.metric("output_delay"):
        assert row["reference"] == "table_rate of vibration"
        assert row["lo"] < DELAY_S * 1e3 < row["hi"]


@pytest.mark.long
def test_a_signal_across_the_vibration_is_left_out(tested: Any) -> None:
    bench = Bench()
    tested.run("r1", procedure="bandwidth")
    t_ns = START_NS
    for frequency in FREQUENCIES:
        found = bench.record(frequency)
        output = found["rate"][0]
        signals = {"rate_z": (output, "V"), "rate_x": (0.01 * output, "V"), "table_rate": found["table_rate"]}
        t_ns = tested.step("r1", "U1", signals, t0_ns=t_ns, dt_ns=DT_NS, procedure="bandwidth", frequency_hz=frequency)
    assert {row["signal"] for row in tested.metric("bandwidth")} == {"rate_z"}


LACKS: list[tuple[dict[str, Any], str, str]] = [
    ({"frequencies": FREQUENCIES[:9]}, "GJB2426A", "9 frequencies could be evaluated, the clauses ask for at least 10"),
    ({"frequencies": [12.0, *FREQUENCIES[1:]]}, "GJB2426A", "the lowest frequency is 12 Hz, the clauses ask for 10 Hz"),
    (
        {"frequencies": [*np.geomspace(10, 20, 9).round(3).tolist(), 90.0]},
        "GJB2426A",
        "a frequency is 4.5 times the one before, the clauses ask for equal ratios, of 1.28 here",
    ),
    ({"records": 9}, "JJF2014", "9 records at 10 Hz, the clause asks for at least 10"),
    (
        {"frequencies": np.geomspace(10, 70, 10).round(3).tolist()},
        "GJB2426A",
        "the highest frequency is 70 Hz, the clauses ask for twice the bandwidth, which comes out as 50 Hz",
    ),
    (
        {"frequencies": np.geomspace(5, 9, 10).round(3).tolist()},
        "JJF2014",
        "the gain is 0.9842 of that at the lowest or at zero: it is to come down to 0.707",
    ),
]


@pytest.mark.parametrize(
    ("damping", "reason"),
    [
        (
            0.3,
            "at 100 Hz the gain is 0.4792 of that at 10 Hz, but no first-order lag has these gains: they may resonate",
        ),
        (1e-9, "at 50 Hz the gain is 3.182 of that at 10 Hz: it does not fall, vibrate up to twice the bandwidth"),
    ],
)
def test_gains_of_a_resonance_are_no_gains_that_do_not_fall(damping: float, reason: str) -> None:
    frequencies = np.geomspace(10.0, 100.0 if damping > 0.1 else 50.0, 12)
    share = frequencies / 60.0
    gains = 1 / np.hypot(1 - share**2, 2 * damping * share)
    with pytest.raises(BadInput, match=re.escape(reason)):
        time_constant(frequencies, gains)


@pytest.mark.long
@pytest.mark.parametrize(("change", "standard", "reason"), LACKS)
def test_what_a_test_lacks_is_said(tested: Any, change: dict[str, Any], standard: str, reason: str) -> None:
    fill(tested, Bench(), **change)
    rows = tested.metric("bandwidth")
    row = next(row for row in rows if row["standard"] == standard)
    assert (row["value"], row["lo"]) == (None, None)
    assert reason in row["reason"]
    # nine records are enough for the other standard
    assert (values(rows, method="first_order")["value"] is not None) == ("records" in change)


@pytest.mark.long
def test_too_slow_a_sampling_is_said(tested: Any) -> None:
    bench = Bench()
    tested.run("r1", procedure="bandwidth")
    t_ns = START_NS
    for frequency in FREQUENCIES:
        found = bench.record(frequency)
        thinned = {name: (found[name][0][::5], found[name][1]) for name in ("rate", "table_rate")}
        t_ns = tested.step("r1", "U1", thinned, t0_ns=t_ns, dt_ns=5 * DT_NS, procedure="bandwidth",
                           frequency_hz=frequency)  # fmt: skip
    row = values(tested.metric("bandwidth"), method="first_order")
    assert row["reason"] == (
        "sampled at 400 Hz, the clauses ask for above 20 times the bandwidth, which comes out as 50 Hz"
    )


def test_steps_whose_samples_are_gone_are_said(recorded: Any) -> None:
    steps = [{"procedure": "bandwidth", "frequency": f, "amplitude": 20.0, "duration_s": 1.0} for f in FREQUENCIES]
    for row in recorded(steps, "bandwidth"):
        assert row["value"] is None
        assert "no raw sample of the steps is in the store" in row["reason"]
