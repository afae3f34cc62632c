"""One question about many runs has the answers of a question about each."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from storage.recording.knowledge import AskedAhead, CatalogKnowledge, KnownRuns, KnownSignal
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.batch import FloatArray, IntArray


class Counted:
    """Counts the questions."""

    def __init__(self, knowledge: CatalogKnowledge) -> None:
        self._knowledge = knowledge
        self.asked: list[list[str]] = []

    def signals(self, runs: list[str]) -> list[KnownSignal]:
        return self._knowledge.signals(runs)

    def runs(self, runs: list[str]) -> KnownRuns:
        self.asked.append(runs)
        return self._knowledge.runs(runs)

    def samples(self, unit: str, signal: str, run: str, first_ns: int, last_ns: int) -> tuple[IntArray, FloatArray]:
        return self._knowledge.samples(unit, signal, run, first_ns, last_ns)


@pytest.mark.parametrize("count", [2, pytest.param(4, marks=pytest.mark.long)])
def test_one_question_has_the_answers_of_many(tmp_path: Path, gyrofleet: Callable[..., Any], count: int) -> None:
    *known, _ = asked = [f"r{number}" for number in range(count + 1)]
    for number, run in enumerate(known):
        rows = "".join(f"{at / 10},U{at % 2},{at % 7},{20 + number}\n" for at in range(40))
        (tmp_path / f"{run}.csv").write_text("time[s],unit,rate[deg/s],temperature[degC]\n" + rows)
        dated = ("--start", "2026-11-21T10:00:00Z", "--latitude", 30 + number) if number % 2 else ()
        words = ("import", f"{run}.csv", "--run", run, "--procedure", "static_bias", *dated)
        done = gyrofleet(*words, "--store", "S")
        assert done.code == 0, done.err
    with Catalog(Store.open(tmp_path / "S")) as catalog:
        plain = CatalogKnowledge(catalog)
        counted = Counted(plain)
        ahead = AskedAhead(counted, asked)
        for runs in ([asked[0]], [asked[count - 1], asked[count // 2 - 1]], asked, ["unknown"]):
            found, expected = ahead.runs(runs), plain.runs(runs)
            assert found.dated == expected.dated
            assert sorted(found.open) == sorted(expected.open)
            assert set(found.uids) >= set(expected.uids)
            assert sorted(found.mounted) == sorted(expected.mounted)
            assert found.stated == expected.stated
            assert sorted(found.steps) == sorted(expected.steps)
            assert sorted(ahead.signals(runs)) == sorted(plain.signals(runs))
        assert counted.asked == [asked, ["unknown"]]
        assert len(plain.runs(asked).dated) == count
        first, last = (getattr(plain.signals(["r1"])[0], name) for name in ("t_first_ns", "t_last_ns"))
        for mine, theirs in zip(
            ahead.samples("U0", "rate", "r1", first, last), plain.samples("U0", "rate", "r1", first, last), strict=True
        ):
            assert np.array_equal(mine, theirs)
