"""Two persons: proposed by one, approved by another; nothing is active before, and nothing else is recorded."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import pytest

from analytics.approval import approve
from analytics.loop.model.model_registry import ModelRegistry, ModelVersion
from analytics.loop.model.model_use import (
    InUse,
    Stage,
    activate,
    activation,
    enter_activations,
    read_uses,
    rollback_documents,
)
from storage.log.event_log import EventLog
from storage.log.store_documents import sealed
from storage.recording.acts.proposing import reject
from storage.recording.acts.two_persons import read_proposals, reason_against
from storage.recording.recorder import Recorder
from storage.specifications.chain import read_chain
from storage.store import Store
from stream.errors import BadInput
from stream.events import ActProposed, AnyDocument, ModelActivated, encode_event
from stream.security.actor import Actor, signed_in
from stream.security.certificate_authority import Site
from stream.security.rights import Role
from stream.transport.bus import LocalBus
from tests.analytics.loop.test_model_registry import version
from tests.secured_sites import make_site

RULES = 'two_persons = ["models", "specifications", "certificates"]\n'
LIMITS = 'revision = "A"\n[[limit]]\nmetric = "bias"\nupper = 1.0\nunit_of_measure = "deg/h"\n'
LI, WU = signed_in("li"), signed_in("wu")
HAND = Actor("li")


@pytest.fixture
def store(tmp_path: Path) -> Store:
    found = Store.create(tmp_path / "S")
    (found.folder / "site.toml").write_text(RULES)
    return found


@pytest.fixture
def added(store: Store) -> ModelVersion:
    return ModelRegistry(store).add(version())


def live(store: Store) -> InUse:
    return read_uses(store).get(("U1", "rate"), InUse())


def test_a_model_is_live_once_another_person_approves(store: Store, added: ModelVersion) -> None:
    proposal = activate(store, added, Stage.LIVE, reason="better", by=LI)
    assert isinstance(proposal, ActProposed)
    assert live(store) == InUse()
    for nobody in (LI, signed_in("Li"), Actor("approver:li", "approver:li")):
        with pytest.raises(BadInput, match="has proposed it: another person has to approve"):
            approve(store, proposal.uid, nobody)
    with pytest.raises(BadInput, match="wu is not authenticated"):
        approve(store, proposal.uid, Actor("wu"))
    assert live(store) == InUse()
    with pytest.raises(BadInput, match="it is proposed already, by li"):
        activate(store, added, Stage.LIVE, reason="again", by=WU)
    done = approve(store, proposal.uid[:8], WU)
    assert live(store).live == done
    assert (done.identity, done.proposed_by, done.proposal) == ("user:wu", "user:li", proposal.uid)
    with pytest.raises(BadInput, match="it is approved already, by wu"):
        approve(store, proposal.uid, Actor("zhao", "user:zhao"))


def test_who_is_not_authenticated_proposes_nothing(store: Store, added: ModelVersion) -> None:
    with pytest.raises(BadInput, match="two persons are needed for models here, and li has not proved who it is"):
        activate(store, added, Stage.LIVE, reason="", by=HAND)
    assert read_proposals(store) == {}


@pytest.mark.long
def test_a_rejected_proposal_stays_without_effect(store: Store, added: ModelVersion) -> None:
    proposal = activate(store, added, Stage.SHADOW, reason="", by=LI)
    reject(store, proposal.uid, by=WU, reason="the run was disturbed")
    with pytest.raises(BadInput, match="it is rejected already, by wu"):
        approve(store, proposal.uid, WU)
    assert live(store) == InUse()
    assert [each.state for each in read_proposals(store).values()] == ["rejected"]
    assert isinstance(activate(store, added, Stage.SHADOW, reason="new run", by=LI), ActProposed)


@pytest.mark.long
def test_one_person_takes_a_model_out_of_use_and_puts_back_what_two_had_approved(store: Store) -> None:
    registry = ModelRegistry(store)
    one, two = registry.add(version()), registry.add(version(note="again"))
    for each in (one, two):
        approve(store, activate(store, each, Stage.LIVE, reason="", by=LI).uid, WU)
    documents = rollback_documents(registry, live(store), Stage.LIVE, reason="worse", by=LI)
    assert [each.stage for each in documents] == ["off", "live"]
    enter_activations(store, documents)
    assert live(store).live == documents[1]


@pytest.mark.long
def test_the_recorder_refuses_what_goes_around_the_rule(store: Store, added: ModelVersion) -> None:
    """Documents that a process writes itself."""
    proposal = activate(store, added, Stage.LIVE, reason="", by=LI)
    assert isinstance(proposal, ActProposed)
    plain = activation(added, Stage.LIVE, "", WU, after_ns=None)
    good = partial(_changed, plain, proposal=proposal.uid, proposed_by="user:li")
    cases: list[tuple[AnyDocument, str]] = [
        (plain, "it names no proposal"),
        (_changed(plain, proposal="made-up", proposed_by="user:li"), "the log has no proposal made-up"),
        (sealed(store, good(by="li", identity="user:li")), "user:li has proposed it"),
        (sealed(store, good(identity="unauthenticated")), "wu is not authenticated"),
        (sealed(store, good(proposed_by="user:zhao")), "it is not what was proposed"),
        (sealed(store, good(model="another")), "it is not what was proposed"),
        (sealed(store, good(unit="U2")), "it is not what was proposed"),
        (good(), "it lacks the seal of the store"),
    ]
    for document, reason in cases:
        assert reason in str(reason_against(store, None, document)), reason
    with LocalBus() as bus, Recorder(store, bus, EventLog(store), builds_lake=False, reports_status=False) as recorder:
        bus.publish("gyrofleet/local/entered/event", encode_event(plain, "e", 0))
    assert recorder.counts.rejected == 1
    assert "the site needs two persons for models, and it names no proposal" in recorder.counts.rejections[0]
    assert live(store) == InUse()
    right = sealed(store, good())
    assert reason_against(store, None, right) is None
    enter_activations(store, [right])
    assert reason_against(store, None, right) is None  # sent once more, as after a lost acknowledgement
    assert live(store).live == right


def _changed(document: ModelActivated, **words: Any) -> ModelActivated:
    return msgspec.structs.replace(document, **words)


def test_specifications_by_certificates_on_the_command_line(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    """The rule is the site's, signed into the access list; the store's folder has no file of it."""
    make_site(tmp_path / "site").add(Role.APPROVER, "chief", days=1.0)
    (tmp_path / "site/site.toml").write_text(RULES)
    assert gyrofleet("site", "rules", "site").code == 0
    (tmp_path / "fog.toml").write_text(LIMITS)
    lead = ("--store", "S", "--security", "site/approver/lead")
    chief = ("--store", "S", "--security", "site/approver/chief")
    proposed = gyrofleet("limits", "add", "fog.toml", *lead, "--json").json
    store = Store.open(tmp_path / "S")
    assert read_chain(store).links == ()
    (row,) = gyrofleet("proposal", "list", "--store", "S", "--json").json
    assert (row["id"], row["title"]) == (proposed["proposal"], "add specification fog-A")
    assert row["identity"] == "approver:lead"
    same = gyrofleet("proposal", "approve", row["id"], *lead)
    assert same.code == 1
    assert "approver:lead has proposed it: another person has to approve" in same.err
    none = gyrofleet("proposal", "approve", "none", *chief)
    assert "there is no proposal 'none' in S; " in none.err
    nobody = gyrofleet("proposal", "approve", row["id"], "--store", "S")
    assert nobody.code == 1
    assert "is not authenticated" in nobody.err
    station = gyrofleet("proposal", "approve", row["id"], "--store", "S", "--security", "site/station/c1")
    assert station.code == 1
    assert "needs a certificate of role approver" in station.err
    assert read_chain(store).links == ()
    done = gyrofleet("proposal", "approve", row["id"][:10], *chief)
    assert done.code == 0, done.err
    (link,) = read_chain(store).links
    assert (link.document.by, link.document.proposed_by) == ("approver:chief", "approver:lead")
    assert (tmp_path / "S/products/fog-A.toml").read_text() == LIMITS
    for words in (("limits", "list"), ("limits", "history")):
        shown = gyrofleet(*words, "--store", "S").out
        assert "proposed by approver:lead, approved by approver:chief" in " ".join(shown.split())
    taken = gyrofleet("limits", "withdraw", "fog-A", "--reason", "wrong", *chief, "--json").json
    assert len(read_chain(store).links) == 1
    assert gyrofleet("proposal", "approve", taken["uid"], *lead).code == 0
    assert [each.document.action for each in read_chain(store).links] == ["added", "withdrawn"]
    rows = gyrofleet("proposal", "list", "--all", "--store", "S", "--json").json
    assert [(each["state"], each["ended_by"]) for each in rows] == [
        ("approved", "approver:chief"), ("approved", "approver:lead"),
    ]  # fmt: skip


def test_a_rule_that_cannot_be_read_refuses_every_act(store: Store, added: ModelVersion) -> None:
    (store.folder / "site.toml").write_text('two_persons = ["everything"]\n')
    with pytest.raises(BadInput, match=r'site.toml: .*two_persons is a list of some of "models"'):
        activate(store, added, Stage.LIVE, reason="", by=LI)


def test_a_changed_rule_is_signed_by_the_site(tmp_path: Path) -> None:
    site: Site = make_site(tmp_path)
    (tmp_path / "site.toml").write_text(RULES)
    assert len(site.publish().two_persons) == 3
