"""From samples of two stations in files to the sentence that names the one with the offset."""

import csv
import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from gyrofleet import main

UNITS, ON_BOTH, DAYS, OFFSET = 120, 60, 3, 0.05
Ask = Callable[..., Result]


def _write(path: Path, biases: dict[str, float], rng: np.random.Generator) -> None:
    """An hour of each unit's output, a sample a minute; the mean of the hour scatters by 0.02 deg/h."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["unit", "time[s]", "rate[deg/h]", "procedure", "step"])
        for unit, bias in biases.items():
            noise = rng.normal(0, 0.02 * np.sqrt(61), 61)
            for minute in range(61):
                writer.writerow([unit, 60 * minute, f"{bias + noise[minute]:.6f}", "static_bias", "static"])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """120 units of a scatter of 0.1 deg/h, half of them on both stations, day after day."""
    here = tmp_path_factory.mktemp("trend")
    rng = np.random.default_rng(20260751)
    own = rng.normal(2.0, 0.1, UNITS)
    days = [[unit for unit in range(UNITS) if unit % DAYS == day] for day in range(DAYS)]
    for day, units in enumerate(days):
        for station in (0, 1):
            chosen = [unit for unit in units if unit % 2 == station or unit < ON_BOTH]
            path = here / f"day-{day}-{'AB'[station]}.csv"
            _write(path, {f"FOG-{unit:04}": own[unit] + OFFSET * station for unit in chosen}, rng)
            start = f"2026-01-{5 + day:02}T{8 + 4 * station:02}:00:00Z"
            options = ["--store", here / "S", "--start", start, "--station", f"bench-{'AB'[station]}", "--json"]
            done = CliRunner().invoke(main, [str(each) for each in ("import", path, *options)])
            assert done.exit_code == 0, done.output
    (here / "spec.toml").write_text(
        'revision = "A"\n[[limit]]\nmetric = "bias"\nparameters = { earth_rate = "none" }\n'
        'lower = 1.0\nupper = 3.0\nunit_of_measure = "deg/h"\n'
    )
    done = CliRunner().invoke(main, ["limits", "add", str(here / "spec.toml"), "--store", str(here / "S")])
    assert done.exit_code == 0, done.output
    return here


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of three units, for what is refused: the one of 120 takes seconds."""
    here = tmp_path_factory.mktemp("few")
    _write(here / "day.csv", {f"FOG-{unit:04}": 2.0 for unit in range(3)}, np.random.default_rng(1))
    words = ("import", here / "day.csv", "--store", here / "S", "--start", "2026-01-05T08:00:00Z", "--json")
    done = CliRunner().invoke(main, [str(each) for each in words])
    assert done.exit_code == 0, done.output
    return here / "S"


@pytest.fixture
def ask(folder: Path) -> Ask:
    def run(*words: object, code: int = 0) -> Result:
        arguments = [*(str(word) for word in words), "--store", str(folder / "S")]
        done = CliRunner(env={**os.environ, "COLUMNS": "200"}).invoke(main, arguments)
        assert done.exit_code == code, done.output
        return done

    return run


@pytest.mark.long
def test_the_offset_of_a_station_is_found_and_attributed(ask: Ask) -> None:
    found = json.loads(ask("trend", "bias", "--json").stdout)
    assert (found["values"], found["units"]) == (UNITS + ON_BOTH, UNITS)
    (station,) = found["differences"]
    assert (station["group"], station["level"], station["against"]) == ("station", "bench-B", "bench-A")
    assert station["lo"] < OFFSET < station["hi"]
    assert station["hi"] - station["lo"] < 0.02
    (pair,) = found["pairs"]
    assert pair["units"] == ON_BOTH
    assert pair["lo"] < OFFSET < pair["hi"]
    assert found["components"]["unit"]["lo"] < 0.1 < found["components"]["unit"]["hi"]
    said = "\n".join(each["en"] for each in found["report"])
    assert "Station bench-B gives values" in said
    assert f"the {ON_BOTH} units measured on both" in said
    assert "it is the station, not its units" in said


@pytest.mark.long
def test_people_read_tables_and_sentences_in_either_language(ask: Ask, folder: Path) -> None:
    english = ask("trend", "bias", "--by", "station", "--plot", folder / "bias.png")
    assert "bench-B" in english.stdout
    assert "in control" in english.stdout
    assert "Station bench-B gives values" in english.stdout
    assert (folder / "bias.png").stat().st_size > 20_000
    chinese = ask("trend", "bias", "--by", "station", "--lang", "zh").stdout
    assert "试验台 bench-B 的值比试验台 bench-A 高" in chinese
    assert "受控" in chinese


@pytest.mark.long
def test_the_metric_is_an_argument_or_an_option(ask: Ask) -> None:
    assert json.loads(ask("trend", "--metric", "bias", "--unit", "FOG-0007", "--json").stdout)["metric"] == "bias"
    for words in (("trend",), ("trend", "bias", "--metric", "threshold")):
        assert "name one metric" in " ".join(ask(*words, code=1).output.split())


@pytest.mark.long
def test_capability_is_against_the_specification(ask: Ask) -> None:
    (chart,) = json.loads(ask("trend", "bias", "--station", "bench-A", "--json").stdout)["charts"]
    capability = chart["capability"]
    assert (capability["lower"], capability["upper"]) == (1.0, 3.0)
    # a scatter of 0.1 about 2.0, within 1.0 to 3.0
    assert capability["cp"]["lo"] < 1 / 0.3 * 1.05
    assert capability["cp"]["hi"] > 1 / 0.3 * 0.95
    assert chart["points"][0]["standard_uncertainty"] > 0


@pytest.mark.long
def test_choices_narrow_the_values(ask: Ask) -> None:
    one = json.loads(ask("trend", "bias", "--unit", "FOG-0007", "--json").stdout)
    assert (one["by"], one["values"]) == ("unit", 2)
    assert "too little to judge" in "\n".join(each["en"] for each in one["report"])
    late = json.loads(ask("trend", "bias", "--since", "2026-01-07", "--json").stdout)
    assert late["units"] == UNITS // DAYS
    raw = json.loads(ask("trend", "bias", "--parameter", "earth_rate=none", "--json").stdout)
    assert raw["kind"]["parameters"]["earth_rate"] == "none"


@pytest.mark.in_gate("words4-average_s=100", "words6---since")
@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("trend", "biass"), "did you mean bias"),
        (("trend", "threshold"), "no unit of this store"),
        (("trend", "bias", "--unit", "FOG-9999"), "FOG-9999"),
        (("trend", "bias_stability_averaged"), "no unit has a value"),
        (("trend", "bias", "--parameter", "average_s"), "average_s=100"),
        (("trend", "bias", "--plot", "bias.pdf"), ".png or .svg"),
        (("trend", "bias", "--since", "yesterday"), "--since"),
        (("trend", "bias", "--standard", "XYZ"), "GJB2426A"),
    ],
)
def test_mistakes_are_told(few: Path, words: tuple[str, ...], message: str) -> None:
    done = CliRunner(env={**os.environ, "COLUMNS": "200"}).invoke(main, [*words, "--store", str(few)])
    assert done.exit_code == 1, done.output
    assert message in " ".join(done.output.split())
