"""What is entered later changes no verdict given before, unless a person asks for that."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analytics.specifications.entering import settle_chain, withdraw_specification
from analytics.specifications.verdicts import rows_of, verdicts_of
from storage.check.recover import recover
from storage.check.verify import verify
from storage.findings import Severity
from storage.specifications.chain import append_document, hash_of, read_chain
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.errors import BadInput
from stream.security.actor import Actor
from tests.analytics.conftest import START_NS, TestedUnits
from tests.analytics.verdicts.few_metrics import computing
from tests.analytics.verdicts.specification_documents import Specify, entered, limit

SECOND_NS = 10**9


@pytest.fixture
def few_metrics() -> Iterator[None]:
    with computing("bias", "bias_stability_averaged"):
        yield


@pytest.fixture(scope="module")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Unit U1 at rest with a bias of 1.5 deg/h; its run is recorded in 2025, before all that tests enter."""
    folder = tmp_path_factory.mktemp("measured") / "store"
    tested = TestedUnits(folder)
    tested.run("r1", procedure="static_bias")
    tested.mount("r1", "U1", product="X")
    values = np.random.default_rng(3).normal(1.5, 0.5, 4000)
    tested.step("r1", "U1", values, t0_ns=START_NS, dt_ns=SECOND_NS, procedure="static_bias", step="static")
    with computing("bias"), tested.catalog() as catalog:
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


@pytest.mark.usefixtures("few_metrics")
@pytest.mark.in_gate("valid_from = 2030-01-01")
@pytest.mark.parametrize("head", ["valid_from = 2030-01-01", "valid_from = 2025-01-01\nvalid_until = 2025-12-31"])
def test_a_later_revision_changes_no_verdict_given_before(measured_store: Store, specify: Specify, head: str) -> None:
    specify(measured_store, "A", limit(2.0))
    specify(measured_store, "B", limit(1.0, head))
    assert judged(measured_store) == PASSED
    withdraw_specification(measured_store, "fog-A", by=Actor("Li"), reason="x")
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
    specify(measured_store, "1", limit(1e-6, metric="bias_stability_averaged"), "more")
    assert judged(measured_store) == FAILED
    withdraw_specification(measured_store, "more-1", by=Actor("Li"), reason="wrong")
    withdraw_specification(measured_store, "fog-B", by=Actor("Li"), reason="wrong", rejudges=True)
    assert judged(measured_store) == PASSED


@pytest.mark.usefixtures("few_metrics")
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


@pytest.mark.long
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
    assert settle_chain(measured_store, by=Actor("Li"), reason="the disk failed")[0] == [
        "the document before it is not in the log"
    ]
    assert _units(measured_store)[0]["verdict"] == "PASS"
    assert verify(measured_store)[0].is_sound
    with pytest.raises(BadInput, match="nothing to settle"):
        settle_chain(measured_store, by=Actor("Li"), reason="again")


def _units(store: Store) -> list[dict[str, Any]]:
    with Catalog(store) as catalog:
        return verdicts_of(catalog).units
