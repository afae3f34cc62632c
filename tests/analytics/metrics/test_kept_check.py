"""Verify looks at the metrics that a store keeps, and goes on where a file of the lake cannot be read."""

import hashlib
import shutil
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from analytics.evaluation.kept_check import kept_findings
from storage.check.recover import recover
from storage.check.verify import verify
from storage.sql.catalog import Catalog
from storage.store import Store
from tests.analytics.conftest import TestedUnits

T0_NS = 1_763_683_200 * 10**9
ASKED = "select unit, metric, value from unit_metrics where value is not null order by all"


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store of two units at rest for an hour, their metrics computed and kept."""
    tested = TestedUnits(tmp_path_factory.mktemp("kept") / "store")
    tested.run("r1", t_ns=T0_NS, procedure="static_bias")
    for i, unit in enumerate(("FOG-1", "FOG-2")):
        values = i + 0.1 * np.random.default_rng(i).standard_normal(3600)
        tested.step("r1", unit, values, t0_ns=T0_NS, dt_ns=10**9, procedure="static_bias", position="IRA_east")
    with tested.catalog() as catalog:
        assert catalog.rows(ASKED)
    tested.release()
    return tested.store.folder


@pytest.fixture
def store(filled: Path, tmp_path: Path) -> Store:
    shutil.copytree(filled, tmp_path / "store")
    return Store.open(tmp_path / "store")


def rewrite(path: Path, column: str, *, with_hash: bool) -> None:
    """Other values under the same description, as a spreadsheet or a script would leave them."""
    table = pq.read_table(path)
    at = table.schema.get_field_index(column)
    known = np.flatnonzero(table[column].is_valid().to_numpy())
    is_last = pa.array(np.arange(len(table)) == known[-1])
    pq.write_table(
        table.set_column(at, column, pc.if_else(is_last, pc.multiply(table[column], 0.01), table[column])), path
    )
    if with_hash:
        path.with_name(path.name + ".sha256").write_text(hashlib.sha256(path.read_bytes()).hexdigest())


@pytest.mark.long
def test_a_file_that_is_not_what_was_written_is_not_believed(store: Store) -> None:
    path = store.folder / "metrics" / "unit_metrics.parquet"
    with Catalog(store) as catalog:
        before = catalog.rows(ASKED)
    rewrite(path, "value", with_hash=False)
    (found,) = kept_findings(store)
    assert (found.kind, found.where) == ("kept_damaged", str(path))
    with Catalog(store) as catalog:
        assert catalog.rows(ASKED) == before
    assert kept_findings(store) == []


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "column", "what"),
    [
        ("unit_metrics.parquet", "value", "unit FOG-2: "),
        pytest.param("steps.parquet", "mean", "run r1: ", marks=pytest.mark.long),
    ],
)
def test_values_that_do_not_follow_from_the_lake_are_found(store: Store, name: str, column: str, what: str) -> None:
    path = store.folder / "metrics" / name
    rewrite(path, column, with_hash=True)
    found = [each for each in verify(store)[0].findings if each.kind == "kept_damaged"]
    assert [(each.where, each.what.startswith(what)) for each in found] == [(str(path), True)]
    assert [action.what for action in recover(store)] == ["kept_set_aside"]
    assert not path.exists()
    assert kept_findings(store) == []


def test_a_damaged_file_of_documents_does_not_hide_the_rest(store: Store) -> None:
    segment = max(store.log.glob("*.mcap"), key=lambda each: each.stat().st_size)
    segment.write_bytes(segment.read_bytes()[:-1] + b"x")
    for path in sorted(store.lake.glob("*/events.parquet")):
        content = bytearray(path.read_bytes())
        content[4 : len(content) // 2] = bytes(len(content) // 2 - 4)
        path.write_bytes(content)
    found = {each.kind for each in verify(store)[0].findings}
    assert {"segment_damaged", "lake_damaged"} <= found
    assert "check_failed" in found  # the metrics, which stand on the documents
