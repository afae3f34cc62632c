"""`gyrofleet diagnose` on a store that was filled by `gyrofleet import`: planted effects, options and the report."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner, Result

from analytics.commands.closed_loop.diagnose import diagnose
from gyrofleet import main
from tests import browser

MODEL = "rate = bias + scale_factor*input_rate + temperature"
SHUPE = 30.0  # deg/h per degC/s
KEYS = [
    "verdict", "units", "signal", "effects", "confounded", "unreplicated", "holdout", "error", "noise",
    "detection_limits", "not_tested", "limits", "missing", "left_out", "replication", "training_runs", "model",
    "explainable", "recovery", "regressors", "coherence", "provenance", "noise_source", "reduction",
]  # fmt: skip


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory, run_command: Callable[..., Any]) -> Path:
    """Nine runs of one hour at 1 Hz of FOG-2, with temperature cycles and rates; it has an effect of its own."""
    folder = tmp_path_factory.mktemp("diagnose")
    rng = np.random.default_rng(1980)
    for unit, shupe in (("FOG-1", 0.0), ("FOG-2", SHUPE)):
        pl.concat(one_run(unit, run, shupe, rng) for run in range(9)).write_parquet(folder / f"{unit}.parquet")
    assert run_command("import", "FOG-2.parquet", "--store", "store", cwd=folder).code == 0
    return folder / "store"


@pytest.fixture(scope="module")
def both(store: Path, run_command: Callable[..., Any]) -> Path:
    """The store once FOG-1 is in it, which has no effect; no test of the gate asks for it."""
    assert run_command("import", "FOG-1.parquet", "--store", "store", cwd=store.parent).code == 0
    return store


def one_run(unit: str, run: int, shupe: float, rng: np.random.Generator) -> pl.DataFrame:
    time_s = np.arange(3600.0)
    temperature = 25 + 15 * np.sin(2 * np.pi * time_s / (1200 + 200 * run)) * (run % 3 != 1)
    rate = np.where(run % 3 == 1, 10.0 * np.sign(np.sin(2 * np.pi * (time_s + 1) / 1200)), 0.0)
    slow = np.cumsum(rng.standard_normal(3600)) * 0.01 / 60
    error = 0.3 + 0.1 * rng.standard_normal() + 0.02 * (temperature - 25) + shupe * np.gradient(temperature) + slow
    noise = 0.01 * 60 * rng.standard_normal(3600)
    return pl.DataFrame(
        {
            "time[s]": time_s,
            "unit": [unit] * 3600,
            "run": [f"r{run}"] * 3600,
            "rate[deg/h]": 3600.2 * rate + error + noise,
            "input_rate[deg/s]": rate,
            "temperature[degC]": temperature + 0.01 * rng.standard_normal(3600),
        }
    )


def ask(store: Path, *more: object, unit: str = "FOG-2", model: str = MODEL) -> tuple[object, ...]:
    return ("diagnose", "--unit", unit, "--model", model, "--store", store, *more)


def test_a_planted_effect_is_found_and_the_document_has_its_parts(gyrofleet: Callable[..., Any], store: Path) -> None:
    done = gyrofleet(*ask(store, "--json"))
    assert done.code == 0
    found = done.json
    assert list(found) == KEYS
    (effect,) = found["effects"]
    members = {effect["name"], *(each["name"] for each in found["confounded"])}
    assert found["verdict"] == "confounded"
    assert "temperature_rate" in members
    # a clock's error is the same regressor here; each alternative comes with its test
    assert all(each["separating_test"] for each in found["confounded"])
    if effect["name"] == "temperature_rate":
        # four standard errors, and 1 % for a slope that is estimated from blocks of 30 s of a cycle of 1200 s
        reach = 4 * (effect["hi"] - effect["lo"]) / 3.92 + 0.01 * SHUPE
        assert abs(effect["coefficient"] - SHUPE) < reach
    assert effect["unit_of_measure"] == "deg/h/(degC/s)"
    assert found["holdout"]["runs"] == ["r6", "r7", "r8"]
    assert found["holdout"]["accepted"]
    before, after, floor = (found["error"][part]["rms_300s"] for part in ("before", "after", "floor"))
    assert after < 0.8 * before
    assert after < 1.1 * floor
    assert found["noise_source"] == "the unit's own Allan fits; turn-on scatter estimated from these runs"
    assert found["noise"]["declared"]["N"] == pytest.approx(0.01, rel=0.3)
    assert effect["false_alarm_probability"] < 1e-6
    assert {each["name"] for each in found["regressors"]["regressors"]} >= {"bias", "temperature", effect["name"]}
    assert {each["channel"] for each in found["coherence"]} >= {"temperature", "input_rate"}
    assert set(found["provenance"]["sha256"]) == {f"r{number}" for number in range(9)}


@pytest.mark.long
def test_a_unit_without_an_effect_lacks_nothing(gyrofleet: Callable[..., Any], both: Path) -> None:
    found = gyrofleet(*ask(both, "--json", unit="FOG-1")).json
    assert found["verdict"] == "nothing_missing"
    assert found["effects"] == []
    limit = found["detection_limits"]["temperature_rate"]
    assert limit["absent_above"] < SHUPE / 3


@pytest.mark.long
@pytest.mark.parametrize(("language", "words"), [
    ("en", ("these data cannot separate", "held-out runs", "separating test:", "absent above", "Next test: ")),
    ("zh", ("现有数据无法区分", "留出试验", "区分方法", "不高于", "下一项试验：")),
])  # fmt: skip
def test_the_verdict_is_told_in_words_with_a_report_and_pictures(
    gyrofleet: Callable[..., Any], store: Path, tmp_path: Path, language: str, words: tuple[str, ...]
) -> None:
    report, plots = tmp_path / "report.html", tmp_path / "plots"
    done = gyrofleet(*ask(store, "--lang", language, "--report", report, "--plot", plots, "--save", "--next-test"))
    assert done.code == 0
    for each in words:
        assert each in done.out
    text = report.read_text(encoding="utf-8")
    assert f'<html lang="{language}">' in text
    assert not re.search(r"https?://|<script", text)
    assert (store / "models" / "FOG-2").is_dir()
    assert text.count("data:image/png;base64,") == len(list(plots.glob("FOG-2-*.png"))) >= 4


@pytest.mark.long
def test_a_verdict_is_told_though_its_model_cannot_be_saved(
    gyrofleet: Callable[..., Any], store: Path, tmp_path: Path
) -> None:
    shutil.copytree(store, tmp_path / "full", ignore=shutil.ignore_patterns("models"))
    (tmp_path / "full" / "models").write_text("a file stands in its place")
    done = gyrofleet(*ask(tmp_path / "full", "--save"))
    assert done.code == 1
    assert "these data cannot separate" in done.out
    assert "its error model cannot be written" in done.err


@pytest.fixture(scope="module")
def fleet(both: Path) -> Result:
    """All units of the store diagnosed together, with every line of progress."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("stream.terminal.console._STATUS_EVERY_S", 0.0)
        done = CliRunner().invoke(main, ["diagnose", "--fleet", "--model", MODEL, "--store", str(both), "--json"])
    assert done.exit_code == 0, done.output
    return done


@pytest.mark.long
def test_a_fleet_is_pooled(fleet: Result) -> None:
    found = json.loads(fleet.stdout)
    assert list(found["units"]) == ["FOG-1", "FOG-2"]
    assert {"verdict", "effects", "by_unit", "own_findings"} <= set(found)


@pytest.mark.long
def test_several_units_are_a_list(gyrofleet: Callable[..., Any], both: Path) -> None:
    store = both
    two = gyrofleet("diagnose", "--unit", "FOG-1", "--unit", "FOG-2", "--model", MODEL, "--store", store, "--json").json
    assert list(two["units"]) == ["FOG-1", "FOG-2"]
    assert list(two["own_findings"]) == ["FOG-2"]
    assert "by_unit" not in two
    reported = gyrofleet("diagnose", "--fleet", "--model", MODEL, "--store", store, "--lang", "zh").err
    assert "局限 (FOG-1, FOG-2): 9次试验均无上电记录" in reported
    words = ("diagnose", "--fleet", "--model", MODEL, "--store", store, "--json", "--holdout")
    named = gyrofleet(*words, "runs=r1,r4").json["units"]["FOG-2"]
    assert named["holdout"]["runs"] == ["r1", "r4"]
    assert named["training_runs"] == ["r0", "r2", "r3", "r5", "r6", "r7", "r8"]
    strange = gyrofleet(*words, "runs=r1,r99")
    assert strange.code == 1
    assert "not there in any unit: r99" in strange.json["error"]["message"]
    failed = gyrofleet("diagnose", "--unit", "FOG-2", "--unit", "FOG-9", "--model", MODEL, "--store", store, "--json")
    assert failed.code == 1
    assert "FOG-9" in failed.json["failed"]
    assert list(failed.json["units"]) == ["FOG-2"]


@pytest.mark.long
def test_a_fleet_is_counted_on_standard_error(fleet: Result) -> None:
    assert [line for line in fleet.stderr.splitlines() if line.startswith(("reading", "tracing", "searching"))] == [
        "reading FOG-1 (1 of 2)",
        "reading FOG-2 (2 of 2)",
        "tracing FOG-1 (1 of 2)",
        "tracing FOG-2 (2 of 2)",
        "searching for effects common to 2 units",
    ]


@pytest.mark.long
def test_runs_noise_and_blocks_can_be_named(gyrofleet: Callable[..., Any], store: Path) -> None:
    noise = "N=0.01,B=0.01,K=0.01,turn_on=0.1"
    runs = [word for number in (0, 2, 3, 5, 6) for word in ("--run", f"r{number}")]
    found = gyrofleet(*ask(store, "--json", "--noise", noise, "--block", "1min", "--holdout", "runs=r0", *runs)).json
    assert found["holdout"]["runs"] == ["r0"]
    assert found["training_runs"] == ["r2", "r3", "r5", "r6"]
    assert found["noise"]["declared"] == {"N": 0.01, "B": 0.01, "K": 0.01, "turn_on": 0.1}
    assert found["noise_source"] == "as given"
    assert "rms_60s" in found["error"]["before"]
    none = gyrofleet(*ask(store, "--json", "--holdout", "none")).json
    assert none["holdout"] is None
    assert any("no held-out set" in limit for limit in none["limits"])
    single = gyrofleet(*ask(store, "--json", "--run", "r0")).json
    assert single["replication"] == "within_run"
    assert single["verdict"] != "effect_found"


@pytest.mark.in_gate(
    "more0-B, K is missing",
    "more1-N above 0",
    "more4-such as 30s, 1min or 0.5h",
    "more2-could not convert",
    "more5-last-third, none, or runs=A,B",
    "more11-slope is not known",
)
@pytest.mark.parametrize(("more", "message"), [
    (("--noise", "N=1"), "B, K is missing"),
    (("--noise", "N=0,B=0,K=0,turn_on=0"), "N above 0"),
    (("--noise", "N=a,B=0,K=0,turn_on=0"), "could not convert"),
    (("--block", "0s"), "positive number of seconds"),
    (("--block", "soon"), "such as 30s, 1min or 0.5h"),
    (("--holdout", "r1"), "last-third, none, or runs=A,B"),
    (("--holdout", "runs=r99"), "run to hold out is not there: r99"),
    (("--signal", "temperature"), "is of signal rate, not of temperature"),
    (("--run", "r99"), "no run r99"),
    (("--report", "r.pdf"), "written as .html"),
    (("--since", "2099-01-01"), "no sample lies in the time"),
    (("--bounds", "slope=1"), "slope is not known"),
])  # fmt: skip
def test_wrong_options_say_what_to_give(store: Path, more: tuple[str, ...], message: str) -> None:
    assert message in refusal(*ask(store, *more))


def refusal(*words: object) -> str:
    """What the command says as it refuses, in this process."""
    done = CliRunner().invoke(diagnose, [*map(str, words[1:]), "--json"])
    assert done.exit_code == 1
    return str(json.loads(done.stdout)["error"]["message"])


@pytest.mark.long
@pytest.mark.parametrize(("model", "message"), [
    ("rate = bias + temprature", "did you mean temperature"),
    ("bias + temperature", "which signal is it of? give --signal"),
    ("rate = bias + supply_voltage", "needs channel supply_voltage"),
])  # fmt: skip
def test_a_model_that_cannot_be_meant_is_told(store: Path, model: str, message: str) -> None:
    assert message in refusal(*ask(store, model=model))


def test_nobody_is_diagnosed_unasked(store: Path) -> None:
    assert "give --unit, once or several times, or --fleet" in refusal("", "--model", MODEL, "--store", store)


@pytest.mark.long
@pytest.mark.skipif(not browser.IS_THERE, reason="no chromium and chromedriver to look with")
@pytest.mark.parametrize(
    ("language", "words"),
    [("en", ("Tests that separate them", "Error before and after")), ("zh", ("可区分的测试", "前后误差"))],
)
def test_a_browser_shows_the_report_without_a_fault(
    gyrofleet: Callable[..., Any], store: Path, tmp_path: Path, language: str, words: tuple[str, ...]
) -> None:
    report = tmp_path / "report.html"
    assert gyrofleet(*ask(store, "--report", report, "--lang", language)).code == 0
    with browser.Browser() as window:
        for width in (1400, 700):
            window.open(report.as_uri(), width=width)
            shown = window.ask("document.body.innerText")
            assert all(each in shown for each in words)
            sizes = window.ask("[...document.images].map(each => [each.naturalWidth, each.clientWidth])")
            assert len(sizes) >= 4
            assert all(natural > 0 and 0 < client <= width for natural, client in sizes), "a picture is not shown"
            assert window.ask("document.documentElement.scrollWidth <= window.innerWidth"), "the page is too wide"
            assert window.complaints() == []


def test_the_next_test_is_asked_for_in_json_report_and_procedure(
    gyrofleet: Callable[..., Any], store: Path, tmp_path: Path
) -> None:
    done = gyrofleet(
        *ask(store, "--json", "--write-procedure", tmp_path / "next.toml", "--report", tmp_path / "r.html")
    )
    assert done.code == (0 if (tmp_path / "next.toml").exists() else 1)
    found = done.json["next_test"]
    assert set(found) >= {"question", "rivals", "weights", "inseparable", "plans", "repeat", "holdout", "why_not"}
    assert "temperature_rate" in found["rivals"]
    # the clock of its sensor follows the same regressor, or is excluded by its size
    assert "temperature_time_offset" not in found["rivals"]
    assert "Next test" in (tmp_path / "r.html").read_text(encoding="utf-8")
    assert (tmp_path / "next.toml").exists() == bool([each for each in found["plans"] if not each["repeat_of"]])
    assert ("no procedure is written" in done.err) != (tmp_path / "next.toml").exists()
