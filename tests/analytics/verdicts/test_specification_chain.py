"""Specifications in the log: hash chained, never changed, and only what the store signed."""

import time
from typing import Any

import msgspec
import pytest

from analytics.specifications.entering import withdraw_specification
from analytics.specifications.verdicts import rows_of
from storage.check.recover import recover
from storage.check.verify import verify
from storage.findings import Severity
from storage.log.event_log import EventLog
from storage.log.sequence import place_of
from storage.log.store_documents import sealed
from storage.recording.recorder import Recorder
from storage.segments.records import EVENTS, LogRecord
from storage.specifications.chain import Chain, chain_of, hash_of, read_chain
from storage.specifications.validity import EVER, NEVER, editions_of, in_force, stored_specifications
from storage.sql.catalog import Catalog
from storage.store import Store, WriterLock
from stream.errors import BadInput, NotFound
from stream.events import SpecificationAction, SpecificationEntered, encode_event
from stream.identity import event_key
from stream.security.actor import Actor
from stream.transport.bus import LocalBus
from tests.analytics.conftest import PLACE, START_NS
from tests.analytics.verdicts.specification_documents import Specify, entered, limit

SECOND_NS = 10**9


def test_each_document_names_the_one_before_it_and_who_when_and_why(store: Store, specify: Specify) -> None:
    specify(store, "A", limit(1.0), by=Actor("Li"), reason="order 7")
    specify(store, "B", limit(2.0, "valid_from = 2030-01-01"), by=Actor("Wang"), reason="too tight", is_revision=True)
    withdraw_specification(store, "fog-B", by=Actor("Li"), reason="cancelled")
    chain = read_chain(store)
    documents = [link.document for link in chain.links]
    assert [(each.action, each.revision, each.by, each.reason) for each in documents] == [
        ("added", "A", "Li", "order 7"), ("revised", "B", "Wang", "too tight"), ("withdrawn", "B", "Li", "cancelled"),
    ]  # fmt: skip
    assert [each.previous for each in documents] == ["", hash_of(documents[0]), hash_of(documents[1])]
    assert documents[0].t_ns < documents[1].t_ns < documents[2].t_ns
    assert [each.label for each in stored_specifications(store)] == ["fog-A"]
    with Catalog(store) as catalog:
        rows = rows_of(catalog, "select action, entered_by, reason from specification_history order by t_ns")
    assert [tuple(row.values()) for row in rows] == [(each.action, each.by, each.reason) for each in documents]
    assert verify(store)[0].findings == ()


def test_what_is_not_there_is_neither_revised_nor_withdrawn(store: Store, specify: Specify) -> None:
    specify(store, "A", limit(1.0))
    with pytest.raises(BadInput, match=r"no 'fgo' to revise; did you mean fog\?"):
        specify(store, "B", limit(1.0, metric="bias_stability_averaged"), "fgo", is_revision=True)
    with pytest.raises(NotFound, match=r"'fog-B' is in force; did you mean fog-A\?"):
        withdraw_specification(store, "fog-B", by=Actor("Li"), reason="x")
    assert len(read_chain(store).links) == 1


@pytest.mark.long
def test_a_revision_that_keeps_others_apart_is_not_withdrawn(store: Store, specify: Specify) -> None:
    specify(store, "A", limit(1.0))
    specify(store, "B", limit(1.0, "valid_from = 2026-01-01", "bias_stability_averaged"))
    specify(store, "A", limit(2.0, "valid_from = 2026-01-01"), "other")
    with pytest.raises(BadInput, match=r"fog-B cannot be withdrawn.* fog-A and other-A hold at one time"):
        withdraw_specification(store, "fog-B", by=Actor("Li"), reason="x")
    withdraw_specification(store, "other-A", by=Actor("Li"), reason="x")
    withdraw_specification(store, "fog-B", by=Actor("Li"), reason="x")
    assert [each.label for each in stored_specifications(store)] == ["fog-A"]


def test_a_withdrawn_revision_can_be_entered_again_but_not_with_other_content(store: Store, specify: Specify) -> None:
    specify(store, "A", limit(1.0))
    withdraw_specification(store, "fog-A", by=Actor("Li"), reason="x")
    assert stored_specifications(store) == []
    with pytest.raises(BadInput, match="with other content"):
        specify(store, "A", limit(2.0))
    specify(store, "A", limit(1.0))
    assert [each.label for each in stored_specifications(store)] == ["fog-A"]
    assert len(read_chain(store).links) == 3


@pytest.mark.long
def test_editing_a_copy_changes_nothing_and_verify_says_so(store: Store, specify: Specify) -> None:
    specify(store, "A", limit(1.0))
    copy = store.folder / "products" / "fog-A.toml"
    written = copy.read_bytes()
    copy.chmod(0o644)
    copy.write_bytes(written.replace(b"1.0", b"9.0"))
    assert stored_specifications(store)[0].limits[0].upper == 1.0
    found, _ = verify(store)
    assert [(each.kind, each.severity, each.where) for each in found.findings] == [
        ("specification_copy_changed", Severity.DAMAGE, str(copy))
    ]
    assert not found.is_sound
    assert [each.what for each in recover(store)] == ["specification_copied"]
    assert copy.read_bytes() == written
    (aside,) = copy.parent.glob("fog-A.toml.changed-*")
    assert b"9.0" in aside.read_bytes()
    assert verify(store)[0].is_sound
    copy.unlink()
    assert stored_specifications(store)[0].limits[0].upper == 1.0
    assert verify(store)[0].is_sound


A = entered("fog", "A", content='revision = "A"\n' + limit(1.0))
B = entered("fog", "B", hash_of(A), content='revision = "B"\n' + limit(2.0, "valid_from = 2026-01-01"))
C = entered("fog", "B", hash_of(B))


@pytest.mark.parametrize(
    ("documents", "breaks"),
    [
        ([A, B, C], []),
        ([C, A, B], []),
        ([A, C], ["the document before it is not in the log"]),
        ([B, C], ["the document before it is not in the log"]),
        ([A, B, entered("fog", "Z", hash_of(A))], ["another document follows the same one"]),
        ([A, entered("fog", "Z")], ["it begins a second chain"]),
        ([A, entered("fog", "A", hash_of(A), content="revision = 'A'\n" + limit(9.0)), B],
         ["another document follows the same one"]),
        ([A, C, entered("", "", hash_of(C), action=SpecificationAction.SETTLED, settles=(hash_of(C),))], []),
    ],
)  # fmt: skip
def test_a_document_that_is_missing_forged_or_put_in_breaks_the_chain(
    documents: list[SpecificationEntered], breaks: list[str]
) -> None:
    chain = chain_of([(each, at) for at, each in enumerate(documents)])
    assert len(chain.links) == len(documents)
    assert [each.what for each in chain.breaks] == breaks


def test_any_change_of_a_document_breaks_the_chain_behind_it() -> None:
    changes: dict[str, Any] = {"reason": "y", "by": "Wu", "t_ns": 1, "content": A.content + " ", "rejudges": True}
    for name, other in changes.items():
        changed = msgspec.structs.replace(A, **{name: other})
        assert chain_of([(changed, 0), (B, 1)]).breaks, name


def known(chain: Chain) -> list[tuple[str, int, int, int, int]]:
    return sorted(
        (each.period.specification.revision, each.period.from_ns, each.period.until_ns, each.known_from_ns,
         each.known_until_ns)
        for each in editions_of(chain.links)
    )  # fmt: skip


def test_what_was_known_of_a_period_ends_where_a_document_changes_it() -> None:
    begin = 1_767_225_600 * SECOND_NS  # of B
    assert known(chain_of([(A, 5), (B, 9), (C, 11)])) == [
        ("A", EVER, begin, 9, 11), ("A", EVER, NEVER, 5, 9), ("A", EVER, NEVER, 11, NEVER), ("B", begin, NEVER, 9, 11),
    ]  # fmt: skip
    rejudging = entered("fog", "B", hash_of(A), content=B.content, rejudges=True)
    assert known(chain_of([(A, 5), (rejudging, 9)])) == [("A", EVER, begin, 9, NEVER), ("B", begin, NEVER, 9, NEVER)]
    # a clock that goes back does not put a document before the one that it follows
    assert [link.known_ns for link in chain_of([(A, 5), (B, 3), (C, 4)]).links] == [5, 6, 7]
    assert in_force(chain_of([(A, 5)]).links)[0].label == "fog-A"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"seal": "0" * 64}, "lacks its seal"),
        ({"seal": ""}, "lacks its seal"),
        ({"reason": "forged"}, "lacks its seal"),
        ({"store": "5e"}, "of another store"),
    ],
)
def test_what_another_says_over_the_bus_changes_no_specification(
    store: Store, changes: dict[str, str], said: str
) -> None:
    own = sealed(store, A)
    with (
        LocalBus() as bus,
        WriterLock(store, "test"),
        Recorder(store, bus, EventLog(store), builds_lake=False) as recorder,
    ):
        payload = encode_event(msgspec.structs.replace(own, **changes), "e", 0)
        bus.publish(event_key(PLACE), payload)
        until = time.monotonic() + 10
        while not recorder.counts.rejected and time.monotonic() < until:
            time.sleep(0.01)
        assert recorder.counts.rejected == 1
        assert said in recorder.counts.rejections[0]
    assert read_chain(store).links == ()


def test_a_document_that_is_not_yet_in_the_lake_counts(store: Store, specify: Specify) -> None:
    specify(store, "A", limit(1.0))
    with WriterLock(store, "test"):
        log = EventLog(store)
        document = entered("fog", "A", read_chain(store).head, reason="x")
        record = LogRecord(event_key(PLACE), EVENTS, 2 * START_NS, 0, encode_event(document, "e", 0))
        place = place_of(record)
        assert place is not None
        log.append(place, record)
        log.seal()
        assert stored_specifications(store) == []
        log.abandon()
