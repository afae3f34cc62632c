"""Specifications in the log: hash chained, never changed; what is entered later changes no verdict given before."""

import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from analytics.specifications.entering import add_specification, settle_chain, withdraw_specification
from analytics.specifications.verdicts import rows_of, verdicts_of
from storage.check.recover import recover
from storage.check.verify import verify
from storage.findings import Severity
from storage.log.event_log import EventLog
from storage.log.sequence import place_of
from storage.log.store_documents import signed_specification
from storage.recording.recorder import Recorder
from storage.segments.records import EVENTS, LogRecord
from storage.specifications.chain import Chain, append_document, chain_of, hash_of, read_chain
from storage.specifications.validity import EVER, NEVER, editions_of, in_force, stored_specifications
from storage.sql.catalog import Catalog
from storage.store import Store, WriterLock
from stream.errors import BadInput, NotFound
from stream.events import SpecificationAction, SpecificationEntered, encode_event
from stream.identity import event_key
from stream.transport.bus import LocalBus
from tests.analytics.conftest import PLACE, START_NS, TestedUnits

SECOND_NS = 10**9
YEAR_NS = 365 * 86_400 * SECOND_NS

Specify = Callable[..., str]


def entered(name: str, revision: str, previous: str = "", **words: Any) -> SpecificationEntered:
    action = SpecificationAction.ADDED if words.get("content") else SpecificationAction.WITHDRAWN
    given = {"run": "", "t_ns": 0, "by": "Li", "action": action, **words}
    return SpecificationEntered(name=name, revision=revision, previous=previous, **given)


def limit(upper: float, head: str = "", metric: str = "bias") -> str:
    parameters = 'parameters = { earth_rate = "none" }' if metric == "bias" else "parameters = { average_s = 10 }"
    return f'{head}\n[[limit]]\nmetric = "{metric}"\nupper = {upper}\nunit_of_measure = "deg/h"\n{parameters}\n'


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store.create(tmp_path / "store")


@pytest.fixture
def specify(tmp_path: Path) -> Specify:
    """Enter a specification; its label."""

    def run(store: Store, revision: str, text: str, name: str = "fog", **words: Any) -> str:
        path = tmp_path / f"{name}.toml"
        path.write_text(f'revision = "{revision}"\n{text}')
        return add_specification(store, path, **words)[0].label

    return run


def test_each_document_names_the_one_before_it_and_who_when_and_why(store: Store, specify: Specify) -> None:
    specify(store, "A", limit(1.0), by="Li", reason="order 7")
    specify(store, "B", limit(2.0, "valid_from = 2030-01-01"), by="Wang", reason="too tight", is_revision=True)
    withdraw_specification(store, "fog-B", by="Li", reason="cancelled")
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
        withdraw_specification(store, "fog-B", by="Li", reason="x")
    assert len(read_chain(store).links) == 1


def test_a_revision_that_keeps_others_apart_is_not_withdrawn(store: Store, specify: Specify) -> None:
    specify(store, "A", limit(1.0))
    specify(store, "B", limit(1.0, "valid_from = 2026-01-01", "bias_stability_averaged"))
    specify(store, "A", limit(2.0, "valid_from = 2026-01-01"), "other")
    with pytest.raises(BadInput, match=r"fog-B cannot be withdrawn.* fog-A and other-A hold at one time"):
        withdraw_specification(store, "fog-B", by="Li", reason="x")
    withdraw_specification(store, "other-A", by="Li", reason="x")
    withdraw_specification(store, "fog-B", by="Li", reason="x")
    assert [each.label for each in stored_specifications(store)] == ["fog-A"]


def test_a_withdrawn_revision_can_be_entered_again_but_not_with_other_content(store: Store, specify: Specify) -> None:
    specify(store, "A", limit(1.0))
    withdraw_specification(store, "fog-A", by="Li", reason="x")
    assert stored_specifications(store) == []
    with pytest.raises(BadInput, match="with other content"):
        specify(store, "A", limit(2.0))
    specify(store, "A", limit(1.0))
    assert [each.label for each in stored_specifications(store)] == ["fog-A"]
    assert len(read_chain(store).links) == 3


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


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Unit U1 at rest with a bias of 1.5 deg/h; its run is recorded in 2025, before all that tests enter."""
    folder = tmp_path_factory.mktemp("measured") / "store"
    tested = TestedUnits(folder)
    tested.run("r1", procedure="static_bias")
    tested.mount("r1", "U1", product="X")
    values = np.random.default_rng(3).normal(1.5, 0.5, 4000)
    tested.step("r1", "U1", values, t0_ns=START_NS, dt_ns=SECOND_NS, procedure="static_bias", step="static")
    with tested.catalog() as catalog:
        catalog.fill()
    tested.release()
    return folder


@pytest.fixture
def measured_store(template: Path, tmp_path: Path) -> Store:
    return Store.open(Path(shutil.copytree(template, tmp_path / "measured")))


def judged(store: Store) -> list[tuple[str, str | None, str]]:
    with Catalog(store) as catalog:
        found = verdicts_of(catalog)
    rows = [(row["metric"], row["revision"], row["verdict"]) for row in found.verdicts if row["unit"] == "U1"]
    return [*rows, ("unit", None, found.units[0]["verdict"])]


PASSED = [("bias", "A", "PASS"), ("unit", None, "PASS")]
FAILED = [("bias", "B", "FAIL"), ("unit", None, "FAIL")]


@pytest.mark.in_gate("valid_from = 2030-01-01")
@pytest.mark.parametrize("head", ["valid_from = 2030-01-01", "valid_from = 2025-01-01\nvalid_until = 2025-12-31"])
def test_a_later_revision_changes_no_verdict_given_before(measured_store: Store, specify: Specify, head: str) -> None:
    specify(measured_store, "A", limit(2.0))
    specify(measured_store, "B", limit(1.0, head))
    assert judged(measured_store) == PASSED
    specify(measured_store, "1", limit(1e-6, metric="bias_stability_averaged"), "more")
    withdraw_specification(measured_store, "fog-A", by="Li", reason="x")
    assert judged(measured_store) == PASSED


@pytest.mark.long
def test_a_specification_that_was_never_valid_at_the_time_says_so(measured_store: Store, specify: Specify) -> None:
    specify(measured_store, "A", limit(2.0, "valid_from = 2030-01-01"))
    with Catalog(measured_store) as catalog:
        (row,) = verdicts_of(catalog).verdicts
    assert row["verdict"] == "NO_DATA"
    assert row["reason"] == "no revision of fog was valid at 2025-11-21: there is A from 2030-01-01"
    specify(measured_store, "0", limit(2.0, "valid_from = 2025-01-01"))  # what nobody judged yet may be judged
    assert judged(measured_store) == [("bias", "0", "PASS"), ("unit", None, "PASS")]


@pytest.mark.long
def test_what_holds_now_judges_what_was_recorded_before_where_that_is_asked_for(
    measured_store: Store, specify: Specify
) -> None:
    specify(measured_store, "A", limit(2.0))
    specify(measured_store, "B", limit(1.0, "valid_from = 2025-01-01"), rejudges=True)
    assert judged(measured_store) == FAILED
    withdraw_specification(measured_store, "fog-B", by="Li", reason="wrong", rejudges=True)
    assert judged(measured_store) == PASSED


def test_a_run_recorded_after_a_revision_is_judged_by_it(store: Store, specify: Specify) -> None:
    specify(store, "A", limit(2.0))
    specify(store, "B", limit(1.0, "valid_from = 2025-01-01"))
    known_ns = read_chain(store).links[-1].known_ns
    units = TestedUnits(store.folder)
    for unit, t0_ns in (("before", known_ns - 10_000 * SECOND_NS), ("after", known_ns + SECOND_NS)):
        units.run(f"r-{unit}", t_ns=t0_ns)
        units.step(
            f"r-{unit}", unit, np.random.default_rng(1).normal(1.5, 0.5, 4000),
            t0_ns=t0_ns, dt_ns=SECOND_NS, procedure="static_bias", step="static",
        )  # fmt: skip
    units.catalog().close()
    units.release()
    with Catalog(store) as catalog:
        found = {row["unit"]: (row["revision"], row["verdict"]) for row in verdicts_of(catalog).verdicts}
    assert found == {"before": ("A", "PASS"), "after": ("B", "FAIL")}


def test_the_log_alone_gives_the_same_verdicts(measured_store: Store, specify: Specify, tmp_path: Path) -> None:
    specify(measured_store, "A", limit(2.0) + "[product.X]\naverage_s = 30.0\n")
    specify(measured_store, "B", limit(1.0, "valid_from = 2025-01-01") + "[product.X]\naverage_s = 50.0\n")
    with Catalog(measured_store) as catalog:
        before = verdicts_of(catalog)
        values = rows_of(catalog, "select * from unit_metrics order by all")
    assert {"30", "30.0"} & {str(row["parameters"]).split('"average_s":')[-1].split(",")[0].strip() for row in values}
    folder = tmp_path / "restored"
    folder.mkdir()
    shutil.copytree(measured_store.log, folder / "log")
    restored, _ = Store.open_or_repair(folder)
    list(recover(restored))
    assert verify(restored)[0].is_sound
    with Catalog(restored) as catalog:
        assert verdicts_of(catalog) == before
        assert rows_of(catalog, "select * from unit_metrics order by all") == values


@pytest.mark.long
def test_a_lost_document_leaves_no_verdict_until_a_person_accepts_it(measured_store: Store, specify: Specify) -> None:
    specify(measured_store, "A", limit(2.0))
    before = read_chain(measured_store)
    lost = entered("fog", "B", before.head, content='revision = "B"\n' + limit(1.0, "valid_from = 2030-01-01"))
    append_document(measured_store, entered("fog", "B", hash_of(lost), reason="x"))
    (unit,) = _units(measured_store)
    assert (unit["verdict"], unit["passed"]) == ("NO_DATA", 0)
    assert unit["reason"].startswith("the chain of specification documents is broken: the document before it is not")
    (found,) = verify(measured_store)[0].findings
    assert (found.kind, found.severity) == ("specification_chain_broken", Severity.DAMAGE)
    with pytest.raises(BadInput, match="gyrofleet limits settle"):
        specify(measured_store, "C", limit(1.0))
    assert settle_chain(measured_store, by="Li", reason="the disk failed") == [
        "the document before it is not in the log"
    ]
    assert _units(measured_store)[0]["verdict"] == "PASS"
    assert verify(measured_store)[0].is_sound
    with pytest.raises(BadInput, match="nothing to settle"):
        settle_chain(measured_store, by="Li", reason="again")


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
    sealed = signed_specification(store, A)
    with (
        LocalBus() as bus,
        WriterLock(store, "test"),
        Recorder(store, bus, EventLog(store), builds_lake=False) as recorder,
    ):
        payload = encode_event(msgspec.structs.replace(sealed, **changes), "e", 0)
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


def _units(store: Store) -> list[dict[str, Any]]:
    with Catalog(store) as catalog:
        return verdicts_of(catalog).units
