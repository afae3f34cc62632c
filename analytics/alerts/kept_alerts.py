"""The file of a store's alerts: a small SQLite database, so that one change among 10,000 alerts writes one row."""

import sqlite3
from collections.abc import Iterable, Mapping
from contextlib import closing
from pathlib import Path

import msgspec

from storage.store import Store
from stream.closing import Closing
from stream.decoding import json_decoder
from stream.errors import StoreError
from stream.events import AlertCleared, AlertRaised, AlertSent

FOLDER = "alerts"
_FILE = "alerts.db"
_FORMAT = 1
_PATIENCE_S = 10.0
_TABLES = """
create table if not exists alerts (id text primary key, content blob not null) without rowid;
create table if not exists to_log (number integer primary key, content blob not null);
create table if not exists state (name text primary key, content text not null) without rowid;
"""
_PUT = {
    "alerts": "insert or replace into alerts values (?, ?)",
    "to_log": "insert or replace into to_log values (?, ?)",
    "state": "insert or replace into state values (?, ?)",
}
# errors of the disk, which say nothing of the content
_OF_DISK = {
    sqlite3.SQLITE_BUSY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_READONLY
}  # fmt: skip
LogDocument = AlertRaised | AlertCleared | AlertSent


class Delivery(msgspec.Struct, kw_only=True):
    """One message to one target; `sent_ns` is None until the target has taken it.

    `mail` is what it is sent together with, `taken` are the addresses that have it already.
    """

    target: str
    event: str
    mail: str = ""
    taken: tuple[str, ...] = ()
    attempts: int = 0
    due_ns: int = 0
    sent_ns: int | None = None
    error: str = ""


class Alert(msgspec.Struct, kw_only=True):
    """An alert; `since_ns` is since when its condition lasts, `raised_ns` when it was first reported."""

    id: str
    rule: str
    severity: str
    key: str
    subject: str
    text: str
    text_zh: str
    since_ns: int
    is_event: bool
    unit: str | None = None
    seen_ns: int = 0
    raised_ns: int | None = None
    cleared_ns: int | None = None
    ending: str | None = None  # how it ended without passing; empty if it passed, None while nobody has asked
    ending_zh: str = ""
    acknowledged_ns: int | None = None
    acknowledged_by: str = ""
    deliveries: list[Delivery] = []


class Kept(msgspec.Struct, kw_only=True):
    """What is kept: alerts by id, documents for the log by number, the segment before which all of it was looked at."""

    alerts: dict[str, Alert] = {}
    to_log: dict[int, LogDocument] = {}
    segment: str = ""


def read_alerts(store: Store) -> Kept:
    """What is kept of a store's alerts, beside whoever writes it; StoreError if it cannot be read."""
    path = store.folder / FOLDER / _FILE
    if not path.exists():
        return Kept()
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=_PATIENCE_S)) as base:
            return _kept(base)
    except (sqlite3.Error, msgspec.MsgspecError, OSError, RecursionError, UnicodeDecodeError) as error:
        raise _unreadable(path, error) from error


def raised_alerts(store: Store) -> list[Alert]:
    """The alerts that were raised, the newest first."""
    found = [(each.raised_ns, each) for each in read_alerts(store).alerts.values() if each.raised_ns is not None]
    return [each for _, each in sorted(found, key=lambda pair: -pair[0])]


class AlertFile(Closing):
    """The file of alerts for the process that keeps them; for one thread at a time.

    Raises StoreError if it cannot be opened, read or written.
    """

    def __init__(self, store: Store) -> None:
        self._path = store.folder / FOLDER / _FILE
        try:
            self._path.parent.mkdir(exist_ok=True)
            self._base = sqlite3.connect(self._path, timeout=_PATIENCE_S, check_same_thread=False)
        except (sqlite3.Error, OSError) as error:
            raise _unwritable(self._path, error) from error
        try:
            self._base.execute("pragma synchronous = full")
            if self._base.execute("pragma user_version").fetchone() == (0,):  # else it may be on a full disk
                self._base.executescript(f"{_TABLES} pragma user_version = {_FORMAT};")
            self.kept = _kept(self._base)
        except (sqlite3.Error, msgspec.MsgspecError, RecursionError, UnicodeDecodeError) as error:
            self._base.close()
            of_disk = getattr(error, "sqlite_errorcode", 0) & 0xFF in _OF_DISK
            raise (_unwritable if of_disk else _unreadable)(self._path, error) from error

    def write(self, alerts: Mapping[str, Alert | None], to_log: Mapping[int, LogDocument | None], segment: str) -> None:
        """Write alerts and documents that have changed, all or nothing, durably; None removes one."""
        encode = msgspec.json.encode
        gone = [(name,) for name, alert in alerts.items() if alert is None]
        logged = [(number,) for number, document in to_log.items() if document is None]
        try:
            with self._base:
                self._put("alerts", ((name, encode(each)) for name, each in alerts.items() if each is not None))
                self._put("to_log", ((number, encode(each)) for number, each in to_log.items() if each is not None))
                self._base.executemany("delete from alerts where id = ?", gone)
                self._base.executemany("delete from to_log where number = ?", logged)
                self._put("state", [("segment", segment)])
        except sqlite3.Error as error:
            raise _unwritable(self._path, error) from error

    def _put(self, table: str, rows: Iterable[tuple[str | int, bytes | str]]) -> None:
        self._base.executemany(_PUT[table], rows)

    def close(self) -> None:
        """Close it."""
        self._base.close()


def _kept(base: sqlite3.Connection) -> Kept:
    (number,) = base.execute("pragma user_version").fetchone()
    if number > _FORMAT:
        raise sqlite3.DatabaseError(f"it has format {number}, of a newer gyrofleet")
    alerts = json_decoder(Alert)
    documents = json_decoder(LogDocument)
    return Kept(
        alerts={name: alerts.decode(content) for name, content in base.execute("select * from alerts")},
        to_log={at: documents.decode(content) for at, content in base.execute("select * from to_log order by number")},
        segment=dict(base.execute("select * from state").fetchall()).get("segment", ""),
    )


def _unreadable(path: Path, error: Exception) -> StoreError:
    return StoreError(
        f"the alerts {path} cannot be read: {error}; move the file away, later alerts are kept in a new one"
    )


def _unwritable(path: Path, error: Exception) -> StoreError:
    return StoreError(f"{path} cannot be written: {error}; free or repair the disk")
