"""Statuses on a secured bus: each role reports its own, and nobody another's."""

import datetime as dt
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import msgspec
import pytest

import stream.delivery.publisher as publishing
from analytics.alerts.conditions.certificate import CertificateCondition
from analytics.alerts.finding import AlertView
from storage.log.event_log import EventLog
from storage.recording.recorder import Recorder
from storage.recording.status_board import FOLDER
from storage.recording.store_status import store_status
from storage.store import Store
from stream.delivery.publisher import DurablePublisher
from stream.errors import BadInput
from stream.security.certificate_authority import Site
from stream.security.credentials import load_credentials
from stream.security.rights import Principal
from stream.security.rights import Role as SiteRole
from stream.status.proven_status import on_bus
from stream.status.role_status import STATUS_KEY, Role, RoleState, RoleStatus, encode_status, new_status
from tests.secured_sites import credentials, make_site, session
from tests.storage.recorder_samples import batch

KEY = "gyrofleet/plant/c1/U1/rate"


def status(role: Role, name: str, **parts: object) -> RoleStatus:
    return new_status(role, time.time_ns(), name=name, **parts)


def wait_for(is_so: Callable[[], object], seconds: float = 20.0) -> None:
    until = time.monotonic() + seconds
    while not is_so():
        assert time.monotonic() < until
        time.sleep(0.02)


def test_nobody_reports_the_status_of_another_role(tmp_path: Path, endpoint: str) -> None:
    """A station's certificate had kept a killed station, and a builder of the lake that does not exist, at work."""
    site, store = tmp_path / "site", Store.create(tmp_path / "store")
    make_site(site)
    forged = [
        status(Role.RUN, "c1", state=RoleState.FAILED, trouble="forged"), status(Role.LAKE, "host"),
        status(Role.RECORD, "host", trouble="forged"), status(Role.ESTIMATE, "e1"), status(Role.SERVE, "host"),
    ]  # fmt: skip
    with (
        session(site, "recorder:recorder", listen=endpoint) as bus,
        Recorder(store, bus, EventLog(store), builds_lake=False, reports_status=False) as recorder,
        session(site, "station:c1", connect=endpoint) as own,
        session(site, "station:c2", connect=endpoint, asks_itself=False) as other,
        session(site, "estimator:e1", connect=endpoint) as estimator,
        session(site, "approver:lead", connect=endpoint, asks_itself=False) as approver,
    ):
        time.sleep(0.3)
        for each in forged:
            on_bus(other)(each)
        other.publish(STATUS_KEY, encode_status(status(Role.RUN, "c2")))  # without a proof
        wait_for(lambda: recorder.counts.rejected == len(forged) + 1)
        approver.publish(STATUS_KEY, encode_status(status(Role.RUN, "lead")))  # does not arrive
        for number in range(50):  # of many computers, as it claims: they are one station
            on_bus(own)(msgspec.structs.replace(status(Role.RUN, "c1"), host=f"host{number}"))
        on_bus(estimator)(status(Role.ESTIMATE, "night"))
        wait_for(lambda: len(store_status(store).roles) == 2)
        time.sleep(0.3)
        found = [(each.status.role, each.status.name, each.condition) for each in store_status(store).roles]
        assert found == [(Role.ESTIMATE, "night", "working"), (Role.RUN, "c1", "working")]
        assert len(list((store.folder / FOLDER).iterdir())) == 2
        assert recorder.counts.rejected == len(forged) + 1
        texts = "\n".join(recorder.counts.rejections)
        assert "station c2 may not report the status of 'c1'" in texts
        assert "station c2 may not report the status of `gyrofleet lake`" in texts
        assert "no proof of its source" in texts


def test_a_run_that_nobody_acknowledges_learns_why(
    tmp_path: Path, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A station that was revoked meanwhile counted its messages, and did not name a reason, until its run ended."""
    monkeypatch.setattr(publishing, "_SILENT_S", 0.5)
    site, store = make_site(tmp_path / "site"), Store.create(tmp_path / "store")
    site.revoke(Principal(SiteRole.STATION, "c1"))
    with (
        session(tmp_path / "site", "recorder:recorder", listen=endpoint) as bus,
        Recorder(store, bus, EventLog(store), builds_lake=False, reports_status=False),
        session(tmp_path / "site", "station:c1", connect=endpoint) as station,
    ):
        publisher = DurablePublisher(station)
        assert publisher.warning is None
        publisher.send_batch(KEY, batch(0))
        wait_for(lambda: publisher.warning)
        text = str(publisher.warning)
        assert "no recorder has acknowledged anything since" in text
        assert "station c1 is revoked" in text
        publisher.abandon()


def test_a_warning_of_silence_ends_with_it(tmp_path: Path, endpoint: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(publishing, "_SILENT_S", 0.5)
    make_site(tmp_path / "site")
    store = Store.create(tmp_path / "store")
    with (
        session(tmp_path / "site", "recorder:recorder", listen=endpoint) as bus,
        session(tmp_path / "site", "station:c1", connect=endpoint) as station,
        DurablePublisher(station) as sent,
    ):
        sent.send_batch(KEY, batch(0))
        wait_for(lambda: sent.warning)
        assert "is `gyrofleet record` running" in str(sent.warning)
        with Recorder(store, bus, EventLog(store), builds_lake=False, reports_status=False):
            sent.drain()
            wait_for(lambda: sent.warning is None)


def test_a_certificate_that_ends_is_named_before_and_after(tmp_path: Path) -> None:
    site = Site.create(tmp_path / "site")
    fresh = load_credentials(site.add(SiteRole.STATION, "c1", days=10.0))
    assert fresh.trouble is None
    brief = load_credentials(site.add(SiteRole.STATION, "c2", days=3.0 / 86400.0))  # not before: ten minutes ago
    assert str(brief.trouble).startswith("the certificate of station c2 ends on ")
    wait_for(lambda: "ended on" in str(brief.trouble))
    assert "no new link is made with it; `gyrofleet site renew SITE station:c2`" in str(brief.trouble)
    site.renew(Principal(SiteRole.STATION, "c2"), days=1.0)
    assert brief.trouble is None, "a link that is made now has the new one"
    assert brief.numbers["certificate_ends_seconds"] > time.time() + 80_000


def test_an_alert_names_a_certificate_that_ends(tmp_path: Path) -> None:
    make_site(tmp_path / "site")
    ends_s = credentials(tmp_path / "site", "recorder:recorder").numbers["certificate_ends_seconds"]
    assert ends_s == pytest.approx((dt.datetime.now(dt.UTC) + dt.timedelta(days=1)).timestamp(), abs=60.0)

    def found(within_h: float, numbers: dict[str, float]) -> list[str]:
        role = SimpleNamespace(status=status(Role.RECORD, "host", numbers=numbers), condition="working")
        view: Any = SimpleNamespace(status=SimpleNamespace(roles=(role,)))
        return [str(each.text) for each in CertificateCondition(within_h=within_h).findings(cast("AlertView", view))]

    assert found(12.0, {"certificate_ends_seconds": ends_s}) == []
    assert found(48.0, {}) == []
    (text,) = found(48.0, {"certificate_ends_seconds": ends_s})
    assert text.startswith("`gyrofleet record` (host): its certificate ends on ")
    (text,) = found(48.0, {"certificate_ends_seconds": time.time() - 1.0})
    assert "its certificate ended on" in text


@pytest.mark.parametrize("mode", [0o644, 0o660])
def test_a_sites_key_that_others_can_read_is_refused(tmp_path: Path, mode: int) -> None:
    Site.create(tmp_path)
    (tmp_path / "ca.key").chmod(mode)
    with pytest.raises(BadInput, match=rf"ca.key: others can read it \(mode {mode:o}\): chmod 600"):
        Site(tmp_path)
