"""The lake with rows that only the log has: tables of documents change with such a document, and only then."""

from pathlib import Path

import pyarrow as pa
import pytest

from analytics.serve.live.follower import FloorFollower
from analytics.serve.live.fresh_views import FreshViews
from analytics.serve.live.rows import LiveRows, RowTables
from analytics.serve.shared_lake import SERVED, SharedLake
from storage.lake.quarantine import event_row
from storage.lake.tables import TABLES
from storage.recording.client import record_documents
from storage.sql.views import VIEWS
from storage.store import Store
from stream.events import AnyDocument, NoteAdded, RunStarted, UnitMounted, UnitReleased, Verdict, VerdictGiven
from stream.identity import Place

PLACE = Place("plant", "bench")
LATER_NS = 4 * 10**18
Rows = dict[str, list[tuple[object, ...]]]


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """A store whose lake has a unit with a verdict."""
    store = Store.create(tmp_path / "S")
    documents: list[AnyDocument] = [
        RunStarted(run="r1", t_ns=1, lot="L7"),
        UnitMounted(run="r1", t_ns=2, unit="U1", product="FOG"),
        VerdictGiven(run="r1", t_ns=3, unit="U1", verdict=Verdict.MARGINAL),
    ]
    record_documents(store, documents, role="test", place=PLACE, builds_lake=True)
    return store


def served(store: Store, monkeypatch: pytest.MonkeyPatch, *documents: AnyDocument) -> Rows:
    """All shared tables and views, beside a log that has such documents; of the lake alone without any."""
    rows = [event_row(PLACE, each, LATER_NS + number) for number, each in enumerate(documents)]
    events = pa.Table.from_pylist(rows, schema=TABLES["events"])
    live = FloorFollower(store)
    monkeypatch.setattr(live, "beyond", lambda in_lake: RowTables(TABLES["channels"].empty_table(), events))
    with SharedLake(store, lambda: "") as lake, FreshViews(lake, live, lake.state()) as views:
        names = [*(f"internal.{name}" for name in SERVED), *VIEWS, "internal.lake_documents"]
        return {name: views.rows(f"from {name} order by all") for name in names}


def test_without_documents_of_a_kind_its_tables_are_the_lakes(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    before, noted = (served(store, monkeypatch, *more) for more in ((), (NoteAdded(run="r1", t_ns=9, text="x"),)))
    assert before["internal.served_verdicts"] == noted["internal.served_verdicts"] != []
    assert before["internal.served_units"] == noted["internal.served_units"] != []
    assert len(noted["events"]) == len(before["events"]) + 1
    assert before["runs"] == noted["runs"] == noted["internal.served_runs"] != []


@pytest.mark.long
@pytest.mark.parametrize(
    ("document", "table"),
    [
        (VerdictGiven(run="r1", t_ns=9, unit="U1", verdict=Verdict.FAIL), "served_verdicts"),
        (UnitMounted(run="r1", t_ns=9, unit="U1", product="MEMS"), "served_units"),
        (RunStarted(run="r2", t_ns=9, lot="L8"), "served_runs"),
        (
            UnitReleased(run="r1", t_ns=9, unit="U1", verdict=Verdict.FAIL, planned_s=10.0, recorded_s=5.0),
            "served_releases",
        ),
    ],
)
def test_a_document_of_the_log_is_in_its_table(
    store: Store, monkeypatch: pytest.MonkeyPatch, document: AnyDocument, table: str
) -> None:
    before, after = served(store, monkeypatch), served(store, monkeypatch, document)
    assert {name for name in SERVED if before[f"internal.{name}"] != after[f"internal.{name}"]} >= {table}
    for name, view in (("served_units", "units"), ("served_runs", "runs"), ("served_signals", "signals")):
        assert sorted(after[f"internal.{name}"], key=str) == sorted(after[view], key=str)


def test_documents_have_a_number_of_their_own() -> None:
    rows = LiveRows()
    rows._new_events["1"] = [event_row(PLACE, RunStarted(run="r1", t_ns=1), 1)]
    rows._has_news = True
    rows.publish()
    assert (rows.documents, rows.version) == (1, 1)
    rows._has_news = True  # samples
    rows.publish()
    assert (rows.documents, rows.version) == (1, 2)
