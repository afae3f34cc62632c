"""Laws of the ready procedures, and what the clauses require of them."""

import re
from importlib.resources import files

import msgspec
import pytest

from ingest.procedures.file import read_procedure, ready_names
from ingest.procedures.plan import SETTINGS, PlannedStep
from ingest.procedures.procedure import load_procedure
from stream.errors import BadInput
from stream.events import StepStarted, decode_event, encode_event
from stream.identity import check_name

READY = ready_names()
CHINESE = re.compile(r"[\u4e00-\u9fff]")
CLAUSE = re.compile(r"(GJB 2426A-2004|JJF 2014-2022|JJF 1536-2015) \d+(\.\d+)+|CN 102680005|HIT")


def recorded(name: str, **parameters: str | float) -> list[PlannedStep]:
    return [step for step in load_procedure(name).steps(parameters) if step.is_recorded]


@pytest.mark.long
@pytest.mark.parametrize("name", READY)
def test_every_ready_procedure_keeps_the_laws(name: str) -> None:
    file, _, _ = read_procedure(name)
    procedure = load_procedure(name)
    assert procedure.name == name
    check_name("procedure", name)
    assert procedure.names.en
    assert not CHINESE.search(procedure.names.en)
    assert CHINESE.search(procedure.names.zh)
    assert procedure.source
    assert all(CLAUSE.search(each) for each in procedure.source)
    for parameter in file.parameters.values():
        assert CHINESE.search(parameter.zh)
        assert CLAUSE.search(parameter.source) or "specification" in parameter.source
    steps = procedure.steps()
    assert [step.number for step in steps] == list(range(1, len(steps) + 1))
    turning = shaking = 0.0
    for step in steps:
        assert step.words.procedure == name
        check_name("step", step.words.step or "")
        document = StepStarted(run="r", t_ns=0, unit="U", words=step.words)
        assert decode_event(encode_event(document, "e", 0)).document == document
        assert msgspec.json.decode(msgspec.json.encode(step), type=PlannedStep) == step
        assert set(step.settings) <= set(SETTINGS)
        assert set(step.wait_settled) <= set(step.settings)
        if step.prompt is not None:
            assert turning == shaking == 0.0
            assert CHINESE.search(step.prompt.zh)
            assert not CHINESE.search(step.prompt.en)
            assert "{" not in step.prompt.en + step.prompt.zh
        turning = 0.0 if "angle" in step.settings else step.settings.get("rate", turning)
        shaking = step.settings.get("amplitude", shaking)
        assert (step.words.rate_command_deg_per_s or 0.0) == turning
        assert step.words.settle_s == (step.settle_s or None)
    assert turning == shaking == 0.0, "it ends with a table that moves"
    assert procedure.duration_s() > 0.0
    assert procedure.unmet([each.setting for each in procedure.requirements()]) == ()


@pytest.mark.long
@pytest.mark.parametrize("name", READY)
def test_every_parameter_is_used(name: str) -> None:
    """Another value gives another plan: no parameter is there for show."""
    procedure = load_procedure(name)
    plan = procedure.steps()
    for key, parameter in procedure.parameters.items():
        if key == "off_between_rates_s" and procedure.chosen()["power_between_rates"] == "none":
            continue
        default = parameter.default
        if isinstance(default, str):
            other: str | float = next(each for each in parameter.choices if each != default)
        elif isinstance(default, tuple):
            other = str(default[0])
        else:
            candidates = (default + 1, default - 1, default * 2, default * 0.75)
            within = (
                each
                for each in candidates
                if (parameter.least is None or each >= parameter.least)
                and (parameter.most is None or each <= parameter.most)
            )
            other = next(within)
        # these only keep points of temperature away from others
        other = {"room_deg_c": -10.0, "apart_deg_c": 30.0}.get(key, other)
        assert procedure.steps({key: other}) != plan, key


def test_the_files_are_shipped() -> None:
    assert files("ingest").joinpath("procedures", "scale_factor.toml").is_file()
    assert len(READY) >= 35


def test_every_step_of_methods_has_a_procedure() -> None:
    clauses = " ".join(each for name in READY for each in load_procedure(name).source)
    for clause in (
        *(f"GJB 2426A-2004 {each}" for each in ("5.2", "5.3", "5.4", "5.5", "5.6", "5.7", "5.8.1", "5.8.2", "5.8.3")),
        *(f"GJB 2426A-2004 {each}" for each in ("5.8.4", "5.8.5", "5.9", "5.10.3.1", "5.10.3.2", "5.10.3.3", "5.11")),
        *(f"GJB 2426A-2004 {each}" for each in ("5.12.1", "5.12.2", "5.12.3", "5.12.4", "5.12.5", "5.13", "5.14")),
        "GJB 2426A-2004 5.15",
        *(f"JJF 2014-2022 7.2.{item}.1" for item in range(1, 24)),
        *(f"JJF 1536-2015 {each}" for each in ("7.1.1", "7.2.1", "7.2.2", "7.3.1")),
    ):
        assert clause in clauses, clause


@pytest.mark.parametrize("name", ["scale_factor", "scale_factor_jjf2014"])
@pytest.mark.parametrize("most", [300.0, 0.5, 77.7])
def test_at_least_eleven_rates_each_way_with_the_largest(name: str, most: float) -> None:
    rates = [step.settings["rate"] for step in recorded(name, max_rate_deg_per_s=most) if step.words.step == "rate"]
    forwards, backwards = [each for each in rates if each > 0], [-each for each in rates if each < 0]
    assert forwards == backwards == sorted(set(forwards))
    assert len(forwards) >= 11
    assert forwards[-1] == most
    # one way, then the same rate the other way (GJB 2426A-2004 5.8.1.3 c, JJF 2014-2022 7.2.1.1 e)
    assert all(a == -b for a, b in zip(rates[::2], rates[1::2], strict=True))


def test_gjb_rests_before_and_after_and_switches_off_between_rates() -> None:
    steps = recorded("scale_factor")
    assert [steps[0].words.step, steps[-1].words.step] == ["rest_before", "rest_after"]
    assert steps[0].settings["rate"] == steps[-1].settings["rate"] == 0.0
    assert all(step.power == "cycle" and step.off_s > 0 for step in steps)
    assert all(step.wait_settled == ("rate",) for step in steps)
    assert not any("rest" in str(step.words.step) for step in recorded("scale_factor_jjf2014"))


def test_fewer_than_eleven_rates_are_refused() -> None:
    with pytest.raises(BadInput, match="rate_count: 7 is below the least, 11"):
        load_procedure("scale_factor").steps({"rate_count": "7"})


@pytest.mark.parametrize("name", ["bias_temperature_sensitivity", "scale_factor_temperature_sensitivity"])
def test_temperatures_soak_half_an_hour_and_start_with_the_room(name: str) -> None:
    steps = load_procedure(name).steps()
    first = next(step for step in steps if step.is_recorded)
    assert first.words.room
    assert first.words.temperature_command_deg_c is None  # the chamber does not work
    soaks = [step for step in steps if step.words.step == "soak"]
    assert [step.settings["temperature"] for step in soaks] == [-40.0, -25.0, -10.0, 10.0, 40.0, 60.0]
    assert all("temperature" in step.wait_settled and step.settle_s >= 1800.0 for step in soaks)
    hot = [step for step in steps if step.is_recorded and not step.words.room]
    assert all(step.words.temperature_command_deg_c is not None and step.power is None for step in hot)


def test_the_bias_is_repeated_over_power_ons() -> None:
    steps = recorded("bias_repeatability")
    assert [step.words.repeat for step in steps] == [1, 2, 3, 4, 5, 6]
    assert all(step.power == "cycle" and step.record_s >= 3600.0 for step in steps)


def test_the_bandwidth_is_swept_to_twice_itself() -> None:
    steps = recorded("bandwidth", expected_bandwidth_hz=100)
    frequencies = sorted({step.words.frequency_hz for step in steps if step.words.frequency_hz})
    assert (len(frequencies) >= 10, frequencies[0], frequencies[-1]) == (True, 10.0, 200.0)
    assert all(sum(step.words.frequency_hz == each for step in steps) >= 10 for each in frequencies)
    assert all(step.words.amplitude == 30.0 for step in steps)


def test_whole_turns_in_both_directions_and_all_positions() -> None:
    steps = recorded("gyro_separation")
    assert {step.words.position for step in steps} == {
        *("alpha0_beta0", "alpha0_beta180", "alpha180_beta180", "alpha90_beta180", "alpha0_beta90")
    }
    assert len(steps) == 5 * 3 * 2
    for step in steps:
        assert (step.settings["rate"] * step.record_s / 360.0) % 1 == pytest.approx(0.0, abs=1e-9)
    four = recorded("misalignment_four_positions")
    assert [step.words.position for step in four[::2]] == ["OY_up", "OY_up_turned_180", "OX_up", "OX_up_turned_180"]
    assert all(step.record_s == 60.0 and abs(step.settings["rate"]) == 360.0 for step in four)


def test_nine_rotations_of_half_a_turn() -> None:
    """CN 102680005: about X +, +, -, Y +, +, -, Z +, +, -; three speeds; 15 to 30 s of rest around each."""
    steps = recorded("system_level_asymmetry")
    assert [step.words.step for step in steps] == ["rest_before", "turn", "rest_after"] * 27
    turns = steps[1::3]
    assert [(step.words.axis, step.settings["rate"] > 0) for step in turns[:9]] == [
        (axis, forwards) for axis in "XYZ" for forwards in (True, True, False)
    ]
    assert [abs(step.settings["rate"]) for step in turns[::9]] == [10.0, 20.0, 30.0]
    for before, turn, after in zip(steps[::3], turns, steps[2::3], strict=True):
        half = after.settings["angle"] - before.settings["angle"]
        assert abs(half) == 180.0
        assert turn.settings["rate"] * turn.record_s == pytest.approx(half)
        assert turn.wait_settled == ()
        assert 15.0 <= before.record_s == after.record_s <= 30.0


def test_what_is_up_and_down_or_before_and_after_comes_in_pairs() -> None:
    flips = [step.words.position for step in recorded("bias_acceleration_sensitivity")]
    assert flips == ["X_up", "X_down", "Y_up", "Y_down", "Z_up", "Z_down"]
    for name in ("bias_shock", "bias_vibration", "scale_factor_shock", "scale_factor_vibration"):
        seen = list(dict.fromkeys((step.words.axis, step.words.phase) for step in recorded(name)))
        assert seen == [(axis, phase) for axis in "XYZ" for phase in ("before", "after")]


def test_power_comes_on_while_the_table_turns() -> None:
    rates = [step for step in recorded("startup_time") if "rate" in step.settings]
    assert [step.settings["rate"] for step in rates] == [300.0, 30.0, 3.0]
    assert all((step.power, step.warm_up_s, step.settle_s) == ("cycle", 0.0, 0.0) for step in rates)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"rate_pairs": "3"}, "below the least, 4"),
        ({"rate_pairs": "6"}, "above the most, 5"),
        ({"rate_record_s": "10"}, "below the least, 20 s"),
    ],
)
def test_attitude_units_are_measured_as_the_clause_says(given: dict[str, str], expected: str) -> None:
    """JJF 1536 7.1.1 c, d: 7 to 11 rates, at least 20 s at each."""
    with pytest.raises(BadInput, match=expected):
        load_procedure("attitude_unit_scale_factor").steps(given)
    for pairs, rates in ((4, 8), (5, 10)):
        steps = recorded("attitude_unit_scale_factor", rate_pairs=pairs)
        of_x = [step for step in steps if step.words.axis == "X" and step.words.step == "rate"]
        assert len({step.settings["rate"] for step in of_x}) == rates
        assert all(step.record_s >= 20.0 for step in of_x)
