"""An import that broke off anywhere is completed by the next; a run of somebody else is not ended by it."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from ingest.importing.file_sending import CheckedFile, FileImport
from ingest.importing.importer import import_files
from ingest.run.pipeline import EmbeddedPipeline
from ingest.tables.columns import TableOptions
from ingest.tables.file import TableFile
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.delivery.publisher import DurablePublisher
from stream.errors import BadInput
from stream.events import AnyDocument, RunEnded, RunStarted
from stream.identity import Place, event_key

PLACE = Place("plant", "bench")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A file with two steps."""
    n = 5000
    frame = pl.DataFrame(
        {"time[s]": np.arange(n) * 0.01, "step": ["cold"] * 2500 + ["hot"] * 2500, "rate[deg/s]": np.arange(n) * 0.5}
    )
    frame.write_parquet(tmp_path / "r1.parquet")
    return tmp_path / "r1.parquet"


def imported(path: Path, folder: Path) -> FileImport:
    table = TableFile(path, TableOptions(unit="U1"))
    (imported,) = import_files([CheckedFile(path, table, table.check(), 0.0)], folder, PLACE)
    return imported


def outcome(folder: Path) -> list[tuple[object, ...]]:
    with Catalog(Store.open(folder)) as catalog:
        steps = catalog.rows("select count(*), count(t_end_ns) from steps")
        return [*catalog.rows("select outcome, samples from runs"), *steps]


class PowerLoss(Exception):
    """Stands for the moment at which the process ends."""


@pytest.mark.in_gate("StepEnded")
@pytest.mark.parametrize("kind", ["RunStarted", "StepStarted", "StepEnded", "NoteAdded", "RunEnded"])
def test_an_import_that_broke_off_is_completed(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    send = DurablePublisher.send_event

    def break_off(publisher: DurablePublisher, key: str, document: AnyDocument) -> None:
        if type(document).__name__ == kind:
            raise PowerLoss
        send(publisher, key, document)

    folder = tmp_path / "store"
    monkeypatch.setattr(DurablePublisher, "send_event", break_off)
    with pytest.raises(PowerLoss):
        imported(path, folder)
    monkeypatch.undo()
    result = imported(path, folder)
    assert result.signals[0].in_lake == 5000
    assert outcome(folder) == [("completed", 5000), (2, 2)]
    assert imported(path, folder).added == 0
    assert outcome(folder) == [("completed", 5000), (2, 2)]


@pytest.mark.parametrize("digits", [pytest.param(6, marks=pytest.mark.long), 3])
def test_irregular_samples_with_fewer_digits_are_not_there_twice(tmp_path: Path, digits: int) -> None:
    rng = np.random.default_rng(5)
    times, values = np.cumsum(rng.exponential(0.1, 500)) + 0.01 * np.arange(500), rng.normal(0, 1, 500)

    def written(places: int, step: float = 0.0) -> Path:
        path = tmp_path / f"r{places}{step}.csv"
        rows = [f"{t + step:.{places}f},{x!r}" for t, x in zip(times.tolist(), values.tolist(), strict=True)]
        path.write_text("time[s],rate[deg/s]\n" + "\n".join(rows) + "\n")
        return path

    def sent(path: Path) -> FileImport:
        table = TableFile(path, TableOptions(unit="U1", run="r"))
        (found,) = import_files([CheckedFile(path, table, table.check(), 0.0)], tmp_path / "store", PLACE)
        return found

    assert sent(written(9)).added == 500
    with pytest.raises(BadInput, match="the same values at slightly other times"):
        sent(written(digits))
    assert sent(written(9)).added == 0


@pytest.mark.long
def test_a_run_that_is_still_going_on_elsewhere_is_not_ended(path: Path, tmp_path: Path) -> None:
    folder = tmp_path / "store"
    with EmbeddedPipeline(folder, "test") as pipeline:
        started = RunStarted(run="r1", t_ns=0, date_known=False, source="station")
        pipeline.send_event(event_key(PLACE), started)
        pipeline.finish()
    imported(path, folder)
    assert outcome(folder)[0] == ("open", 5000)
    with EmbeddedPipeline(folder, "test") as pipeline:
        pipeline.send_event(event_key(PLACE), RunEnded(run="r1", t_ns=50 * 10**9))
        pipeline.finish()
    assert outcome(folder)[0] == ("completed", 5000)
