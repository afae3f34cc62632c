"""Stores that earlier versions made are sound, give the same answers, and are recorded into."""

import json
import math
import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import gyrofleet as gf

Command = Callable[..., Any]
STORES = sorted((Path(__file__).parent / "stores").glob("*.tar.gz"))


@pytest.fixture(params=STORES, ids=lambda path: path.name.partition(".")[0])
def made(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, dict[str, Any]]:
    """A store of an earlier version, and what that version answered."""
    with tarfile.open(request.param) as archive:
        archive.extractall(tmp_path, filter="data")
    return tmp_path / "store", json.loads((tmp_path / "answers.json").read_text())


def check(gyrofleet: Command, store: Path, answers: dict[str, Any], *, where: str = "true") -> None:
    """The store is sound and gives the rows of then."""
    assert gyrofleet("verify", "--store", store, "--values", "--json").json["sound"]
    for name, asked in answers.items():
        rows = gf.open_store(store).sql(f"from ({asked['statement']}) where {where}").polars().to_dicts()
        assert len(rows) == len(asked["rows"]) > 0, name
        for now, then in zip(rows, asked["rows"], strict=True):
            for column, value in then.items():
                if isinstance(value, float):
                    assert math.isclose(now[column], value, rel_tol=1e-12), (name, column)
                else:
                    assert now[column] == value, (name, column)


def test_answers_are_those_of_then(gyrofleet: Command, made: tuple[Path, dict[str, Any]]) -> None:
    check(gyrofleet, *made)


@pytest.mark.in_gate("schema-2")
def test_a_lake_built_from_its_log_gives_the_same_answers(
    gyrofleet: Command, made: tuple[Path, dict[str, Any]]
) -> None:
    store, answers = made
    gyrofleet("rebuild", "--store", store, "--json")
    check(gyrofleet, store, answers)


@pytest.mark.in_gate("schema-1")
def test_more_is_recorded_into_it(gyrofleet: Command, made: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    store, answers = made
    file = tmp_path / "more.csv"
    file.write_text("time[s],rate[deg/h]\n" + "".join(f"{1.7905e9 + i},{15 + i % 7}\n" for i in range(500)))
    gyrofleet("import", file, "--unit", "FOG-9", "--run", "more", "--store", store, "--json")
    samples = {"samples": answers["samples"]}
    check(gyrofleet, store, samples, where="unit <> 'FOG-9'")
    found = (
        gf.open_store(store).sql("select count(*) as n, sum(value) as total from samples where run = 'more'").polars()
    )
    assert found.rows() == [(500, sum(15 + i % 7 for i in range(500)))]
