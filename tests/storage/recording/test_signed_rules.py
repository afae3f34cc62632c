"""Rules of a site that are left in a store: whose, how new, and what becomes of files that are there."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from storage.log.event_log import EventLog
from storage.recording.acts.signed_rules import SIGNED_RULES_FILE, keep_signed_rules, read_signed_rules
from storage.recording.acts.two_persons import needs_two
from storage.recording.recorder import Recorder
from storage.specifications.chain import read_chain
from storage.store import Store
from stream.errors import BadInput
from stream.security.certificate_authority import Site
from stream.security.site_rules import Subject
from tests.secured_sites import credentials, make_site, session

ALL = frozenset(Subject)
EVERY = 'two_persons = ["models", "specifications", "certificates"]\n'
ONE = 'two_persons = ["models"]\n'
RECORDER = "recorder:recorder"


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store.create(tmp_path / "S")


def ruled(folder: Path, rules: str) -> Site:
    site = make_site(folder)
    _sign(site, folder, rules)
    return site


def _sign(site: Site, folder: Path, rules: str) -> None:
    (folder / "site.toml").write_text(rules)
    site.publish()


def kept(store: Store, folder: Path) -> list[str]:
    """What is warned of where the rules of a site are left in a store."""
    warnings: list[str] = []
    keep_signed_rules(store, credentials(folder, RECORDER), warnings.append)
    return warnings


def test_a_secured_recorder_leaves_the_rules_and_a_command_without_certificate_is_refused(
    tmp_path: Path, store: Store, gyrofleet: Callable[..., Any], endpoint: str
) -> None:
    """The store has no site.toml, and no recorder is at work when the command comes."""
    ruled(tmp_path / "site", EVERY)
    with (
        session(tmp_path / "site", RECORDER, listen=endpoint.replace("tcp/", "tls/")) as bus,
        Recorder(store, bus, EventLog(store), builds_lake=False, reports_status=False),
    ):
        pass
    (tmp_path / "fog.toml").write_text(
        'revision = "A"\n[[limit]]\nmetric = "bias"\nupper = 1.0\nunit_of_measure = "deg/h"\n'
    )
    words = ("limits", "add", "fog.toml", "--store", "S")
    done = gyrofleet(*words)
    assert done.code == 1
    assert "two persons are needed for specifications here" in done.err
    assert "give --security FOLDER of a certificate" in done.err
    assert read_chain(store).links == ()
    proposed = gyrofleet(*words, "--security", "site/approver/lead", "--json")
    assert proposed.json["proposal"]
    assert not (store.folder / "site.toml").exists()


def test_who_enters_with_a_certificate_leaves_the_rules_as_well(
    tmp_path: Path, store: Store, gyrofleet: Callable[..., Any]
) -> None:
    ruled(tmp_path / "site", EVERY)
    (tmp_path / "fog.toml").write_text(
        'revision = "A"\n[[limit]]\nmetric = "bias"\nupper = 1.0\nunit_of_measure = "deg/h"\n'
    )
    assert needs_two(store) == frozenset()
    assert gyrofleet("limits", "add", "fog.toml", "--store", "S", "--security", "site/approver/lead").code == 0
    assert needs_two(store) == ALL


def test_newer_rules_replace_older_ones_and_older_ones_nothing(tmp_path: Path, store: Store) -> None:
    site = ruled(tmp_path / "site", ONE)
    folder = tmp_path / "site/recorder/recorder"
    old = (folder / "access.json").read_bytes()
    assert kept(store, tmp_path / "site") == []
    assert needs_two(store) == {Subject.MODELS}
    _sign(site, tmp_path / "site", EVERY)
    assert kept(store, tmp_path / "site") == []
    assert needs_two(store) == ALL
    new = (folder / "access.json").read_bytes()
    (folder / "access.json").write_bytes(old)
    (warning,) = kept(store, tmp_path / "site")
    assert "has rules of a newer access list than" in warning
    assert "copy the site's newest access.json there" in warning
    assert needs_two(store) == ALL
    (folder / "access.json").write_bytes(new)
    _sign(site, tmp_path / "site", "two_persons = []\n")
    assert kept(store, tmp_path / "site") == []
    assert needs_two(store) == frozenset()
    _sign(site, tmp_path / "site", ONE)
    kept(store, tmp_path / "site")
    assert needs_two(store) == {Subject.MODELS}


def test_another_site_takes_nothing_away(tmp_path: Path, store: Store) -> None:
    """Anybody can make a site without rules."""
    ruled(tmp_path / "site", 'two_persons = ["specifications"]\n')
    kept(store, tmp_path / "site")
    ruled(tmp_path / "other", ONE)
    (warning,) = kept(store, tmp_path / "other")
    assert "has rules of another site than" in warning
    assert f"remove {store.folder / SIGNED_RULES_FILE}" in warning
    assert needs_two(store) == {Subject.SPECIFICATIONS, Subject.MODELS}
    (store.folder / SIGNED_RULES_FILE).unlink()
    assert kept(store, tmp_path / "other") == []
    assert needs_two(store) == {Subject.MODELS}


def test_a_persons_file_is_left_and_both_hold(tmp_path: Path, store: Store) -> None:
    ruled(tmp_path / "site", 'two_persons = ["certificates"]\n')
    (store.folder / "site.toml").write_text(ONE)
    (warning,) = kept(store, tmp_path / "site")
    assert "asks for two persons for models, the site has signed certificates: all of that holds" in warning
    assert (store.folder / "site.toml").read_text() == ONE
    assert needs_two(store) == {Subject.MODELS, Subject.CERTIFICATES}
    (store.folder / "site.toml").write_text(EVERY)
    assert kept(store, tmp_path / "site") == []


def test_a_damaged_file_refuses_every_act_until_it_is_written_anew(tmp_path: Path, store: Store) -> None:
    ruled(tmp_path / "site", ONE)
    kept(store, tmp_path / "site")
    path = store.folder / SIGNED_RULES_FILE
    path.write_bytes(path.read_bytes()[:-3])
    with pytest.raises(BadInput, match=r"site.signed.toml is damaged: .*`gyrofleet record --security FOLDER` writes"):
        needs_two(store)
    (warning,) = kept(store, tmp_path / "site")
    assert "is damaged" in warning
    assert needs_two(store) == {Subject.MODELS}


def test_rules_that_cannot_be_left_are_reported(tmp_path: Path, store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    ruled(tmp_path / "site", ONE)

    def full(*_words: object, **_options: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("storage.recording.acts.signed_rules.write_durably", full)
    (warning,) = kept(store, tmp_path / "site")
    assert "site.signed.toml cannot be written: No space left on device" in warning
    assert read_signed_rules(store.folder).two_persons == ()


def test_a_site_without_rules_leaves_no_file(tmp_path: Path, store: Store) -> None:
    make_site(tmp_path / "site")
    assert kept(store, tmp_path / "site") == []
    assert not (store.folder / SIGNED_RULES_FILE).exists()
