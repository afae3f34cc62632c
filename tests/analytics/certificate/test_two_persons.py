"""A certificate that two persons are needed for is none before another one approves it."""

import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from stream.security.rights import Role
from tests.analytics.certificate.conftest import ORDERED, UNIT
from tests.analytics.certificate.pdf_checks import pages_of
from tests.secured_sites import make_site

LEAD, CHIEF = ("--security", "site/approver/lead"), ("--security", "site/approver/chief")


@pytest.fixture
def site(laboratory: Path, run_command: Callable[..., Any], tmp_path: Path) -> tuple[Path, Callable[..., Any]]:
    """A copy of the laboratory that asks for two persons, `lead` and `chief`, and what runs a command there."""
    folder = tmp_path / "copy"
    shutil.copytree(laboratory, folder)
    make_site(folder / "site").add(Role.APPROVER, "chief", days=1.0)
    (folder / "lab/site.toml").write_text('two_persons = ["certificates"]\n')
    return folder, partial(run_command, cwd=folder)


@pytest.mark.long
def test_a_certificate_is_issued_by_another_person(site: tuple[Path, Callable[..., Any]]) -> None:
    folder, run = site

    def is_genuine(name: str) -> bool:
        genuine: bool = run("certificate", "verify", name, "--store", "lab", "--json").json["genuine"]
        return genuine

    nobody = run(*ORDERED, "--out", "a.pdf", "--lang", "en")
    assert nobody.code == 1
    assert "two persons are needed for certificates here" in nobody.out
    asked = run(*ORDERED, "--out", "a.pdf", "--lang", "en", *LEAD)
    assert asked.code == 0, asked.err
    number, uid = asked.json["number"], asked.json["proposal"]
    assert not is_genuine("a.pdf")
    assert not (folder / "lab/certificates" / f"{number}.pdf").exists()
    again = run(*ORDERED, "--out", "b.pdf", "--lang", "en", *CHIEF)
    assert again.code == 1
    assert f"certificate {number} of {UNIT} waits for another person" in again.out
    same = run("proposal", "approve", uid, "--store", "lab", *LEAD)
    assert same.code == 1
    assert "another person has to approve" in same.err
    kept = folder / "lab/certificates/proposed" / f"{uid}.pdf"
    content = kept.read_bytes()
    kept.write_bytes(content + b"x")
    changed = run("proposal", "approve", uid, "--store", "lab", *CHIEF)
    assert changed.code == 1
    assert "is not the file that was proposed" in changed.err
    kept.write_bytes(content)
    done = run("proposal", "approve", uid, "--store", "lab", *CHIEF)
    assert done.code == 0, done.err
    assert not is_genuine("a.pdf")  # it says across each page that it is proposed
    (folder / "issued.pdf").write_bytes(content)
    assert is_genuine("issued.pdf")
    assert (folder / "lab/certificates" / f"{number}.pdf").read_bytes() == content
    shown = run("audit", "--unit", UNIT, "--store", "lab", "--json").json
    kinds = ("ActProposed", "CertificateIssued")
    of_certificate = [(each["kind"], each["identity"]) for each in shown if each["kind"] in kinds]
    assert of_certificate == [("ActProposed", "approver:lead"), ("CertificateIssued", "approver:chief")]
    assert run("verify", "--store", "lab").code == 0
    station = run("certificate", "--security", "site/station/c1", "verify", "issued.pdf", "--store", "lab", "--json")
    assert station.json["genuine"]  # who only looks needs no certificate of a role


@pytest.mark.long
def test_what_is_approved_is_what_the_store_gives_by_then(site: tuple[Path, Callable[..., Any]]) -> None:
    folder, run = site

    asked = run(*ORDERED, "--out", "a.pdf", "--lang", "en", *LEAD)
    assert asked.code == 0, asked.err
    assert "PROPOSED" in "".join(pages_of(folder / "a.pdf"))
    station = (folder / "station.toml").read_text(encoding="utf-8")
    (folder / "other.toml").write_text(station.replace("U = 1e-4", "U = 9e-4"), encoding="utf-8")
    again = ("--unit", UNIT, "--station", "other.toml", "--store", "lab", "--restate")
    restated = run("import", "scale.csv", *again, "--start", "2026-03-02T09:00:00+08:00")
    assert restated.code == 0, restated.err
    refused = run("proposal", "approve", asked.json["proposal"], "--store", "lab", *CHIEF)
    assert refused.code == 1
    assert "gives other results by now" in refused.err
    assert run("proposal", "reject", asked.json["proposal"], "--reason", "restated", "--store", "lab", *CHIEF).code == 0
    # one certificate of a table with two uncertainties, of two runs, is a contradiction
    draft = run(*ORDERED, "--out", "b.pdf", "--lang", "en", *LEAD).json
    assert draft["is_draft"]
    assert any("stated with different validity or uncertainty" in each for each in draft["missing"])
    bias = ("--start", "2026-03-02T13:00:00+08:00", "--procedure", "static_bias", "--position", "IRA_up")
    assert run("import", "bias.csv", *again, *bias).code == 0
    # the number of a rejected one is not given again
    number = run(*ORDERED, "--out", "b.pdf", "--lang", "en", *LEAD).json["number"]
    assert int(number[-4:]) == int(asked.json["number"][-4:]) + 1
