"""Metrics, verdicts and diagnoses on two processors of this machine by Spark, and what may go wrong there."""

import shutil
import threading
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from analytics.cluster.engine import Engine, MissingSpark, check_engine
from stream.errors import BadInput, GyrofleetError, StoreError
from tests.analytics.cluster.several_units import SOME, UNITS, computed, fill
from tests.conftest import Outcome

LACKING = "PySpark is not installed (pip install 'gyrofleet[spark]')" if find_spec("pyspark") is None else (
    "there is no Java here" if shutil.which("java") is None else ""
)  # fmt: skip
spark = pytest.mark.skipif(bool(LACKING), reason=LACKING)


@pytest.fixture(scope="module")
def engine() -> Iterator[Engine]:
    from analytics.cluster.spark import SparkEngine

    with SparkEngine("local[2]") as opened:
        yield opened


def ignore(_done: int, _total: int) -> None:
    """Progress that nobody reads."""


@spark
def test_metrics_are_those_of_one_process(tested: Any, engine: Engine, tmp_path: Path) -> None:
    fill(tested)
    tested.catalog().close()
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    there.mkdir()
    steps, metrics = computed(tested.store, here, None, SOME)
    by_spark = computed(tested.store, there, engine, SOME)
    assert metrics.num_rows > 20
    assert steps.equals(by_spark[0])
    assert metrics.equals(by_spark[1])


@spark
@pytest.mark.long
def test_commands_answer_by_spark_as_without_it(tested: Any, gyrofleet: Callable[..., Outcome], tmp_path: Path) -> None:
    fill(tested, runs=2)
    tested.catalog().close()
    copy = tmp_path / "copy"
    shutil.copytree(tested.store.folder, copy)
    words = ("--store", tested.store.folder)
    there = gyrofleet("metrics", "--store", copy, "--engine", "local[2]", "--json")
    assert there.code == 0, there.err
    assert (copy / "metrics" / "unit_metrics.parquet").exists()
    assert there.out == gyrofleet("metrics", *words, "--json").out
    kept = [(folder / "metrics" / "unit_metrics.parquet").read_bytes() for folder in (copy, tested.store.folder)]
    assert kept[0] == kept[1]
    assert "Traceback" not in there.err
    assert "WARN" not in there.err
    for folder in (tested.store.folder, copy):
        shutil.rmtree(folder / "metrics")
    by = gyrofleet("verdicts", "--store", copy, "--engine", "local[2]", "--json")
    assert len(by.json["units"]) == len(UNITS) + 1
    assert by.out == gyrofleet("verdicts", *words, "--json").out


@spark
@pytest.mark.long
def test_a_fleet_is_diagnosed_by_spark_as_without_it(tested: Any, gyrofleet: Callable[..., Outcome]) -> None:
    fill(tested)
    tested.catalog().close()
    words = ("diagnose", "--fleet", "--model", "rate = bias", "--store", tested.store.folder, "--json")
    here, there = gyrofleet(*words).json, gyrofleet(*words, "--engine", "local[2]").json
    for each in (*here["units"].values(), *there["units"].values()):
        each.pop("provenance")  # has the moment
    assert set(here["units"]) == set(UNITS)
    assert here == there


@spark
def test_tasks_fail_and_are_tried_again(engine: Engine, tmp_path: Path) -> None:
    def at_the_third_time(number: int) -> int:
        tries = tmp_path / f"{number}"
        with tries.open("a") as file:
            file.write("x")
        if number == 3 and len(tries.read_text()) < 3:
            raise OSError("the share is away for a moment")
        return number * number

    counted: list[tuple[int, int]] = []
    found = engine.map(at_the_third_time, range(8), [10] * 8, lambda done, total: counted.append((done, total)))
    assert found == [number * number for number in range(8)]
    assert (tmp_path / "3").read_text() == "xxx"
    assert counted[-1] == (80, 80)
    assert counted == sorted(counted)
    assert engine.map(at_the_third_time, [], [], ignore) == []


@spark
def test_a_task_that_fails_for_good_is_named(engine: Engine) -> None:
    def failing(number: int) -> int:
        if number == 1:
            raise StoreError("/share/S is not a gyrofleet store (there is no such folder)")
        return 1 // (number - 1) if number > 1 else 0

    with pytest.raises(GyrofleetError, match=r"a task failed on .*: /share/S is not a gyrofleet store"):
        engine.map(failing, [0, 1], [1, 1], ignore)

    def dividing(number: int) -> int:
        return 1 // number

    with pytest.raises(GyrofleetError, match=r"a task failed on .*ZeroDivisionError: integer"):
        engine.map(dividing, [0, 1], [1, 1], ignore)


@spark
def test_an_interrupted_job_is_cancelled(engine: Engine, tmp_path: Path) -> None:
    def slow(number: int) -> int:
        (tmp_path / f"{number}").touch()
        time.sleep(120.0)
        return number

    def interrupt(_done: int, _total: int) -> None:
        if len(list(tmp_path.iterdir())) == 2:  # both processors are at work
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        engine.map(slow, range(6), [1] * 6, interrupt)
    began = time.monotonic()
    assert engine.map(abs, [-1, -2], [1, 1], ignore) == [1, 2]
    assert time.monotonic() - began < 60.0
    assert len(list(tmp_path.iterdir())) == 2
    assert not [each for each in threading.enumerate() if each.name.startswith("gyrofleet-job-")]


@pytest.mark.parametrize(
    "name", ["yarn", "local", "local[0]", "local[2", "spark://host", "k8s://x:1", "spark://a b:1", ""]
)
def test_other_engines_are_refused(name: str) -> None:
    with pytest.raises(BadInput, match=r"give local\[N\], as local\[4\], or a Spark master"):
        check_engine(name)


@pytest.mark.skipif(find_spec("pyspark") is None, reason="PySpark is not installed")
def test_java_that_is_not_there_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("JAVA_HOME", raising=False)
    with pytest.raises(MissingSpark, match="needs Java 17 or later, and there is no java in the PATH: install it"):
        check_engine("local[2]")
    monkeypatch.setenv("JAVA_HOME", str(tmp_path))
    with pytest.raises(MissingSpark, match="no java in JAVA_HOME"):
        check_engine("local[2]")


@pytest.mark.skipif(find_spec("pyspark") is not None, reason="PySpark is installed")
def test_the_extra_that_is_not_there_is_named() -> None:
    with pytest.raises(MissingSpark, match=r"pip install 'gyrofleet\[spark\]'"):
        check_engine("local[2]")
