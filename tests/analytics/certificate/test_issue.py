"""Issued certificates: numbers, what supersedes what, files that were changed, forged documents, signatures."""

import datetime as dt
import hashlib
import shutil
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import msgspec
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import NameOID
from pypdf import PdfWriter

from analytics.certificate.document.signature import check_signature, sign
from analytics.certificate.kept_files import certificate_findings
from analytics.certificate.record import file_of, read_certificates
from storage.attestation.attestation import kept_attestations, read_attestation
from storage.attestation.signing_key import create_key, default_key
from storage.log.store_documents import forgery, sealed
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.errors import BadInput
from stream.events import CertificateIssued
from tests.analytics.certificate.conftest import ORDERED, UNIT
from tests.analytics.certificate.keys import write_key
from tests.analytics.certificate.pdf_checks import pages_of

DCC = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}


@pytest.fixture(scope="module")
def issued(
    laboratory: Path, run_command: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, dict[str, Any]]:
    """A copy of the store in which one certificate is issued, and what the command answered."""
    folder = tmp_path_factory.mktemp("issued") / "copy"
    shutil.copytree(laboratory, folder)
    done = run_command(*ORDERED, "--out", "first.pdf", "--lang", "en", cwd=folder)
    assert done.code == 0, done.err
    return folder, done.json


def verified(run_command: Callable[..., Any], folder: Path, name: str) -> tuple[int, dict[str, Any]]:
    done = run_command("certificate", "verify", name, "--store", "lab", "--json", cwd=folder)
    return done.code, done.json


@pytest.fixture(params=["signed", pytest.param("unsigned", marks=pytest.mark.long)])
def whole(request: pytest.FixtureRequest) -> tuple[Path, dict[str, Any], str]:
    """A folder with a whole certificate, what the command answered, and the name of the certificate."""
    folder, answer = request.getfixturevalue("certified" if request.param == "signed" else "issued")
    return folder, answer, "signed" if request.param == "signed" else "first"


def test_a_whole_certificate_is_issued_and_kept(whole: tuple[Path, dict[str, Any], str]) -> None:
    folder, answer, name = whole
    assert answer["missing"] == []
    assert not answer["is_draft"]
    assert answer["number"] == f"GYL-{dt.datetime.now(dt.UTC).year}-0001"
    assert answer["valid_until"] == "2027-03-01"
    kept = folder / "lab" / "certificates" / f"{answer['number']}.pdf"
    assert kept.read_bytes() == (folder / f"{name}.pdf").read_bytes()


@pytest.mark.long  # the gate verifies a signed one
def test_a_whole_certificate_is_genuine_and_valid(
    issued: tuple[Path, dict[str, Any]], run_command: Callable[..., Any]
) -> None:
    folder, answer = issued
    code, found = verified(run_command, folder, "first.pdf")
    assert (code, found["genuine"], found["number"]) == (0, True, answer["number"])


@pytest.mark.long
def test_one_changed_byte_is_noticed(issued: tuple[Path, dict[str, Any]], run_command: Callable[..., Any]) -> None:
    folder, _ = issued
    content = bytearray((folder / "first.pdf").read_bytes())
    content[len(content) // 2] ^= 1
    (folder / "changed.pdf").write_bytes(content)
    code, found = verified(run_command, folder, "changed.pdf")
    assert (code, found["genuine"], found["valid"]) == (1, False, False)


def test_the_digital_certificate_has_the_results_with_u_and_k(
    whole: tuple[Path, dict[str, Any], str], laboratory: Path, run_command: Callable[..., Any]
) -> None:
    folder, answer, name = whole
    root = ET.parse(folder / f"{name}.xml").getroot()
    assert root.findtext(".//dcc:uniqueIdentifier", namespaces=DCC) == answer["number"]
    assert root.findtext(".//dcc:item//dcc:value", namespaces=DCC) == UNIT
    rows = run_command("metrics", "--annex-a", UNIT, "--store", "lab", "--json", cwd=laboratory).json["rows"]
    values = [each["value"] for row in rows for each in row["results"]]
    quantities = root.findall(".//dcc:result//dcc:quantity", DCC)
    assert len(quantities) == len(values)
    for quantity, value in zip(quantities, values, strict=True):
        number = float(quantity.findtext("si:real/si:value", namespaces=DCC) or "nan")
        u = float(quantity.findtext(".//si:valueExpandedMU", namespaces=DCC) or "nan")
        assert abs(number - value) <= 0.05 * u
        assert float(quantity.findtext(".//si:coverageFactor", namespaces=DCC) or "nan") >= 2


@pytest.mark.long
def test_a_new_one_on_the_same_runs_has_to_supersede(
    issued: tuple[Path, dict[str, Any]], run_command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, answer = issued
    monkeypatch.setenv("XDG_CONFIG_HOME", str(folder / "home"))
    create_key(default_key())
    refused = run_command(*ORDERED, "--out", "second.pdf", cwd=folder)
    assert refused.code == 1
    assert f"--supersedes {answer['number']}" in refused.out
    assert not (folder / "second.pdf").exists()
    unreasoned = run_command(*ORDERED, "--out", "second.pdf", "--supersedes", answer["number"], cwd=folder)
    assert "--reason" in unreasoned.out
    more = ("--supersedes", answer["number"], "--reason", "model corrected", "--out", "second.pdf", "--lang", "en")
    second = run_command(*ORDERED, *more, cwd=folder)
    assert second.code == 0, second.err
    (attested,) = kept_attestations(Store.open(folder / "lab"))  # who has a key anchors the history with each
    assert f"certificates/{second.json['number']}.pdf" in [
        each.path for each in read_attestation(attested).stated.files
    ]
    code, found = verified(run_command, folder, "first.pdf")
    assert (code, found["genuine"], found["valid"]) == (1, True, False)
    assert found["superseded_by"] == second.json["number"]
    audit = run_command("audit", "--unit", UNIT, "--store", "lab", "--json", cwd=folder).json
    assert [each["document"]["number"] for each in audit if each["kind"] == "CertificateIssued"] == [
        answer["number"], second.json["number"],
    ]  # fmt: skip
    assert [each["by"] for each in audit if each["kind"] == "CertificateIssued"] == ["Chen Gang"] * 2


def test_a_document_without_the_seal_of_the_store_is_no_certificate(
    certified: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    store = Store.open(Path(shutil.copytree(certified[0] / "lab", tmp_path / "lab")))
    with Catalog(store) as catalog:
        own = read_certificates(store, catalog).issued[0]
    assert forgery(store, own) is None
    forged = msgspec.structs.replace(own, number="GYL-2026-9999", uid="f")
    assert "seal" in str(forgery(store, forged))
    assert forgery(store, sealed(store, forged)) is None
    assert "another store" in str(forgery(store, msgspec.structs.replace(own, store="5e")))
    assert isinstance(own, CertificateIssued)


def test_a_signature_holds_until_a_byte_is_changed(tmp_path: Path) -> None:
    written = BytesIO()
    writer = PdfWriter()
    writer.add_blank_page(595, 842)
    writer.write(written)
    pdf = written.getvalue()
    private, root = write_key(tmp_path)
    assert check_signature(pdf, None) is None
    with pytest.raises(BadInput, match="another passphrase"):
        sign(pdf, private, "wrong", reason="issue")
    signed = sign(pdf, private, "open", reason="issue")
    found = check_signature(signed, root)
    assert found is not None
    assert (found.intact, found.trusted) == (True, True)
    assert "Gyro Calibration Laboratory" in found.by
    stranger = check_signature(signed, None)
    assert stranger is not None
    assert (stranger.intact, stranger.trusted) == (True, False)
    changed = bytearray(signed)
    changed[len(pdf) // 2] ^= 1
    found = check_signature(bytes(changed), root)
    assert found is None or not found.intact


@pytest.mark.long
def test_what_was_not_ordered_is_not_stated(laboratory: Path, run_command: Callable[..., Any], tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(laboratory, folder)
    order = (folder / "order.toml").read_text(encoding="utf-8")
    words = tuple(each if each != "order.toml" else "ordered.toml" for each in ORDERED)
    (folder / "ordered.toml").write_text('items = ["scalefactor"]\n' + order, encoding="utf-8")
    refused = run_command(*words, "--out", "a.pdf", "--lang", "en", cwd=folder)
    assert refused.code != 0
    assert "items has 'scalefactor'" in refused.out
    assert "scale_factor" in refused.out
    (folder / "ordered.toml").write_text('items = ["scale_factor"]\nremarks = "by rack 7"\n' + order, encoding="utf-8")
    done = run_command(*words, "--out", "a.pdf", "--lang", "en", cwd=folder)
    assert (done.code, done.json["is_draft"]) == (0, False), done.out
    text = "".join(pages_of(folder / "a.pdf"))
    assert "95.45%" in text
    assert "byrack7" in text
    results = ET.parse(folder / "a.xml").getroot().findall(".//dcc:result", DCC)
    assert results
    with Catalog(Store.open(folder / "lab")) as catalog:
        (document,) = read_certificates(catalog.store, catalog).issued
    stated = {row["metric"] for row in msgspec.json.decode(document.results) if row["results"]}
    assert stated == {"scale_factor"}
    # it names the one that it replaces, and why
    more = ("--out", "b.pdf", "--lang", "en", "--supersedes", done.json["number"], "--reason", "model corrected")
    assert run_command(*ORDERED, *more, cwd=folder).code == 0
    assert f"replaces{done.json['number']}:modelcorrected" in "".join(pages_of(folder / "b.pdf"))


@pytest.mark.long
def test_an_unsigned_one_is_trusted_by_nobody_and_the_digital_one_is_known(
    issued: tuple[Path, dict[str, Any]], run_command: Callable[..., Any]
) -> None:
    folder, answer = issued
    key = rsa.generate_private_key(public_exponent=65537, key_size=2048)
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "root")])
    now = dt.datetime.now(dt.UTC)
    built = x509.CertificateBuilder().subject_name(name).issuer_name(name).public_key(key.public_key())
    dated = built.serial_number(1).not_valid_before(now).not_valid_after(now + dt.timedelta(days=1))
    (folder / "root.pem").write_bytes(dated.sign(key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM))
    words = ("certificate", "verify", "--store", "lab", "--json")
    done = run_command(*words, "first.pdf", "--trust", "root.pem", cwd=folder)
    assert (done.code, done.json["genuine"], done.json["valid"]) == (1, True, False)
    assert any("not signed" in each for each in done.json["why"])
    digital = run_command(*words, "first.xml", cwd=folder)
    found = digital.json
    assert (found["genuine"], found["number"], found["signature"]) == (True, answer["number"], None)
    (folder / "forged.xml").write_bytes((folder / "first.xml").read_bytes().replace(b"G-0042", b"G-0043"))
    assert run_command(*words, "forged.xml", cwd=folder).json["genuine"] is False


def test_no_two_numbers_have_one_file() -> None:
    store = Store(Path("lab"), "1f")
    numbers = ["GYL-1", "GYL/1", "GYL 1", "GYL_1", "../GYL-1"]
    paths = {file_of(store, each) for each in numbers}
    assert len(paths) == len(numbers)
    assert {path.parent for path in paths} == {Path("lab/certificates")}


@pytest.mark.long
def test_results_are_of_the_records_and_not_of_what_was_kept_or_changed(
    laboratory: Path, run_command: Callable[..., Any], tmp_path: Path
) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(laboratory, folder)
    assert run_command("metrics", "--store", "lab", "--json", cwd=folder).code == 0
    kept = folder / "lab/metrics/unit_metrics.parquet"
    table = pq.read_table(kept)
    at = table.column_names.index("value")
    larger = pc.multiply(table["value"], 1.003)
    pq.write_table(table.set_column(at, table.schema.field(at), larger), kept)
    kept.with_name(kept.name + ".sha256").write_text(hashlib.sha256(kept.read_bytes()).hexdigest())
    done = run_command(*ORDERED, "--out", "a.pdf", "--lang", "en", cwd=folder)
    assert done.code == 0, done.out
    with Catalog(Store.open(folder / "lab")) as catalog:
        (document,) = read_certificates(catalog.store, catalog).issued
    values = {row["metric"]: row["results"] for row in msgspec.json.decode(document.results)}
    (scale_factor,) = values["scale_factor"]
    assert scale_factor["value"] == pytest.approx(1 + 50e-6, abs=5e-6)
    # nor does a log with one bit changed, though the lake is whole
    segment = max((folder / "lab/log").glob("*.mcap"), key=lambda path: path.stat().st_size)
    recorded = segment.read_bytes()
    segment.write_bytes(recorded[:9000] + bytes([recorded[9000] ^ 1]) + recorded[9001:])
    code, found = verified(run_command, folder, "a.pdf")
    assert (code, found["genuine"]) == (1, True)
    assert "is not what was recorded" in found["changed"][0]
    segment.write_bytes(recorded)
    # a file of the lake that is another certifies nothing
    for part in (folder / "lab/lake").glob("*/samples.parquet"):
        pq.write_table(pq.read_table(part), part, compression="zstd", compression_level=9)
    code, found = verified(run_command, folder, "a.pdf")
    assert (code, found["genuine"]) == (1, True)
    assert "is not the file that was built from the log" in found["changed"][0]
    more = ("--out", "b.pdf", "--supersedes", done.json["number"], "--reason", "again")
    refused = run_command(*ORDERED, *more, "--lang", "en", cwd=folder)
    assert refused.code != 0
    assert "is not the file that was built from the log" in refused.out


def test_verify_finds_kept_files_that_are_changed_missing_or_never_issued(
    certified: tuple[Path, dict[str, Any]], run_command: Callable[..., Any], tmp_path: Path
) -> None:
    folder, answer = certified
    shutil.copytree(folder / "lab", tmp_path / "lab")
    kept = tmp_path / "lab" / "certificates"
    assert certificate_findings(Store.open(tmp_path / "lab")) == []
    pdf, xml = kept / f"{answer['number']}.pdf", kept / f"{answer['number']}.xml"
    pdf.write_bytes(pdf.read_bytes() + b"\n")
    xml.unlink()
    (kept / "GYL-2026-0999.pdf").write_bytes(b"%PDF-1.7")
    done = run_command("verify", "--store", "lab", "--json", cwd=tmp_path)
    assert done.code != 0
    found = {(each["kind"], Path(each["where"]).name) for each in done.json["findings"]}
    assert found == {
        ("certificate_changed", pdf.name), ("certificate_missing", xml.name),
        ("certificate_not_issued", "GYL-2026-0999.pdf"),
    }  # fmt: skip


@pytest.mark.long
def test_verify_finds_nothing_in_a_store_with_a_certificate(
    issued: tuple[Path, dict[str, Any]], run_command: Callable[..., Any]
) -> None:
    assert run_command("verify", "--store", "lab", "--json", cwd=issued[0]).json["findings"] == []
