"""A procedure's file: what is refused, how loops unroll, parameters, and durations."""

from pathlib import Path

import pytest

from ingest.procedures.procedure import load_procedure
from ingest.procedures.run_steps import StationRates
from stream.errors import BadInput

HEAD = 'name = "own"\nnames = {en = "Own", zh = "自定义"}\n'


def own(folder: Path, text: str) -> Path:
    path = folder / "own.toml"
    path.write_text(HEAD + text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ("[[step]]\nname='a'\nrecrod_s=1", r"unknown field `recrod_s` - at `\$\.step\[0\]`, did you mean record_s\?"),
        ("sorce=['a']\n[[step]]\nname='a'", r"unknown field `sorce`, did you mean source\?"),
        ("[[step]]\nname='a'\nprompt={eng='A'}", r"`eng` - at `\$\.step\[0\]\.prompt`, did you mean en\?"),
        (
            "[[step]]\nname='a'\nzzzz=1",
            r"unknown field `zzzz` - at `\$\.step\[0\]`; there are name, for, .*wait_settled$",
        ),
        ("[step]\nname='a'", r"write \[\[step\]\], with two brackets, also for one$"),
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
        (
            "[[step]]\nfor='k'\nvalues=[1]\n[[step.step]]\nfor='k'\nvalues=[2]\n[[step.step.step]]\nname='a'",
            r"\$\.step\[0\]\.step\[0\]\.for: 'k' is the variable of a loop around this one",
        ),
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
def test_a_mistake_is_told_with_file_and_key(tmp_path: Path, text: str, reported: str) -> None:
    path = own(tmp_path, text)
    with pytest.raises(BadInput, match=reported) as caught:
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
    ("given", "reported"),
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
def test_a_parameter_is_checked(given: dict[str, str], reported: str) -> None:
    with pytest.raises(BadInput, match=reported):
        load_procedure("scale_factor").steps(given)


def test_a_list_of_numbers_is_a_parameter_too() -> None:
    asymmetry = load_procedure("system_level_asymmetry")
    steps = [step for step in asymmetry.steps({"speeds_deg_per_s": "12, 15"}) if step.is_recorded]
    assert {abs(step.settings["rate"]) for step in steps if "rate" in step.settings} == {12.0, 15.0}
    with pytest.raises(BadInput, match="above the most"):
        asymmetry.steps({"speeds_deg_per_s": "12,45"})


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
    with pytest.raises(BadInput, match=r"no procedure 'statc_bias', did you mean static_bias\?; `gyrofleet procedure"):
        load_procedure("statc_bias")
    with pytest.raises(BadInput, match=r"\.\./none"):
        load_procedure("../none")
