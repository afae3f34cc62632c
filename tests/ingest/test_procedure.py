"""Laws of the ready procedures, what the clauses ask of them, and what is refused in a file."""

import re
from importlib.resources import files
from pathlib import Path

import msgspec
import pytest

from ingest.procedures.file import read_procedure
from ingest.procedures.procedure import SETTINGS, PlannedStep, StationRates, load_procedure, ready_names
from stream.errors import BadInput
from stream.events import StepStarted, decode_event, encode_event
from stream.identity import check_name

READY = ready_names()
CHINESE = re.compile(r"[\u4e00-\u9fff]")
CLAUSE = re.compile(r"(GJB 2426A-2004|JJF 2014-2022|JJF 1536-2015) \d+(\.\d+)+|CN 102680005|HIT")


def recorded(name: str, **parameters: str | float) -> list[PlannedStep]:
    return [step for step in load_procedure(name).steps(parameters) if step.is_recorded]


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


HEAD = 'name = "own"\nnames = {en = "Own", zh = "自定义"}\n'


def own(folder: Path, text: str) -> Path:
    path = folder / "own.toml"
    path.write_text(HEAD + text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[[step]]\nname='a'\nrecrod_s=1", r"unknown field `recrod_s` - at `\$\.step\[0\]`, did you mean record_s\?"),
        ("sorce=['a']\n[[step]]\nname='a'", r"unknown field `sorce`, did you mean source\?"),
        ("[[step]]\nname='a'\nprompt={eng='A'}", r"`eng` - at `\$\.step\[0\]\.prompt`, did you mean en\?"),
        ("[[step]]\nname='a'\nzzzz=1", r"unknown field `zzzz` - at `\$\.step\[0\]`$"),
        (
            "[[step]]\nfor='r'\nseries={kind='R5',most=1}\n[[step.step]]\nname='a'\nseries={kind='R5',cuont=1}",
            r"unknown field `(most|cuont)` - at `\$\.step\[0\].*series`",
        ),
        ("[parameters.a]\ndefualt=5\n[[step]]\nname='a'", r"`defualt` - at `\$\.parameters.*`, did you mean default\?"),
        ("[[step]]\nname='a'\nrecord_s=-1", r"\$\.step\[0\]\.record_s: -1 s; expected are 0 to"),
        ("[[step]]\nname='a'\nsettle_s=true", r"Expected .* got `bool` - at `\$\.step\[0\]\.settle_s`"),
        ("[[step]]\nname='a'\nrecord_s='$x'", r"\$\.step\[0\]\.record_s: \$x is neither"),
        ("[[step]]\nrecord_s=1", r"\$\.step\[0\]: a step without a name"),
        ("[[step]]\nname='a'\npower='cycle'", r"\$\.step\[0\]: power is cycled without off_s"),
        ("[[step]]\nname='a'\npower='blink'", r"\$\.step\[0\]\.power: 'blink' is none of off, on, cycle, none"),
        ("[[step]]\nname='a'\noff_s=5", r"\$\.step\[0\]\.off_s: the units are not switched off here"),
        ("[[step]]\nname='a'\npower='off'\nrecord_s=5", r"\$\.step\[0\]: records 5 s while the units have no power"),
        ("[[step]]\nname='a'\nwait_settled=['speed']", r"wait_settled: 'speed' is no setting; there is rate"),
        ("[[step]]\nname='a'\nwait_settled=['temprature']", r"is no setting, did you mean temperature\?; there is"),
        ("[[step]]\nname='a'\nwait_settled=['rate']", r"wait_settled: rate has not been set"),
        ("[[step]]\nname='a'\namplitude_deg_per_s=1", r"an amplitude without a frequency_hz"),
        ("[[step]]\nname='a'\nfrequency_hz=0", r"frequency_hz: 0 Hz is not positive"),
        ("[[step]]\nname='a'\nrate_deg_per_s=1\nangle_deg=1", r"\$\.step\[0\]: a table turns or stands"),
        ("[[step]]\nfor='r'\nvalues=[1]", r"\$\.step\[0\]: a loop without steps"),
        ("[[step]]\nfor='r'\n[[step.step]]\nname='a'", r"\$\.step\[0\]: a loop needs `for`"),
        ("[[step]]\nvalues=[1]\n[[step.step]]\nname='a'", r"\$\.step\[0\]: a loop needs `for`"),
        ("[[step]]\nfor='r'\ntimes=2\nvalues=[1]\n[[step.step]]\nname='a'", r"`for` or `times`, not both"),
        ("[[step]]\nfor='r'\nvalues=[]\n[[step.step]]\nname='a'", r"\$\.step\[0\]\.values: an empty list"),
        (
            "[[step]]\nfor='r'\nvalues=[{x=1}]\n[[step.step]]\nname='a'",
            r"\$\.step\[0\]\.values\[0\]: 'r', .* is missing",
        ),
        ("[[step]]\ntimes=1.5\n[[step.step]]\nname='a'", r"\$\.step\[0\]\.times: 1.5 is no whole number"),
        ("[[step]]\ntimes=2\npower='on'\n[[step.step]]\nname='a'", r"\$\.step\[0\]\.power: belongs to a step"),
        (
            "[[step]]\nfor='r'\nvalues=[1]\n[[step.step]]\nname='a'\nrecord_s='$q'",
            r"\$\.step\[0\]\.step\[0\]\.record_s",
        ),
        ("[[step]]\nfor='r'\nseries={kind='R7',max=1}\n[[step.step]]\nname='a'", r"\$\.step\[0\]\.series\.kind"),
        ("[[step]]\nfor='r'\nseries={kind='R5',max=1}\n[[step.step]]\nname='a'", r"\$\.step\[0\]\.series: give count"),
        ("[[step]]\nuse='nothing'", r"no procedure 'nothing'"),
        (
            "[[step]]\nuse='static_bias'\nset={bias=1}",
            r"\$\.step\[0\]\.use: .* has no parameter 'bias'; it has bias_record_s",
        ),
        ("[[step]]\nuse='./own.toml'", r"a procedure cannot use itself"),
        ("[[step]]\nname='a'\nset={bias=1}", r"only what is used"),
        (
            "[parameters.a]\ndefault=5\nleast=7\nen='a'\nzh='甲'\nsource='s'\n[[step]]\nname='a'",
            r"\$\.parameters\.a\.default: 5 is below",
        ),
        ("[parameters.a]\ndefault=5\nen='a'\nzh='甲'\n[[step]]\nname='a'", r"missing required field `source`"),
        ("step=[]", r"step"),
        ("[[step]\n", r"own\.toml: "),
    ],
)
def test_a_mistake_is_told_with_file_and_key(tmp_path: Path, text: str, told: str) -> None:
    path = own(tmp_path, text)
    with pytest.raises(BadInput, match=told) as caught:
        load_procedure(path)
    assert "own.toml" in str(caught.value) or "nothing" in str(caught.value)


def test_nobody_is_sent_to_a_table_that_moves(tmp_path: Path) -> None:
    turn = "[[step]]\nname='turn'\nrate_deg_per_s=10\nrecord_s=1\n"
    ask = "[[step]]\nname='ask'\nprompt={en='Turn it over.', zh='翻转。'}\n"
    with pytest.raises(
        BadInput, match=r"\$\.step\[1\]\.prompt: an operator is called while the table turns at 10 deg/s"
    ):
        load_procedure(own(tmp_path, turn + ask))
    load_procedure(own(tmp_path, turn + "[[step]]\nname='stop'\nrate_deg_per_s=0\n" + ask))
    load_procedure(own(tmp_path, turn + "[[step]]\nname='stand'\nangle_deg=0\n" + ask))
    shake = "[[step]]\nname='shake'\nfrequency_hz=10\namplitude_deg_per_s=1\n"
    with pytest.raises(BadInput, match="while the table vibrates"):
        load_procedure(own(tmp_path, shake + ask))


def test_loops_hand_down_and_steps_say_otherwise(tmp_path: Path) -> None:
    text = """
    [[step]]
    for = "temperature"
    values = [-10, 50]
    temperature_deg_c = "$temperature"
    settle_s = 7
    [[step.step]]
    times = 2
    [[step.step.step]]
    name = "a{repeat}"
    record_s = 1
    [[step.step.step]]
    name = "b"
    settle_s = 0
    record_s = "2 * $repeat"
    """
    steps = load_procedure(own(tmp_path, text)).steps()
    assert [
        (s.words.step, s.words.temperature_command_deg_c, s.words.repeat, s.settle_s, s.record_s) for s in steps
    ] == [
        (name, temperature, repeat, settle, record)
        for temperature in (-10.0, 50.0)
        for repeat in (1, 2)
        for name, settle, record in ((f"a{repeat}", 7.0, 1.0), ("b", 0.0, 2.0 * repeat))
    ]
    # only the first of each temperature waits for the chamber
    assert [s.wait_settled for s in steps] == [("temperature",), (), (), ()] * 2


def test_a_procedure_uses_another_with_parameters_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "inner.toml").write_text(
        'name="inner"\nnames={en="I",zh="内"}\n[parameters.long_s]\ndefault=5.0\nunit="s"\nen="l"\nzh="长"\nsource="s"\n'
        '[[step]]\nname="in"\nrecord_s="$long_s"\n',
        encoding="utf-8",
    )
    path = own(
        tmp_path, "[[step]]\nuse='inner.toml'\nphase='before'\n[[step]]\nuse='inner.toml'\nset={long_s='2 * $long_s'}"
    )
    procedure = load_procedure(path)
    assert set(procedure.parameters) == {"long_s"}
    steps = procedure.steps({"long_s": "3"})
    assert [(s.words.procedure, s.words.step, s.words.phase, s.record_s) for s in steps] == [
        ("own", "in", "before", 3.0),
        ("own", "in", None, 6.0),
    ]


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"nothing": "1"}, "has no parameter 'nothing'; it has"),
        ({"max_rate": "1"}, r"has no parameter 'max_rate', did you mean max_rate_deg_per_s\?; it has"),
        ({"power_between_rates": "cycles"}, r"'cycles' is none of cycle, none, did you mean cycle\?"),
        ({"max_rate_deg_per_s": "fast"}, "'fast' is no number in deg/s"),
        ({"max_rate_deg_per_s": "-3"}, "below the least"),
        ({"max_rate_deg_per_s": "nan"}, "no finite number"),
        ({"rate_count": "11.5"}, "no whole number"),
        ({"power_between_rates": "often"}, "none of cycle, none"),
    ],
)
def test_a_parameter_is_checked(given: dict[str, str], told: str) -> None:
    with pytest.raises(BadInput, match=told):
        load_procedure("scale_factor").steps(given)


def test_a_list_of_numbers_is_a_parameter_too() -> None:
    steps = recorded("system_level_asymmetry", speeds_deg_per_s="12, 15")
    assert {abs(step.settings["rate"]) for step in steps if "rate" in step.settings} == {12.0, 15.0}
    with pytest.raises(BadInput, match="above the most"):
        recorded("system_level_asymmetry", speeds_deg_per_s="12,45")


def test_the_duration_is_the_sum_of_what_is_waited_for(tmp_path: Path) -> None:
    text = """
    [[step]]
    name = "ask"
    prompt = {en = "Mount it.", zh = "安装。"}
    warm_up_s = 60
    [[step]]
    name = "turn"
    rate_deg_per_s = 100
    settle_s = 5
    record_s = 10
    [[step]]
    name = "hot"
    rate_deg_per_s = -100
    temperature_deg_c = 43
    power = "cycle"
    off_s = 30
    record_s = 10
    [[step]]
    name = "stand"
    angle_deg = 90
    """
    rates = StationRates(
        table_acceleration_deg_per_s2=20.0,
        chamber_deg_c_per_min=2.0,
        room_deg_c=23.0,
        angle_rate_deg_per_s=30.0,
        prompt_s=7.0,
    )
    spent = load_procedure(own(tmp_path, text)).spent(rates)
    assert {part: each.total_s for part, each in spent.items()} == {
        "ask": 67.0,
        "turn": 100 / 20 + 15.0,
        "hot": 20 / 2 * 60 + 40.0,  # the chamber is slower than the table: 10 s
        "stand": 3.0,
    }


def test_what_a_station_lacks_is_told() -> None:
    procedure = load_procedure("scale_factor_temperature_sensitivity")
    assert procedure.unmet(["rate", "temperature"]) == ()
    (lack,) = procedure.unmet(["rate"])
    assert "the temperature, from -40 to 60 degC" in lack


def test_a_file_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="cannot be read: No such file"):
        load_procedure(tmp_path / "none.toml")
    with pytest.raises(BadInput, match="`gyrofleet procedure list` shows"):
        load_procedure("none")
    with pytest.raises(BadInput, match=r"\.\./none"):
        load_procedure("../none")
