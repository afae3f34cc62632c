"""What a signer and a customer may do with certificates: keys, changed files, other stores, changed records, pages."""

import hashlib
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from storage.specifications.chain import read_chain
from storage.store import Store
from tests.analytics.certificate.conftest import ORDERED, UNIT
from tests.analytics.certificate.keys import write_key
from tests.analytics.serve.conftest import TOKEN, start
from tests.forked_commands import CommandServer


@pytest.fixture(scope="module")
def signed(
    certified: tuple[Path, dict[str, Any]], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, dict[str, Any]]:
    """A copy of the store with a signed certificate."""
    return Path(shutil.copytree(certified[0], tmp_path_factory.mktemp("signed") / "copy")), certified[1]


def verified(run_command: Callable[..., Any], folder: Path, name: str, *more: str) -> tuple[int, dict[str, Any]]:
    done = run_command("certificate", "verify", name, "--store", "lab", "--json", *more, cwd=folder)
    return done.code, done.json


@pytest.mark.long
def test_a_wrong_passphrase_takes_no_number(laboratory: Path, run_command: Callable[..., Any], tmp_path: Path) -> None:
    folder = Path(shutil.copytree(laboratory, tmp_path / "copy"))
    write_key(folder)
    words = (*ORDERED, "--out", "signed.pdf", "--lang", "en", "--key", "key.p12")
    wrong = run_command(*words, "--key-passphrase", "shut", cwd=folder)
    assert wrong.code == 1
    assert "another passphrase" in wrong.json["error"]["message"]
    assert not (folder / "signed.pdf").exists()
    done = run_command(*words, "--key-passphrase", "open", cwd=folder)
    assert done.code == 0, done.err
    assert done.json["number"].endswith("-0001")


def test_a_signed_one_is_genuine_and_trusted_by_its_root(
    signed: tuple[Path, dict[str, Any]], run_command: Callable[..., Any]
) -> None:
    folder, answer = signed
    code, found = verified(run_command, folder, "signed.pdf", "--trust", "root.pem")
    assert (code, found["genuine"], found["valid"], found["changed"]) == (0, True, True, [])
    assert found["number"] == answer["number"]
    assert (found["signature"]["intact"], found["signature"]["trusted"]) == (True, True)
    content = bytearray((folder / "signed.pdf").read_bytes())
    content[len(content) // 3] ^= 1
    (folder / "tampered.pdf").write_bytes(content)
    code, found = verified(run_command, folder, "tampered.pdf", "--trust", "root.pem")
    assert (code, found["genuine"], found["valid"]) == (1, False, False)
    assert found["signature"] is None or not found["signature"]["intact"]


@pytest.mark.long
def test_another_store_does_not_know_it(
    signed: tuple[Path, dict[str, Any]], laboratory: Path, run_command: Callable[..., Any], tmp_path: Path
) -> None:
    shutil.copytree(laboratory / "lab", tmp_path / "lab")
    shutil.copy(signed[0] / "signed.pdf", tmp_path / "signed.pdf")
    code, found = verified(run_command, tmp_path, "signed.pdf")
    assert (code, found["genuine"], found["valid"]) == (1, False, False)
    assert found["why"] == ["no certificate of this store has these bytes: it is changed, a draft, or of another store"]


@pytest.mark.long
def test_records_that_change_after_the_issue_are_noticed(
    signed: tuple[Path, dict[str, Any]], run_command: Callable[..., Any], tmp_path: Path
) -> None:
    """The table's uncertainty turns out to be ten times as large, and the station's file is entered again."""
    shutil.copytree(signed[0], tmp_path / "copy")
    folder = tmp_path / "copy"
    text = (folder / "station.toml").read_text().replace("U = 1e-4", "U = 1e-3")
    assert 'unit = "arcsec"' in text
    (folder / "station.toml").write_text(text.replace('unit = "arcsec"', 'unit = "arcmin"'))
    for name, at in (("scale.csv", "09"), ("bias.csv", "13")):
        again = run_command(
            "import", name, "--unit", UNIT, "--station", "station.toml", "--store", "lab", "--restate",
            "--start", f"2026-03-02T{at}:00:00+08:00", cwd=folder,
        )  # fmt: skip
        assert again.code == 0, again.err
    code, found = verified(run_command, folder, "signed.pdf")
    assert (code, found["genuine"], found["valid"]) == (1, True, True)
    assert any(each.startswith("Scale factor rate (") for each in found["changed"])
    biases = [each for each in found["changed"] if each.startswith("Bias rate (")]
    for each, earth in zip(biases, ("Earth's rate included", "Earth's rate removed"), strict=True):
        assert earth in each
        assert each.count("(U = ") == 2, "compared with its like alone"


@pytest.fixture(scope="module")
def served(
    signed: tuple[Path, dict[str, Any]], run_command: Callable[..., Any], command_server: CommandServer
) -> Iterator[tuple[httpx.Client, Path, list[str]]]:
    """A server over the store, in which a second certificate has superseded the signed one."""
    folder, first = signed
    more = ("--supersedes", first["number"], "--reason", "model corrected", "--out", "second.pdf", "--lang", "en")
    second = run_command(*ORDERED, *more, cwd=folder)
    assert second.code == 0, second.err
    process, ready = start(command_server, "--store", "lab", "--port", 0, "--token", TOKEN, cwd=folder)
    headers = {"Authorization": f"Bearer {TOKEN}"}
    with httpx.Client(base_url=ready["url"], headers=headers, timeout=60.0) as client:
        yield client, folder, [second.json["number"], first["number"]]
    process.terminate()
    process.communicate(timeout=30)


@pytest.mark.long
def test_the_certificates_of_a_unit_are_in_the_api_with_their_files(
    served: tuple[httpx.Client, Path, list[str]],
) -> None:
    client, folder, numbers = served
    rows = client.get(f"/api/units/{UNIT}").json()["certificates"]
    assert [row["number"] for row in rows] == numbers
    new, old = rows
    assert (new["superseded_by"], new["supersedes"]) == (None, numbers[1])
    assert (old["superseded_by"], old["superseded_for"]) == (numbers[0], "model corrected")
    assert (old["valid_until"], old["by"]) == ("2027-03-01", "Chen Gang")
    answer = client.get(old["pdf"])
    assert answer.headers["content-type"] == "application/pdf"
    assert answer.content == (folder / "signed.pdf").read_bytes()
    assert client.get("/api/certificates/GYL-1999-0001/pdf").status_code == 404
    events = client.get(f"/api/units/{UNIT}/audit").json()["events"]
    issued = [(row["en"], row["zh"]) for row in events if row["kind"] == "CertificateIssued"]
    assert issued == [("Certificate issued", "签发证书")] * 2


@pytest.mark.parametrize(
    ("language", "expected"),
    [
        ("en", ("Calibration certificates", "superseded by", "model corrected", "Certificate issued", "Run ended")),
        ("zh", ("校准证书", "有效", "已被替代：", "签发证书", "试验结束", "完成")),
    ],
)
def test_the_page_of_a_unit_lists_them(
    served: tuple[httpx.Client, Path, list[str]], language: str, expected: tuple[str, ...]
) -> None:
    client, _, numbers = served
    page = client.get(f"/units/{UNIT}", params={"lang": language}, headers={"Accept": "text/html"}).text
    table = page.partition('id="unit-certificates"')[2].partition("</table>")[0]
    assert all(number in table for number in numbers)
    assert f'download="{numbers[1]}.pdf"' in table
    for each in expected:
        assert each in page, each


def test_the_log_has_the_hashes_of_data_and_specification(
    signed: tuple[Path, dict[str, Any]], run_command: Callable[..., Any]
) -> None:
    folder, answer = signed
    rows = run_command("audit", "--unit", UNIT, "--store", "lab", "--json", cwd=folder).json
    issued = next(each for each in rows if each["kind"] == "CertificateIssued" and each["what"] == answer["number"])
    document = issued["document"]
    assert document["specification"] == read_chain(Store.open(folder / "lab")).head != ""
    assert document["data_sha256"] == hashlib.sha256(document["results"].encode()).hexdigest()
    assert document["sha256"] == hashlib.sha256((folder / "signed.pdf").read_bytes()).hexdigest()


@pytest.mark.long
def test_the_audit_speaks_chinese(signed: tuple[Path, dict[str, Any]], run_command: Callable[..., Any]) -> None:
    folder, answer = signed
    done = run_command("audit", "--unit", UNIT, "--store", "lab", "--lang", "zh", "--csv", "audit.csv", cwd=folder)
    assert done.code == 0, done.err
    text = (folder / "audit.csv").read_text(encoding="utf-8-sig")
    assert "签发证书" in text
    assert "完成" in text
    assert answer["number"] in text
