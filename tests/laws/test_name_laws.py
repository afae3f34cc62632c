"""Names of units, signals, runs and places are identities: at every border they are refused, or are text."""

import csv
import re
import time
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote
from uuid import UUID
from xml.etree import ElementTree as ET

import httpx
import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from prometheus_client.exposition import generate_latest
from prometheus_client.parser import text_string_to_metric_families
from prometheus_client.registry import Collector, CollectorRegistry

from analytics.alerts.targets import clean, one_line
from analytics.loop.model.model_registry import ModelRegistry
from ingest.tables.columns import TableOptions
from ingest.tables.file import TableFile
from storage.log.event_log import EventLog
from storage.recording.intake import Intake
from storage.segments.reader import SegmentScan
from storage.segments.records import REJECTED
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.batch import SampleBatch
from stream.errors import BadInput
from stream.events import NoteAdded, encode_event
from stream.identity import Place, check_name, cleaned_name, event_key, is_name, sample_key
from stream.security.certificate_authority import Site
from stream.security.rights import Role
from stream.status.endpoint import families
from stream.status.role_status import Role as StatusRole
from stream.status.role_status import RoleState, RunProgress, new_status
from stream.terminal.console import csv_text, shown_text
from stream.terminal.plain_console import PlainConsole
from stream.wire.batches import encode_batch
from tests.analytics.serve.conftest import TOKEN, start
from tests.forked_commands import CommandServer
from tests.hostile_names import FORMULA, KEPT, REFUSED
from tests.live_runs import COEFFICIENTS, TEXT, version

PLACE = Place("plant", "bench")
ROWS = 20
Run = Callable[..., Any]


def table(path: Path, unit: str, run: str, signal: str = "rate") -> Path:
    n = ROWS
    columns = {
        "time[s]": np.arange(n) / 10.0,
        f"{signal}[deg/s]": np.arange(n) % 3.0,
        "unit": [unit] * n,
        "run": [run] * n,
    }
    pq.write_table(pa.table({**columns, "procedure": ["static_bias"] * n}), path)
    return path


def batch(unit: str, signal: str, run: str, seq: int = 0) -> bytes:
    counts = np.arange(5, dtype=np.int32)
    return encode_batch(SampleBatch(unit, signal, run, UUID(int=1), seq, 10**18 + seq, 10**7, "deg/s", counts=counts))


@pytest.mark.parametrize("why", REFUSED)
def test_what_is_no_name_is_refused_in_a_sentence(why: str) -> None:
    name = REFUSED[why]
    assert not is_name(name)
    with pytest.raises(BadInput, match="cannot be used as a name") as refused:
        check_name("unit", name)
    assert str(refused.value).isprintable()
    assert not cleaned_name(name) or is_name(cleaned_name(name)[:128])


@pytest.mark.parametrize("name", KEPT)
def test_what_only_looks_dangerous_is_a_name(name: str) -> None:
    assert check_name("unit", name) == name
    assert cleaned_name(name) == name


@pytest.mark.parametrize("why", [why for why, name in REFUSED.items() if name and "\ud800" not in name])
@pytest.mark.parametrize("part", ["unit", "run", "signal"])
def test_a_file_with_such_a_name_is_refused(tmp_path: Path, why: str, part: str) -> None:
    names = {"unit": "G-1", "run": "r1", "signal": "rate"} | {part: REFUSED[why]}
    path = tmp_path / "all.parquet"
    table(path, **names)
    if part != "signal":
        with pytest.raises(BadInput, match=r"all\.parquet"):
            TableFile(path, TableOptions()).check()
        return
    try:
        (found,) = TableFile(path, TableOptions()).check().signals
    except BadInput as error:
        assert "all.parquet" in str(error)  # noqa: PT017  a title is text, of which a name may be made
    else:
        assert is_name(found.signal)


class Arrived:
    """A recorder's intake, and what it has rejected."""

    def __init__(self, folder: Path) -> None:
        self.store = Store.create(folder)
        self.log = EventLog(self.store)
        self.intake = Intake(self.log, self.store)

    def rejected(self) -> list[str]:
        self.log.seal()
        segments = sorted(self.store.log.glob("*.mcap"))
        return [each.topic for path in segments for each in SegmentScan(path, sealed=True) if each.schema == REJECTED]


def test_the_bus_rejects_and_keeps_what_has_no_name(tmp_path: Path) -> None:
    arrived = Arrived(tmp_path / "s")
    wrong = [name for name in REFUSED.values() if name and "\ud800" not in name and len(name) < 128]
    sent = 0
    for name in wrong:
        for unit, signal, run in ((name, "rate", "r"), ("U", name, "r"), ("U", "rate", name)):
            arrived.intake.add(sample_key(PLACE, unit, signal), batch(unit, signal, run), 10**18)
            sent += 1
        arrived.intake.add(
            event_key(PLACE._replace(station=name)), encode_event(NoteAdded(run="r", t_ns=0, text="x"), "e", 0), 1
        )
        arrived.intake.add(event_key(PLACE), encode_event(NoteAdded(run=name, t_ns=0, text="x"), "e", 0), 1)
        sent += 2
    assert arrived.intake.counts.rejected == sent
    assert len(arrived.rejected()) == sent


def test_the_bus_takes_every_name(tmp_path: Path) -> None:
    arrived = Arrived(tmp_path / "s")
    for name in KEPT:
        arrived.intake.add(sample_key(PLACE, name, "rate"), batch(name, "rate", name), 10**18)
    assert arrived.intake.counts.samples == 5 * len(KEPT)
    assert list(arrived.intake.counts.rejections) == []


@pytest.mark.parametrize("why", [why for why, name in REFUSED.items() if "\ud800" not in name])
def test_no_folder_is_made_of_what_is_no_name(tmp_path: Path, why: str) -> None:
    name = REFUSED[why]
    store = Store.create(tmp_path / "s")
    with pytest.raises(BadInput):
        ModelRegistry(store).add(msgspec.structs.replace(version(TEXT, COEFFICIENTS), unit=name))
    site = Site.create(tmp_path / "site")
    with pytest.raises(BadInput):
        site.add(Role.STATION, name, days=1.0)
    assert {path.name for path in tmp_path.iterdir()} == {"s", "site"}


def test_a_folder_of_every_name_lies_where_it_belongs(tmp_path: Path) -> None:
    store = Store.create(tmp_path / "s")
    registry = ModelRegistry(store)
    for name in KEPT:
        registry.add(msgspec.structs.replace(version(TEXT, COEFFICIENTS), unit=name))
        assert [each.unit for each in registry.versions(name)] == [name]
    assert sorted(registry.units()) == sorted(KEPT)
    assert {path.name for path in tmp_path.iterdir()} == {"s"}


def test_the_terminal_and_a_mail_show_no_control_character() -> None:
    for name in [*REFUSED.values(), *KEPT]:
        for shown in (shown_text(f"unit {name}"), one_line(name), clean(name)):
            assert not re.search("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]", shown)
        assert "\n" not in one_line(name)
    console = PlainConsole(force_terminal=True, color_system="truecolor", width=60)
    with console.capture() as captured:
        console.print("[red]FOG[/red]\x1b[31m\u202e")
    assert captured.get() == "[red]FOG[/red]\\x1b[31m\\u202e\n"


def test_no_cell_begins_as_a_formula() -> None:
    for name in [*KEPT, *(f"{sign}x" for sign in FORMULA)]:
        cell = csv_text(name)
        assert not cell.startswith(FORMULA)
        assert cell in (name, f"'{name}")


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory, run_command: Run) -> Path:
    """A store whose units and runs have all these names."""
    folder = tmp_path_factory.mktemp("names")
    tables = [pq.read_table(table(folder / "one.parquet", name, name)) for name in KEPT]
    pq.write_table(pa.concat_tables(tables), folder / "all.parquet")
    done = run_command("import", "all.parquet", "--start", "2026-11-21T18:00:00Z", "--store", "S", cwd=folder)
    assert done.code == 0, done.err
    return folder / "S"


@pytest.fixture
def ask(store: Path, run_command: Run) -> Run:
    def asked(*words: object) -> Any:
        done = run_command(*words, "--store", "S", cwd=store.parent)
        assert done.code == 0, done.err
        assert not re.search("[\x00-\x08\x0b-\x1f\x7f-\x9f]", done.out)
        return done

    return asked


def test_no_file_of_a_store_is_named_by_a_unit_or_run(store: Path) -> None:
    """Not of the log, the lake or what is kept of it: partitions go by numbers."""
    paths = [str(path.relative_to(store)) for path in store.rglob("*")]
    assert len(paths) > 10
    assert [path for path in paths if not re.fullmatch(r"[\w./-]+", path)] == []


def test_sql_gives_every_name_as_it_is(ask: Run) -> None:
    asked = ask("sql", "select distinct unit, run from samples order by unit", "--json")
    assert [row["unit"] for row in asked.json if row["unit"] == row["run"]] == sorted(KEPT)


def test_csv_of_sql_has_no_formula(ask: Run) -> None:
    lines = list(csv.reader(ask("sql", "select distinct unit from samples order by unit", "--csv").out.splitlines()))
    assert [line[0] for line in lines[1:]] == [csv_text(name) for name in sorted(KEPT)]


def test_a_statement_is_not_changed_by_a_name(store: Path) -> None:
    """Names in statements of the project's own are literals: one finds its rows, and no others."""
    for name in ("O'Brien\";--", "');drop-table-x;--", "%s%n%x", 'a"b', "null"):
        with Catalog(Store.open(store), units=[name]) as catalog:
            assert catalog.rows("select distinct unit from samples") == [(name,)]


@pytest.mark.parametrize("form", ["csv", "xlsx"])
def test_metrics_are_text_in_spreadsheets(ask: Run, store: Path, form: str) -> None:
    path = store.parent / f"metrics.{form}"
    ask("metrics", f"--{form}", path)
    if form == "csv":
        with path.open(encoding="utf-8-sig", newline="") as file:
            cells = [cell for row in csv.reader(file) for cell in row]
        assert [cell for cell in cells if csv_text(cell) != cell] == []
        assert {csv_text(name) for name in KEPT} <= set(cells)
        return
    with zipfile.ZipFile(path) as book:
        sheet = ET.fromstring(book.read("xl/worksheets/sheet1.xml"))
        texts = ET.fromstring(book.read("xl/sharedStrings.xml"))
    assert [each.tag for each in sheet.iter() if each.tag.endswith(("}f", "}hyperlink"))] == []
    assert set(KEPT) <= {each.text for each in texts.iter() if each.tag.endswith("}t")}


def test_tables_name_every_unit(ask: Run) -> None:
    shown = ask("metrics").out
    assert [name for name in KEPT if name not in shown] == []


@pytest.mark.in_gate("=1+1")
@pytest.mark.parametrize("name", ["=1+1", "-rf", "O'Brien\";--", "<svg-onload=alert(1)>"])
def test_an_audit_is_text_in_spreadsheets(ask: Run, store: Path, name: str) -> None:
    path = store.parent / "audit.csv"
    ask("audit", "--unit", name, "--csv", path)
    cells = [cell for row in csv.reader(path.read_text("utf-8-sig").splitlines()) for cell in row]
    assert [cell for cell in cells if csv_text(cell) != cell] == []


@pytest.mark.in_gate("path", "markup")
@pytest.mark.parametrize(
    "name",
    ["a..%2f..%2fetc", "<svg-onload=alert(1)>", "--help", "{0.__class__}"],
    ids=["path", "markup", "option", "template"],
)
def test_a_picture_of_any_name_is_where_it_was_asked_for(ask: Run, store: Path, name: str) -> None:
    before = set(store.parent.iterdir())
    ask("allan", f"--unit={name}", f"--run={name}", "--signal", "rate", "--plot", store.parent / "plot.svg")
    assert set(store.parent.iterdir()) - before <= {store.parent / "plot.svg"}
    assert "<svg-onload" not in (store.parent / "plot.svg").read_text()


def test_iceberg_has_no_name_in_a_path(ask: Run, store: Path) -> None:
    warehouse = store.parent / "W"
    ask("export-iceberg", "--warehouse", warehouse)
    paths = [str(path.relative_to(warehouse)) for path in warehouse.rglob("*")]
    assert [path for path in paths if not re.fullmatch(r"[\w./-]+", path)] == []


@pytest.fixture(scope="module")
def pages(store: Path, command_server: CommandServer) -> Iterator[httpx.Client]:
    words = ("--store", "S", "--port", "0", "--token", TOKEN)
    process, ready = start(command_server, *words, cwd=store.parent)
    try:
        with httpx.Client(base_url=ready["url"], headers={"Authorization": f"Bearer {TOKEN}"}, timeout=60.0) as client:
            yield client
    finally:
        process.kill()
        process.communicate()


PAGES = ("/units", "/runs", "/units/{}", "/runs/{}", "/signals/{}/{}/rate", "/events?run={}", "/diagnosis/{}")
# a path, an option, a quote with a query, a template, a parameter, and what Unicode may compose
ODDEST = ("a..%2f..%2fetc", "--help", "O'Brien\";--", "{0.__class__}", "&lt;b&gt;", "a\u0301")
MARKUP = ("<svg-onload=alert(1)>", '"};alert(1)', "&lt;b&gt;", "{{7-7}}", "{%x%}", "=1+1", 'a"b')


@pytest.mark.parametrize("names", [MARKUP[:2], pytest.param(MARKUP[2:], marks=pytest.mark.long)], ids=["two", "others"])
@pytest.mark.parametrize("path", PAGES)
def test_a_page_shows_names_as_text(pages: httpx.Client, path: str, names: tuple[str, ...]) -> None:
    for name in names if "{}" in path else names[:1]:
        answer = pages.get(path.format(*[quote(name, safe="")] * 2), headers={"Accept": "text/html"})
        assert answer.status_code == 200, (path, name, answer.text[-300:])
        assert "<svg-onload" not in answer.text
        assert '"};alert(1)' not in answer.text
        assert answer.headers["content-security-policy"]


@pytest.mark.parametrize("names", [ODDEST, pytest.param(KEPT, marks=pytest.mark.long)], ids=["oddest", "every"])
def test_the_api_gives_every_name_as_it_is(pages: httpx.Client, names: tuple[str, ...]) -> None:
    for name in names:
        quoted = quote(name, safe="")
        found = pages.get(f"/api/units/{quoted}")
        assert (found.status_code, found.headers["content-type"]) == (200, "application/json")
        assert found.json()["unit"] == name
        assert pages.get(f"/api/runs/{quoted}").json()["run"]["run"] == name
    lines = pages.get("/api/units", params={"format": "csv", "limit": 1000}).text.splitlines()
    cells = [cell for row in csv.reader(lines) for cell in row]
    assert [cell for cell in cells if csv_text(cell) != cell] == []


def test_prometheus_reads_labels_of_any_name() -> None:
    names = [*KEPT, *(each for each in REFUSED.values() if "\ud800" not in each and len(each) < 128)]

    class Names(Collector):
        def collect(self) -> Any:
            return families(
                new_status(
                    StatusRole.RUN, time.time_ns(), state=RoleState.WORKING, numbers={"lag_seconds": 1.0},
                    run=RunProgress(run=name, step=1, steps=2),
                )
                for name in names
            )  # fmt: skip

    registry = CollectorRegistry()
    registry.register(Names())
    text = generate_latest(registry).decode()
    found = {sample.labels["run"] for family in text_string_to_metric_families(text) for sample in family.samples}
    assert found == set(names)
