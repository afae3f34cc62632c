"""An extension with a mistake is named, and claims nothing."""

from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from analytics.evaluation import evaluation
from analytics.evaluation.reasons import in_chinese
from analytics.loop.blocks.run_blocks import Channel, RunBlocks
from analytics.loop.effects import registry
from analytics.loop.effects.base import Effect, Shape
from analytics.loop.effects.monomial import channel_linear
from analytics.metric_registry import registry as metric_registry
from analytics.metric_registry.failed_metrics import remarks_on_failed
from analytics.metric_registry.registry import (
    BoundsSource,
    Clause,
    Influence,
    Metric,
    MetricError,
    metrics,
    parse_header,
)
from analytics.step_records.step_table import step_means
from storage.sql.catalog import Catalog, NotKept
from storage.store import Store
from stream.errors import BadInput, QueryError
from stream.files.own_files import files_of


@pytest.mark.parametrize(("lo", "hi"), [(2.9, 3.1), (7.0, 5.0), (6.1, None), (None, 5.9)])
def test_an_interval_that_does_not_contain_the_value_is_a_mistake(lo: float | None, hi: float | None) -> None:
    columns = {name: pa.array([None, None], pa.float64()) for name in ("standard_uncertainty", "freedom")} | {
        "value": pa.array([6.0, 6.0]), "lo": pa.array([lo, 5.0], pa.float64()), "hi": pa.array([hi, 7.0], pa.float64()),
        "reason": pa.array([None, None], pa.string()),
    }  # fmt: skip
    evaluation._add_bounds(columns, BoundsSource.GIVEN)
    assert columns["value"].to_pylist() == [None, 6.0]
    assert columns["lo"].to_pylist() == [None, 5.0]
    wrong, right = columns["reason"].to_pylist()
    assert (right, "does not contain the value" in wrong) == (None, True)


def test_a_metric_that_fails_is_named_and_what_is_no_mistake_of_it_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(error: Exception) -> Any:
        def compute(*_: object) -> pa.Table:
            raise error

        return compute

    for own in (IndexError("index 9"), QueryError("Parser Error: near ( (views: samples)")):
        monkeypatch.setattr(evaluation, "_computed", failing(own))
        with pytest.raises(QueryError, match=r"metric bias cannot be computed: .*analytics/metrics/bias.sql") as found:
            evaluation._found(SimpleNamespace(), metrics()["bias"])  # type: ignore[arg-type]
        assert "views" not in str(found.value)
    for other in (NotKept(), MemoryError(), BadInput("of the store")):
        monkeypatch.setattr(evaluation, "_computed", failing(other))
        with pytest.raises(type(other)):
            evaluation._found(SimpleNamespace(), metrics()["bias"])  # type: ignore[arg-type]


@pytest.mark.parametrize("where", ["of", "influence"])
def test_a_mistake_in_the_header_of_a_metric_names_it(tmp_path: Path, where: str) -> None:
    step = {
        "run": "r1", "unit": "U1", "signal": "rate", "index": 1, "date_known": True, "t_start_ns": 0, "t_from_ns": 0,
        "t_to_ns": 3600 * 10**9, "duration_s": 3600.0, "procedure": "static_bias", "unit_of_measure": "deg/h",
        "n": 36_000, "mean": 1.0, "sd": 2.0, "freedom": 30.0, "standard_uncertainty": 0.01, "sd_freedom": 900.0,
    }  # fmt: skip
    bias = metrics()["bias"]
    wrong = bias.header._replace(of="internal.bias_stepss")
    if where == "influence":
        quantities = (*bias.header.influences, Influence("temperature", "per_ppmm(value)"))
        wrong = bias.header._replace(influences=quantities)
    with Catalog(Store.create(tmp_path / "S")) as catalog:
        catalog._unfilled.clear()  # else it would fill itself
        evaluation.define_views(catalog, pa.Table.from_pylist([step], schema=step_means(catalog).schema))
        assert evaluation.evaluate(catalog, [bias]).num_rows
        with pytest.raises(QueryError, match=r"metric bias cannot be computed: .*(bias_stepss|per_ppmm)"):
            evaluation.evaluate(catalog, [Metric(wrong, bias.sql)])
        # one of the site's own costs no other metric its values, and is named by its file
        own = wrong._replace(id="own_bias", python="analytics.metrics.own_bias:compute" if where == "influence" else "")
        found = evaluation.evaluate(catalog, [bias, Metric(own, bias.sql, "/srv/own/metrics/own_bias.sql")]).to_pylist()
        values = {row["metric"]: (row["unit"], row["run"], row["value"], row["reason"]) for row in found[::-1]}
        assert values["bias"][2:] == (1.0, None)
        assert values["own_bias"][:3] == ("U1", "r1", None)
        assert values["own_bias"][3].startswith("metric own_bias cannot be computed: ")
        assert "/srv/own/metrics/own_bias.sql" in values["own_bias"][3]
        assert in_chinese(values["own_bias"][3]).startswith("特性 own_bias 无法计算：")
        assert next(remarks_on_failed(catalog, found), "") == ""  # of no registered metric


def test_a_malformed_file_of_the_sites_own_is_named_and_leaves_all_metrics(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wrong = tmp_path / "own_bias.sql"
    wrong.write_text("-- id: own_bias\nselect 1")
    monkeypatch.setattr(metric_registry, "files_of", lambda package: [*files_of(package), wrong])
    with pytest.raises(MetricError, match="its header lacks en, zh"):  # of the program's
        metric_registry._registered.__wrapped__()
    monkeypatch.setattr(metric_registry, "is_own", lambda _, file: file == wrong)
    known, unreadable = metric_registry._registered.__wrapped__()
    assert known.keys() == metrics().keys()
    assert unreadable[str(wrong)].startswith(f"metric {wrong}: its header lacks en, zh")
    monkeypatch.setattr(metric_registry, "_registered", lambda: (known, unreadable))
    with pytest.raises(BadInput, match=r"'own_bias' cannot be read: metric .*own_bias\.sql: its header lacks"):
        metric_registry.check_metrics(["own_bias"])


@pytest.mark.parametrize(
    ("metric", "without", "more", "word"),
    [("bias", set(), {"raeson"}, "'raeson'"), ("scale_factor_asymmetry", {"hi"}, set(), "no column hi")],
)
def test_a_column_that_nothing_reads_or_that_is_missing_is_named(
    metric: str, without: set[str], more: set[str], word: str
) -> None:
    names = {*evaluation.COLUMNS.names, *more} - without
    with pytest.raises(QueryError, match=word):
        evaluation._check_columns(metrics()[metric], names)
    evaluation._check_columns(metrics()[metric], evaluation.COLUMNS.names)


def test_a_metric_of_ones_own_house_names_its_document() -> None:
    statement = files("analytics.metrics").joinpath("bias.sql").read_text(encoding="utf-8")
    source = next(line for line in statement.splitlines() if line.startswith("-- source:"))
    own = parse_header(statement.replace(source, "-- source:    ACME QP-07 4.2; GJB 2426A-2004 5.12.1 (19)"), "bias")
    assert own.sources == (Clause("ACME", "QP-07 4.2"), Clause("GJB2426A", "5.12.1 (19)", "2004"))
    with pytest.raises(MetricError, match="ACME QP-07"):
        parse_header(statement.replace(source, "-- source:    our own"), "bias")


def test_two_effects_of_one_name_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "_effects_in", lambda _: [channel_linear("pressure")])
    with pytest.raises(BadInput, match="give one of them another name"):
        registry.effects.__wrapped__()  # not the kept ones


def test_an_own_effect_takes_the_place_of_the_general_one_of_its_channel(monkeypatch: pytest.MonkeyPatch) -> None:
    own = channel_linear("pressure")
    own.name = "ambient_pressure"
    known = {**registry.effects(), own.name: own}
    runs: Any = [SimpleNamespace(channels=dict.fromkeys(("pressure", "compressor"), np.zeros(1)))]
    assert {"channel:pressure", "channel:compressor"} <= registry._candidates(runs).keys()
    monkeypatch.setattr(registry, "effects", lambda: known)
    found = registry._candidates(runs)
    assert "ambient_pressure" in found
    assert "channel:compressor" in found
    assert "channel:pressure" not in found


def _raises(self: Effect, run: RunBlocks, shape: Shape) -> Any:
    return run.mean("presure")


@pytest.mark.parametrize(
    ("regressors", "word"),
    [
        (_raises, "fails with KeyError: 'presure'"),
        (lambda self, run, shape: run.mean("pressure"), r"float64 of shape \(3,\); .* \(3, 1\)"),
        (lambda self, run, shape: [[1.0]] * 3, "gives list"),
        (lambda self, run, shape: np.full((3, 1), "1"), "<U1"),
    ],
)
def test_an_effect_that_fails_or_gives_other_columns_is_named(regressors: Any, word: str) -> None:
    class Own(Effect):
        name = "ambient_pressure"
        needs = ("pressure",)

        def simulate(self, time_s: Any, channels: Any, coefficients: Any, shape: Shape) -> Any:
            return channels["pressure"] * coefficients[0]

    own = type("Faulty", (Own,), {"regressors": regressors, "__module__": __name__})()
    ones = np.ones(3)
    run = RunBlocks(
        "FOG-1", "r1", "rate", np.arange(3), 30.0, 0, ones, np.ones(3, np.int64), ones, "deg/h",
        {"pressure": Channel(ones, ones, "hPa")},
    )  # fmt: skip
    with pytest.raises(BadInput, match=rf"effect 'ambient_pressure' .*FOG-1, run r1: .*{word}"):
        own.regressors(run, {})
