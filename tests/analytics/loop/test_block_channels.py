"""Channels at the blocks of a signal: joined by time, derived from steps, checked."""

import numpy as np
import pytest

from analytics.loop.blocks.record_checks import check_clocks
from analytics.loop.model.error_model import ErrorModel
from stream.events import PowerOn
from tests.analytics.conftest import SECOND_NS, START_NS, TestedUnits, reduced


def test_channels_of_unit_and_station_are_joined_by_time(tested: TestedUnits) -> None:
    tested.run("r1")
    tested.mount("r1", "U1")
    tested.mount("r1", "U2")
    t_s = np.arange(0.0, 1800.0, 0.1)
    for unit in ("U1", "U2"):
        tested.samples("r1", unit, "rate", np.sin(t_s), t0_ns=START_NS)
        tested.samples("r1", unit, "temperature", 25.0 + t_s / 100.0, t0_ns=START_NS, unit_of_measure="degC")
    every_5_s, every_60_s = np.arange(0.0, 1801.0, 5.0), np.arange(0.0, 1801.0, 60.0)
    chamber_k, supply_mv = 293.15 + 0.01 * every_5_s, 5000.0 + every_60_s
    tested.samples(
        "r1", "chamber", "chamber_temperature", chamber_k, t0_ns=START_NS, dt_ns=5 * SECOND_NS, unit_of_measure="kelvin"
    )
    tested.samples(
        "r1", "supply", "supply_voltage", supply_mv, t0_ns=START_NS, dt_ns=60 * SECOND_NS, unit_of_measure="mV"
    )
    reduction = reduced(tested)
    (run,) = reduction.runs
    centre_s = run.time_s - 0.05  # of samples at 0.0 to 29.9 s
    channels = run.channels
    assert {name: each.unit_of_measure for name, each in channels.items()} == {
        "temperature": "degC",
        "chamber_temperature": "degC",
        "supply_voltage": "V",
        "time_since_power_on": "s",
        "day": "day",
    }
    np.testing.assert_allclose(run.mean("temperature"), 25.0 + centre_s / 100.0, rtol=1e-12)
    np.testing.assert_allclose(channels["temperature"].spread, np.std(t_s[:300]) / 100.0, rtol=1e-9)
    np.testing.assert_allclose(run.mean("chamber_temperature"), 20.0 + 0.01 * centre_s, rtol=1e-9)
    np.testing.assert_allclose(run.mean("supply_voltage"), 5.0 + (run.time_s - 15.0 + 15.0) / 1000.0, atol=1e-3)
    np.testing.assert_allclose(run.mean("day"), run.time_s / 86_400.0)
    np.testing.assert_allclose(run.mean("time_since_power_on"), run.time_s)
    assert reduction.limits == ("no power-on is recorded in run r1: time_since_power_on counts from the first sample",)


@pytest.mark.long
def test_a_channel_that_stops_is_nan_beyond_the_tolerance(tested: TestedUnits) -> None:
    tested.run("r1")
    tested.samples("r1", "U1", "rate", np.zeros(18_000) + np.arange(18_000) % 2, t0_ns=START_NS)
    readings = np.arange(6.0)  # every 100 s until 500 s of 1800 s
    tested.samples("r1", "U1", "temperature", readings, t0_ns=START_NS, dt_ns=100 * SECOND_NS, unit_of_measure="degC")
    (run,) = (reduction := reduced(tested)).runs
    known = np.isfinite(run.mean("temperature"))
    assert known.tolist() == (run.time_s < 605.0).tolist()  # 1.05 of its interval
    (note,) = [note for note in reduction.notes if note.what == "channel_gap"]
    assert note.text == "channel temperature has no reading near 40 of 60 blocks, in run r1"
    (strict,) = reduced(tested, tolerance_s=20.0).runs
    near = np.abs(strict.time_s[:, None] - 0.05 - 100.0 * readings).min(axis=1) <= 20.0
    assert np.isfinite(strict.mean("temperature")).tolist() == near.tolist()


@pytest.mark.long
def test_bad_channels_are_told(tested: TestedUnits) -> None:
    rng = np.random.default_rng(4)
    for run in ("r1", "r2"):
        tested.run(run)
        tested.power_on(run, "U1", START_NS)
        warm = 30.0 + np.cumsum(rng.normal(0.0, 0.01, 6000))
        signals = {
            "temperature": (warm, "degC"),
            "case_temperature": (2.0 * warm + 3.0, "degC"),
            "supply_voltage": (np.full(6000, 5.0), "V"),
            "fan": (rng.normal(0.0, 1.0, 6000), "count"),
            "rate_y": (rng.normal(0.0, 1.0, 6000), "deg/h"),
        }
        if run == "r2":
            del signals["fan"]
        tested.step(run, "U1", {"rate": (rng.normal(0.0, 1.0, 6000), "deg/h"), **signals}, t0_ns=START_NS)
    reduction = reduced(tested)
    reported = {note.what: note for note in reduction.notes}
    assert set(reported) == {"constant", "copy", "missing_channel", "counts", "output"}
    assert reported["copy"].text.startswith("channels case_temperature and temperature are copies of each other")
    assert reported["constant"].channel == "supply_voltage"
    assert reported["missing_channel"].text.startswith("channel fan is missing in 1 of 2 runs (r2)")
    assert reported["counts"].text == "channel fan is in count: coefficients are per count"
    assert all("rate_y" not in run.channels for run in reduction.runs)


def rate_test(tested: TestedUnits, *, table_s: float, position: str | None = None, signal: str = "rate") -> None:
    """Six rates of 40 s each, with the table's readings every `table_s`; gyro of 3600.36 deg/h for 1 deg/s."""
    rng = np.random.default_rng(6)
    tested.run("r1")
    tested.power_on("r1", "U1", START_NS)
    t_ns = START_NS
    for rate in (0.0, 10.0, -10.0, 100.0, -100.0, 0.0):
        gyro = 3600.36 * rate + rng.normal(0.0, 1.0, 400)
        t_ns = tested.step(
            "r1", "U1", {signal: (gyro, "deg/h")}, t0_ns=t_ns, rate_command_deg_per_s=rate, position=position
        )
        readings = np.full(round(40.0 / table_s), rate)
        tested.samples(
            "r1", "table", "table_rate", readings, t0_ns=t_ns - 40 * SECOND_NS, dt_ns=round(table_s * SECOND_NS),
            unit_of_measure="deg/s",
        )  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("table_s", [1.0, 5.0, 20.0])
def test_blocks_across_an_edge_that_the_table_does_not_show_are_left_out(tested: TestedUnits, table_s: float) -> None:
    rate_test(tested, table_s=table_s)
    reduction = reduced(tested, block_s=15.0)
    (run,) = reduction.runs
    inside = [slot for slot in range(16) if slot * 15 // 40 == (slot * 15 + 15 - 1) // 40]
    if table_s < 15.0:  # else a block may have no reading of its own step
        assert set(inside) <= set(run.slot.tolist())
    assert set(run.slot.tolist()) <= set(inside)
    model = ErrorModel.parse("bias + scale_factor*input_rate").fitted([0.0, 3600.36])
    # sd 1/sqrt(150) of a block's mean; a mean off by 0.001 deg/s would be 3.6
    assert np.abs(model.residual(run)).max() < 5.0 / np.sqrt(150.0)
    reported = [note.what for note in reduction.notes if note.is_limit]
    assert reported == ["input_rate"]
    assert "taken from table_rate in run r1" in reduction.limits[0]


@pytest.mark.long
@pytest.mark.parametrize(
    ("position", "signal", "turned"),
    [("IRA_up", "rate", 1.0), ("IRA_down", "rate", -1.0), ("IRA_east_west", "rate", 0.0), ("X_down", "rate_x", -1.0)],
)
def test_a_known_position_says_how_the_input_axis_lies(
    tested: TestedUnits, position: str, signal: str, turned: float
) -> None:
    rate_test(tested, table_s=1.0, position=position, signal=signal)
    (run,) = reduced(tested, block_s=20.0, signal=signal).runs
    np.testing.assert_allclose(run.mean("gravity_i"), turned)
    np.testing.assert_allclose(run.mean("input_rate"), turned * run.mean("table_rate"))
    assert set(run.mean("position")) == {1.0}


def test_several_positions_that_say_nothing_give_no_input_rate(tested: TestedUnits) -> None:
    tested.run("r1")
    t_ns = START_NS
    for position in ("left", "right"):
        signals = {"rate": (np.arange(600.0) % 7, "deg/h"), "table_rate": (np.full(600, 5.0), "deg/s")}
        t_ns = tested.step("r1", "U1", signals, t0_ns=t_ns, position=position, rate_command_deg_per_s=5.0)
    reduction = reduced(tested, block_s=20.0)
    (run,) = reduction.runs
    assert "input_rate" not in run.channels
    assert run.mean("position").tolist() == [1.0, 1.0, 1.0, 2.0, 2.0, 2.0]
    assert "the positions left, right do not define the direction of the input axis" in " ".join(reduction.limits)
    assert "position stands for: 1 left, 2 right" in " ".join(note.text for note in reduction.notes)


def test_a_rate_command_serves_where_no_table_was_recorded(tested: TestedUnits) -> None:
    tested.run("r1")
    t_ns = START_NS
    for rate in (10.0, -10.0):
        t_ns = tested.step("r1", "U1", np.arange(600.0) % 7, t0_ns=t_ns, rate_command_deg_per_s=rate)
    reduction = reduced(tested, block_s=20.0)
    assert reduction.runs[0].mean("input_rate").tolist() == [10.0, 10.0, 10.0, -10.0, -10.0, -10.0]
    assert "taken from the steps' rate commands in run r1" in reduction.limits[0]


def test_an_angle_is_unwrapped_and_keeps_its_phasors(tested: TestedUnits) -> None:
    tested.run("r1")
    t_s = np.arange(0.0, 600.0, 0.1)
    degrees = 300.0 + 0.5 * t_s
    tested.samples("r1", "U1", "rate", np.sin(t_s), t0_ns=START_NS)
    tested.samples("r1", "table", "table_angle", degrees % 360.0, t0_ns=START_NS, unit_of_measure="deg")
    (run,) = reduced(tested).runs
    angle = run.channels["table_angle"]
    np.testing.assert_allclose(angle.mean, degrees.reshape(-1, 300).mean(axis=1), rtol=1e-9)
    assert angle.phasors is not None
    for k in range(1, 5):
        expected = np.exp(1j * k * np.radians(degrees)).reshape(-1, 300).mean(axis=1)
        np.testing.assert_allclose(angle.phasors[k - 1], expected, atol=1e-12)


def test_an_angle_that_turns_too_fast_for_its_readings_says_nothing(tested: TestedUnits) -> None:
    tested.run("r1")
    t_s = np.arange(0.0, 600.0, 0.1)
    tested.samples("r1", "U1", "rate", np.sin(t_s), t0_ns=START_NS)
    every_5_s = np.arange(0.0, 600.0, 5.0)
    for signal, values, unit in (
        ("table_angle", 20.0 * every_5_s % 360.0, "deg"),
        ("table_rate", np.full(len(every_5_s), 20.0), "deg/s"),
    ):
        tested.samples("r1", "table", signal, values, t0_ns=START_NS, dt_ns=5 * SECOND_NS, unit_of_measure=unit)
    (run,) = reduced(tested).runs
    phasors = run.channels["table_angle"].phasors
    assert phasors is not None
    assert np.abs(phasors[0]).max() > 0.0  # 100 deg between readings are followed, 200 are not
    assert not phasors[1:].any()


def test_power_ons_give_time_since_and_runs_of_their_own(tested: TestedUnits) -> None:
    for run, t0_ns in (("r1", START_NS), ("r2", START_NS + 86_400 * SECOND_NS)):
        tested.run(run, t_ns=t0_ns)
        tested.power_on(run, "U1", t0_ns - 60 * SECOND_NS)
        tested.samples(run, "U1", "rate", np.arange(6000.0) % 5, t0_ns=t0_ns)
    tested.document(PowerOn(run="r2", t_ns=START_NS + 86_700 * SECOND_NS, unit="U1", epoch="again"))
    reduction = reduced(tested)
    assert [run.run for run in reduction.runs] == ["r1", "r2#1", "r2#2"]
    first, second, third = (run.mean("time_since_power_on") for run in reduction.runs)
    np.testing.assert_allclose(first, 75.0 + 30.0 * np.arange(20))
    np.testing.assert_allclose(second, 75.0 + 30.0 * np.arange(10))
    np.testing.assert_allclose(third, 15.0 + 30.0 * np.arange(10))
    assert reduction.runs[2].slot[0] == 10
    assert reduction.runs[1].mean("day")[0] == pytest.approx(1.0, abs=1e-3)
    assert "powered on several times in 1 of 2 runs (r2)" in " ".join(note.text for note in reduction.notes)


@pytest.mark.long
def test_of_two_instruments_the_one_that_moves_has_the_name(tested: TestedUnits) -> None:
    tested.run("r1")
    t_s = np.arange(0.0, 600.0, 0.1)
    tested.samples("r1", "U1", "rate", np.sin(t_s), t0_ns=START_NS)
    for unit, rates in (
        ("angular", np.zeros(600)),
        ("table", np.where(np.arange(600) < 300, 0.0, 5.0)),
        ("other", np.linspace(0.0, 0.1, 600)),
    ):
        tested.samples("r1", unit, "table_rate", rates, t0_ns=START_NS, dt_ns=SECOND_NS, unit_of_measure="deg/s")
    reduction = reduced(tested, block_s=20.0)
    (run,) = reduction.runs
    assert run.mean("table_rate").tolist() == [0.0] * 14 + [5.0] * 14  # beside the edge it may have been either
    assert run.mean("other.table_rate")[-1] == pytest.approx(0.1, rel=0.05)
    assert "angular.table_rate" not in run.channels
    reported = "channel table_rate is taken from table; angular, other have a channel of that name as well"
    assert reported in [note.text for note in reduction.notes]


def test_a_clock_that_is_off_is_told() -> None:
    offsets = {
        ("r1", "U1"): {"rate": 0.02, "temperature": 9.0},
        ("r1", "chamber"): {"chamber_temperature": 3.5},
        ("r2", "U1"): {"rate": 0.03},
        ("r2", "chamber"): {"chamber_temperature": 0.9},
        ("r2", "table"): {"table_rate": 0.0, "table_angle": 0.1},
    }
    beside = [("r1", "chamber"), ("r2", "chamber"), ("r2", "table"), ("r3", "table")]
    (note,) = check_clocks(offsets, "U1", "rate", beside)
    assert note.text.startswith("the clock of chamber is -3.5 s off that of U1 in run r1")
    assert note.is_limit


@pytest.mark.long
def test_a_time_since_power_on_that_is_recorded_is_taken(tested: TestedUnits) -> None:
    tested.run("r1")
    tested.samples("r1", "U1", "rate", np.arange(6000.0) % 2, t0_ns=START_NS)
    since_s = 600.0 + np.arange(6000.0) / 10.0
    tested.samples("r1", "U1", "time_since_power_on", since_s, t0_ns=START_NS, unit_of_measure="s")
    reduction = reduced(tested)
    (run,) = reduction.runs
    np.testing.assert_allclose(run.mean("time_since_power_on"), 600.0 + run.time_s, atol=0.1)
    assert not any("power" in limit for limit in reduction.limits)
