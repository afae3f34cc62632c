"""Units of a fleet that are read together: the same blocks, notes and errors as each by itself, by few statements."""

import pickle
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest

from analytics.loop.blocks import block_reducer
from analytics.loop.blocks.block_reducer import BlockReducer, Reduction
from analytics.loop.blocks.signal_blocks import block_means
from storage.sql.catalog import Catalog
from stream.errors import BadInput, GyrofleetError, NotFound
from tests.analytics.conftest import SECOND_NS, START_NS, TestedUnits

UNITS = ("FAST", "SLOW", "ODD", "LATE", "NONE", "WILD", "LAST")


def fleet(tested: TestedUnits) -> None:
    """Units that are sampled otherwise, beside a table and a chamber; some cannot be reduced."""
    rng = np.random.default_rng(1)
    for number, run in enumerate(("r1", "r2")):
        t0_ns = START_NS + number * 3600 * SECOND_NS
        tested.run(run, t_ns=t0_ns)

        def put(
            unit: str, signal: str, values: Any, measure: str, dt_s: float, at: str = run, since: int = t0_ns
        ) -> None:
            tested.samples(at, unit, signal, values, t0_ns=since, dt_ns=round(dt_s * 1e9), unit_of_measure=measure)

        put("table", "table_rate", rng.normal(0.0, 1e-3, 6000), "deg/s", 0.1)
        put("chamber", "chamber_temperature", 20.0 + rng.normal(0.0, 0.1, 40), "degC", 15.0)
        for unit in ("FAST", "WILD", "LAST"):
            put(unit, "rate", rng.normal(3.0, 1.0, 6000), "deg/h", 0.1)
            put(unit, "temperature", 25.0 + rng.normal(0.0, 0.1, 600), "degC", 1.0)
        put("SLOW", "rate", rng.normal(3.0, 1.0, 300), "deg/h", 2.0)
        put("SLOW", "supply_voltage", rng.normal(5.0, 0.01, 300), "V", 2.0)
        put("ODD", "rate", rng.normal(3.0, 1.0, 6000), "deg/h" if number else "V", 0.1)
        if number:
            put("LATE", "rate", rng.normal(3.0, 1.0, 6000), "deg/h", 0.1)


def outcome(found: Reduction | GyrofleetError) -> object:
    return (type(found), str(found)) if isinstance(found, GyrofleetError) else pickle.dumps(found)


def singly(catalog: Catalog, units: Sequence[str], **options: Any) -> Iterator[Reduction | GyrofleetError]:
    for unit in units:
        try:
            yield BlockReducer(catalog, "rate", **options).reduce(unit)
        except GyrofleetError as error:
            yield error


@pytest.mark.parametrize(
    ("units", "options"),
    [
        (("FAST", "SLOW", "ODD", "NONE"), {}), (UNITS, {}), (UNITS, {"runs": ["r1"]}), (UNITS, {"block_s": 0.8}),
        (UNITS, {"until_ns": START_NS + 1800 * SECOND_NS}),
    ],
    ids=["few", "all", "of a run", "other blocks", "until"],
)  # fmt: skip
@pytest.mark.in_gate("few")
def test_units_read_together_are_those_read_singly(
    tested: TestedUnits, units: tuple[str, ...], options: dict[str, Any]
) -> None:
    fleet(tested)
    with tested.catalog() as catalog:
        alone = list(singly(catalog, units, **options))
        together = list(BlockReducer(catalog, "rate", **options).reduce_each(units))
    assert [outcome(each) for each in together] == [outcome(each) for each in alone]
    by_unit = dict(zip(units, alone, strict=True))
    assert isinstance(by_unit["NONE"], NotFound)
    assert isinstance(by_unit["FAST"], Reduction)
    if not options:
        assert isinstance(by_unit["ODD"], BadInput)
        assert sum(isinstance(each, Reduction) for each in alone) == len(units) - 2
        assert isinstance(by_unit["SLOW"], Reduction)
        assert set(by_unit["SLOW"].runs[0].channels) >= {"supply_voltage", "table_rate"}


def statements(tested: TestedUnits, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The statements that read samples or rollups."""
    asked: list[str] = []
    reader = Catalog.reader

    def counted(self: Catalog, sql: str, *arguments: Any) -> Any:
        asked.append(sql)
        return reader(self, sql, *arguments)

    with monkeypatch.context() as patch, tested.catalog() as catalog:
        patch.setattr(Catalog, "reader", counted)
        list(BlockReducer(catalog, "rate").reduce_each([each for each in UNITS if each not in ("ODD", "NONE")]))
    return [each for each in asked if "_in($paths)" in each]


def test_few_statements_read_many_units_and_large_units_are_read_by_themselves(
    tested: TestedUnits, monkeypatch: pytest.MonkeyPatch
) -> None:
    fleet(tested)
    together = len(statements(tested, monkeypatch))
    monkeypatch.setattr(block_reducer, "_MOST_ROWS", 0)
    each = len(statements(tested, monkeypatch))
    # of the signal by rollups and samples, of its channels the same, of their single readings; the range of the table
    assert together <= 7
    assert each >= 2 * together - 1  # the single readings of the station are read once in any case


@pytest.mark.in_gate("two")
@pytest.mark.parametrize("units", [("FAST", "WILD"), UNITS], ids=["two", "all"])
def test_one_that_cannot_be_read_leaves_the_others(
    tested: TestedUnits, monkeypatch: pytest.MonkeyPatch, units: tuple[str, ...]
) -> None:
    """Whatever of a unit breaks the common statement, each is then read by itself."""
    fleet(tested)

    def broken(catalog: Catalog, grids: Any, *arguments: Any, **options: Any) -> Any:
        if any(key.unit == "WILD" for key in grids):
            raise BadInput("unit WILD: a value that no statement can read")
        return block_means(catalog, grids, *arguments, **options)

    monkeypatch.setattr(block_reducer, "block_means", broken)
    with tested.catalog() as catalog:
        found = dict(zip(units, BlockReducer(catalog, "rate").reduce_each(units), strict=True))
    assert "WILD" in str(found["WILD"])
    read = [unit for unit, each in found.items() if isinstance(each, Reduction)]
    assert read == [unit for unit in ("FAST", "SLOW", "LATE", "LAST") if unit in units]
