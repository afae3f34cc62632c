"""Metrics that are brought up to date are those computed from scratch, bit for bit; only what changed is computed."""

import shutil
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from analytics.evaluation import evaluation, kept_metrics
from analytics.evaluation.kept_check import kept_findings
from analytics.evaluation.selection import Selection, selected
from analytics.metric_registry.registry import metrics
from analytics.step_records import step_table
from analytics.step_records.reduction import reduce_runs
from analytics.step_records.step_table import write_kept
from storage.lake.builder import builder_lock
from storage.lake.compaction import compact
from storage.lake.lake import Lake
from stream.events import CheckEntered, Verdict

START_NS = 1_763_683_200 * 10**9  # 2025-11-21 00:00 UTC
SECOND_NS = 10**9
DAY_NS = 86_400 * SECOND_NS
RATES = (0.0, *(sign * rate for rate in np.geomspace(1.0, 100.0, 11) for sign in (1, -1)), 0.0)
SPECIFICATION = 'revision = "A"\n[product."FOG-70"]\naverage_s = {average_s}\nnonlinearity_ppm = 500.0\n'


class Work:
    """Which units were evaluated and which runs were reduced since it was last asked."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._units: list[str] = []
        self._runs: list[str] = []
        evaluate = evaluation.evaluate

        def evaluated(catalog: Any, chosen: Any) -> pa.Table:
            self._units += [unit for (unit,) in catalog.rows("select distinct unit from step_means order by unit")]
            return evaluate(catalog, chosen)

        def reduced(catalog: Any, runs: list[str]) -> Iterator[tuple[int, pa.Table]]:
            self._runs += runs
            return reduce_runs(catalog, runs)

        monkeypatch.setattr(evaluation, "evaluate", evaluated)
        monkeypatch.setattr(step_table, "reduce_runs", reduced)

    def done(self) -> tuple[list[str], list[str]]:
        units, runs = self._units.copy(), self._runs.copy()
        self._units.clear()
        self._runs.clear()
        return units, runs


@pytest.fixture
def work(monkeypatch: pytest.MonkeyPatch) -> Work:
    return Work(monkeypatch)


class Bench:
    """Runs of a test bench, with values from a fixed seed."""

    def __init__(self, tested: Any) -> None:
        self.tested = tested
        self.rng = np.random.default_rng(3)

    def still(self, run: str, day: int, units: tuple[str, ...], power_ons: int = 2) -> None:
        t_ns = START_NS + day * DAY_NS
        self.tested.run(run, t_ns=t_ns, procedure="static_bias")
        for unit in units:
            self.tested.mount(run, unit, t_ns=t_ns, product="FOG-70")
            for power_on in range(power_ons):
                at_ns = t_ns + power_on * 7200 * SECOND_NS
                self.tested.power_on(run, unit, at_ns)
                rate = self.rng.normal(5.0, 2.0, 3600) + np.cumsum(self.rng.normal(0, 0.02, 3600))
                warm = np.linspace(20.0, 21.0, 360)
                signals = {"rate": (rate, "deg/h"), "temperature": (warm, "degC")}
                self.tested.step(run, unit, signals, t0_ns=at_ns, dt_ns=SECOND_NS, position="IRA_up")

    def rates(self, run: str, day: int, unit: str) -> None:
        t_ns = at_ns = START_NS + day * DAY_NS
        self.tested.run(run, t_ns=t_ns, procedure="scale_factor")
        self.tested.mount(run, unit, t_ns=t_ns, product="FOG-70")
        self.tested.power_on(run, unit, t_ns)
        for rate in RATES:
            values = rate * 1.0003 + 0.01 + self.rng.normal(0, 0.001, 50)
            at_ns = self.tested.step(
                run, unit, values, t0_ns=at_ns, unit_of_measure="deg/s", rate_command_deg_per_s=float(rate)
            )

    def temperatures(self, run: str, day: int, unit: str) -> None:
        t_ns = at_ns = START_NS + day * DAY_NS
        self.tested.run(run, t_ns=t_ns, procedure="bias_temperature_sensitivity")
        for degrees in (20.0, -40.0, 0.0, 60.0):
            values = 5.0 + 0.01 * degrees + self.rng.normal(0, 2.0, 100)
            words = {"temperature_command_deg_c": degrees, "room": degrees == 20.0}
            at_ns = self.tested.step(run, unit, values, t0_ns=at_ns, **words)

    def grown(self) -> list[Callable[[], None]]:
        """What happens to the store, one after the other."""
        checked = CheckEntered(
            run="", t_ns=START_NS, unit="U2", item="visual", verdict=Verdict.PASS, by="Li", uid="ab" * 8
        )
        return [
            lambda: self.still("r1", 0, ("U1", "U2")),
            lambda: self.rates("r2", 1, "U1"),
            lambda: self.still("r3", 2, ("U2", "U3")),
            lambda: self.temperatures("r4", 3, "U1"),
            lambda: self.tested.document(checked),
            lambda: self.still("r1b", 0, ("U3",), power_ons=1),
        ]


def table_of(tested: Any) -> pa.Table:
    with tested.catalog() as catalog:
        return catalog.reader("select * from unit_metrics").read_all().combine_chunks()


def from_scratch(tested: Any) -> pa.Table:
    shutil.rmtree(tested.store.folder / "metrics")
    return table_of(tested)


# which growths come before a question, the units that it evaluates and the runs that it reduces
Growths = tuple[tuple[tuple[int, ...], list[str], list[str]], ...]
# of records of one step and of several runs, and of what was entered by hand
FEW = (
    "bias", "bias_repeatability", "bias_temperature_sensitivity", "scale_factor", "visual_check",
)  # fmt: skip
ONE_BY_ONE: Growths = (
    ((0,), ["U1", "U2"], ["r1"]),
    ((1,), ["U1"], ["r2"]),
    ((2,), ["U2", "U3"], ["r3"]),
    ((3,), ["U1"], ["r4"]),
    ((4,), ["U2"], []),
    ((5,), ["U3"], ["r1b"]),
)
TOGETHER: Growths = (
    ((0, 1, 3), ["U1", "U2"], ["r1", "r2", "r4"]),
    ((4,), ["U2"], []),
    ((2, 5), ["U2", "U3"], ["r1b", "r3"]),
)


@pytest.mark.in_gate("few")
@pytest.mark.parametrize(
    ("names", "growths", "each"),
    [(FEW, TOGETHER, 3), (tuple(metrics()), ONE_BY_ONE, 6), (tuple(metrics()), ONE_BY_ONE, 1)],
    ids=["few", "6", "1"],
)
def test_a_growing_store_has_the_metrics_of_one_computed_from_scratch(
    tested: Any, work: Work, monkeypatch: pytest.MonkeyPatch, names: tuple[str, ...], growths: Growths, each: int
) -> None:
    """Compared at the end, or after each growth; in the short form few metrics, and growths together."""
    monkeypatch.setattr(kept_metrics, "metrics", lambda: {name: metrics()[name] for name in names})
    grown = Bench(tested).grown()
    for number, (places, *changed) in enumerate(growths, start=1):
        for place in places:
            grown[place]()
        found = table_of(tested)
        assert work.done() == tuple(changed)
        if number % each:
            continue
        assert set(found["metric"].to_pylist()) <= set(names)
        kept = {path.name: path.read_bytes() for path in (tested.store.folder / "metrics").iterdir()}
        assert found.equals(from_scratch(tested))
        work.done()
        # what is kept is as it was grown, not as it was computed from scratch
        for name, content in kept.items():
            (tested.store.folder / "metrics" / name).write_bytes(content)
    values = {(row["metric"], row["unit"]) for row in found.to_pylist() if row["value"] is not None}
    assert {("scale_factor", "U1"), ("bias_repeatability", "U3"), ("visual_check", "U2")} <= values
    assert ("bias_temperature_sensitivity", "U1") in values


@pytest.mark.long
def test_a_metric_that_is_asked_for_alone_is_the_same_and_the_others_follow_when_they_are_needed(
    tested: Any, work: Work, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    compute = evaluation._values

    def computed(catalog: Any, metric: Any, *more: Any) -> pa.Table:
        asked.append(metric.header.id)
        return compute(catalog, metric, *more)

    monkeypatch.setattr(evaluation, "_values", computed)
    bench = Bench(tested)
    bench.still("r1", 0, ("U1", "U2"))
    bench.rates("r2", 1, "U1")

    def select(*names: str) -> list[dict[str, Any]]:
        with tested.catalog() as catalog:
            return selected(catalog, Selection(metrics=names))

    alone = select("bias")
    assert asked == ["bias"]
    assert select("bias") == alone
    assert asked == ["bias"]
    both = select("bias", "scale_factor")
    assert sorted(set(asked)) == ["bias", "scale_factor"]
    assert kept_findings(tested.store) == []
    with tested.catalog() as catalog:
        assert select_within(catalog, "bias") == alone
        whole = selected(catalog, Selection())
        assert [row for row in whole if row["metric"] in {"bias", "scale_factor"}] == both
        assert len({row["metric"] for row in whole}) > 2
    assert table_of(tested).equals(from_scratch(tested))


def select_within(catalog: Any, name: str) -> list[dict[str, Any]]:
    """Twice from one catalogue."""
    first = selected(catalog, Selection(metrics=(name,)))
    assert selected(catalog, Selection(metrics=(name,))) == first
    return first


@pytest.mark.long
def test_nothing_is_computed_where_nothing_changed_and_compaction_changes_nothing(tested: Any, work: Work) -> None:
    bench = Bench(tested)
    bench.still("r1", 0, ("U1",))
    first = table_of(tested)
    bench.rates("r2", 0, "U2")  # of the same day: parts that become one
    before = table_of(tested)
    assert before.num_rows > first.num_rows
    work.done()
    with builder_lock(tested.store):
        compacted = list(compact(Lake(tested.store), now_ns=START_NS + 400 * DAY_NS))
    assert compacted
    assert table_of(tested).equals(before)
    assert work.done() == ([], [])
    assert from_scratch(tested).equals(before)


@pytest.mark.long
def test_a_changed_specification_computes_every_unit_anew(tested: Any, work: Work) -> None:
    tested.product(SPECIFICATION.format(average_s=30.0))
    Bench(tested).still("r1", 0, ("U1", "U2"), power_ons=1)
    before = table_of(tested)
    work.done()
    tested.product(SPECIFICATION.format(average_s=50.0))
    after = table_of(tested)
    assert work.done() == (["U1", "U2"], [])
    assert not after.equals(before)
    assert after.equals(from_scratch(tested))
    tested.product(SPECIFICATION.format(average_s=30.0))
    assert table_of(tested).equals(before)


@pytest.mark.long
def test_a_unit_without_any_metric_is_not_evaluated_again(tested: Any, work: Work) -> None:
    tested.run("r1")
    values = {"pressure": (np.arange(20.0), "Pa")}
    tested.step("r1", "chamber", values, t0_ns=START_NS)
    assert table_of(tested).num_rows == 0
    assert work.done() == (["chamber"], ["r1"])
    assert table_of(tested).num_rows == 0
    assert work.done() == ([], [])


@pytest.mark.long
@pytest.mark.parametrize("damage", [b"", b"PAR1 no more", None])
def test_kept_metrics_that_cannot_be_read_are_computed_anew(tested: Any, damage: bytes | None) -> None:
    Bench(tested).rates("r1", 0, "U1")
    before = table_of(tested)
    path = tested.store.folder / "metrics" / "unit_metrics.parquet"
    if damage is None:  # of a version that kept other columns
        older = before.drop_columns(["freedom"])
        write_kept(path, older)
    else:
        path.write_bytes(damage)
    assert table_of(tested).equals(before)
