"""Issuing a certificate: its content from the store, its files, and the document in the log that makes it one."""

import datetime as dt
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple
from zoneinfo import ZoneInfo

import msgspec

from analytics.certificate.document.digital import digital_certificate
from analytics.certificate.document.figures import figures_of
from analytics.certificate.document.layout import certificate_pdf
from analytics.certificate.record import (
    FOLDER,
    Certificates,
    append_certificate,
    file_of,
    proposed_file,
    proposed_numbers,
    read_certificates,
    sha256_of,
    waiting_certificates,
)
from analytics.certificate.reproduction import changed_results, changed_statements, check_records
from analytics.certificate.statement.conformity import read_conformity
from analytics.certificate.statement.content import Content, Facts, content_of
from analytics.certificate.statement.departures import departures, left_out
from analytics.certificate.statement.evidence import read_evidence
from analytics.certificate.statement.order import Order
from analytics.certificate.statement.results import ordered_rows, result_rows
from analytics.certificate.statement.standards import Standard
from analytics.certificate.statement.validity import later
from analytics.certificate.statement.words import Language, Words, clause_in_chinese
from analytics.evaluation.inner_page import inner_page
from storage.recording.acts.proposing import carried_out, check_may_propose, has_to_be_proposed, propose
from storage.recording.acts.two_persons import Proposal
from storage.specifications.chain import read_chain
from storage.sql.catalog import Catalog
from storage.store import Store, only_one
from stream.errors import BadInput, StoreError
from stream.events import CertificateIssued, new_uid
from stream.files.atomic_file import write_durably
from stream.security.actor import Actor

_WHO = "gyrofleet certificate"


class Wanted(NamedTuple):
    """The certificate that is asked for."""

    unit: str
    standard: Standard
    order: Order
    language: Language
    out: Path
    number: str = ""
    supersedes: str = ""
    reason: str = ""
    as_draft: bool = False
    sign: Callable[[bytes], bytes] | None = None
    by: Actor = Actor("")


class Issued(msgspec.Struct, frozen=True, kw_only=True):
    """What was written: a certificate, or a draft that lists what is missing."""

    number: str | None
    is_draft: bool
    missing: list[str]
    missing_zh: list[str]
    deviations: list[str]  # in what the records depart from the clauses
    compensated: list[str]  # signals of results that an error model has compensated
    left_out: list[str]  # runs since the item was received that are excluded from evaluation
    sha256: str
    digital: str  # path of the digital certificate
    valid_until: str | None
    proposal: str | None = None  # uid of the proposal, where another person has to approve it


def issue_certificate(catalog: Catalog, wanted: Wanted) -> Issued:
    """Write a certificate and enter it in the log; a draft, which is not entered, where anything is missing.

    Beside the PDF the digital certificate is written as XML. An issued certificate is also kept in the store. Where two
    persons are needed it is proposed: its files are kept, and it is issued once another person approves. Raises
    BadInput if the number is taken, or if another certificate rests on the same runs and is not superseded; NotFound if
    the unit is not in the store; StoreError if a file or the log cannot be written.
    """
    store = catalog.store
    rows = ordered_rows(result_rows(inner_page(catalog, wanted.unit, wanted.standard.name)), wanted.order.items)
    runs = sorted({run for row in rows for each in row.results for run in each.runs})
    evidence = read_evidence(catalog, wanted.unit, runs)
    now = dt.datetime.now(ZoneInfo(evidence.time_zone)).replace(microsecond=0)
    asked = wanted.order.conformity
    facts = Facts(
        wanted.standard, wanted.order, evidence, rows, "", now.date(), wanted.supersedes, wanted.reason,
        None if asked is None else read_conformity(catalog, wanted.unit, asked.specification, rows),
    )  # fmt: skip
    content = content_of(facts)
    if content.missing or wanted.as_draft:
        pdf, digital = _files(catalog, content, wanted, now)
        return _written(wanted, pdf, digital, content, None)
    check_records(catalog, runs)
    with only_one(store.folder / FOLDER / ".lock", _WHO):
        check_may_propose(store, CertificateIssued, wanted.by)
        is_proposed = has_to_be_proposed(store, CertificateIssued)
        waiting = waiting_certificates(store) if is_proposed else []
        issued = read_certificates(store, catalog)
        numbered = Certificates([*issued.issued, *waiting])
        taken = proposed_numbers(store)
        number = wanted.number or numbered.next_number(wanted.order.number_prefix, now.year, taken)
        _check(issued, wanted, number, set(runs))
        _check_waiting(waiting, wanted, number, set(runs))
        content = content_of(facts._replace(number=number))
        pdf, digital = _files(catalog, content, wanted, now)
        if wanted.sign is not None:
            pdf = wanted.sign(pdf)
        document = _document(content, wanted, pdf, digital, read_chain(store, catalog).head)
        if is_proposed:
            uid = _propose(store, wanted, document, pdf, digital)
            shown, _ = _files(catalog, content, wanted, now, is_proposed=True)
            found = _written(wanted, shown, digital, content, document)
            return msgspec.structs.replace(found, proposal=uid)
        _write(file_of(store, number), pdf)
        _write(file_of(store, number, ".xml"), digital)
        found = _written(wanted, pdf, digital, content, document)
        append_certificate(store, document)
    return found


def _propose(store: Store, wanted: Wanted, document: CertificateIssued, pdf: bytes, digital: bytes) -> str:
    """Keep the files of a certificate that another person has to approve, and propose it; the uid."""
    uid = new_uid()
    for suffix, content in ((".pdf", pdf), (".xml", digital)):
        path = proposed_file(store, uid, suffix)
        path.parent.mkdir(parents=True, exist_ok=True)
        _write(path, content)
    propose(store, document, by=wanted.by, reason=wanted.reason, unit=document.unit, uid=uid)
    return uid


def carry_out(catalog: Catalog, proposal: Proposal, by: Actor) -> CertificateIssued:
    """Issue a certificate that was proposed, as another person who approves it; BadInput if it cannot be any more."""
    store, act = catalog.store, proposal.act
    assert isinstance(act, CertificateIssued)
    with only_one(store.folder / FOLDER / ".lock", _WHO):
        _check_free(read_certificates(store, catalog), act)
        files: dict[str, bytes] = {}
        for suffix, sha256 in ((".pdf", act.sha256), (".xml", act.digital_sha256)):
            path = proposed_file(store, proposal.document.uid, suffix)
            try:
                files[suffix] = path.read_bytes()
            except OSError as error:
                raise StoreError(f"{path} cannot be read: {error.strerror or error}; propose it again") from error
            if sha256_of(files[suffix]) != sha256:
                raise StoreError(f"{path} is not the file that was proposed; reject the proposal, and propose it again")
        if changed := changed_results(catalog, act) + changed_statements(catalog, act, files[".xml"]):
            raise BadInput(
                f"the store gives other results by now than certificate {act.number} states ({'; '.join(changed)}): "
                "reject the proposal, and propose it again"
            )
        document = carried_out(proposal, act, by)
        for suffix, content in files.items():
            _write(file_of(store, act.number, suffix), content)
        append_certificate(store, document)
    return document


def _check_free(issued: Certificates, act: CertificateIssued) -> None:
    """Refuse a certificate whose number is taken, or that would stand beside or replace another one than proposed."""
    if issued.by_number(act.number) is not None:
        raise BadInput(f"certificate {act.number} is issued already; reject the proposal")
    if act.supersedes and (successor := issued.successor(act.supersedes)) is not None:
        raise BadInput(f"certificate {act.supersedes} is superseded by {successor.number} already; reject the proposal")
    for each in issued.in_force(act.unit, act.standard):
        if each.number != act.supersedes and set(act.runs) & set(each.runs):
            raise BadInput(f"certificate {each.number} of {act.unit} rests on the same runs; reject the proposal")


def _check_waiting(waiting: Sequence[CertificateIssued], wanted: Wanted, number: str, runs: set[str]) -> None:
    for each in waiting:
        is_alike = each.unit == wanted.unit and each.standard == wanted.standard.name and runs & set(each.runs)
        if each.number == number or is_alike:
            raise BadInput(
                f"certificate {each.number} of {each.unit} waits for another person to approve it: approve or reject "
                "it first (`gyrofleet proposal list`)"
            )


def _check(issued: Certificates, wanted: Wanted, number: str, runs: set[str]) -> None:
    if issued.by_number(number) is not None:
        raise BadInput(f"certificate {number} is issued already; leave --number out for the next free one")
    if wanted.supersedes:
        old = issued.by_number(wanted.supersedes)
        if old is None or old.unit != wanted.unit:
            known = ", ".join(each.number for each in issued.in_force(wanted.unit, wanted.standard.name)) or "none"
            raise BadInput(
                f"--supersedes {wanted.supersedes}: no certificate of {wanted.unit} has it; there are {known}"
            )
        if (successor := issued.successor(old.number)) is not None:
            raise BadInput(f"certificate {old.number} is superseded by {successor.number} already")
        if not wanted.reason:
            raise BadInput(f"--supersedes {old.number} needs a --reason")
    for each in issued.in_force(wanted.unit, wanted.standard.name):
        if each.number != wanted.supersedes and runs & set(each.runs):
            raise BadInput(
                f"certificate {each.number} of {wanted.unit} rests on the same runs; replace it with "
                f"--supersedes {each.number} --reason TEXT"
            )


def _files(
    catalog: Catalog, content: Content, wanted: Wanted, now: dt.datetime, *, is_proposed: bool = False
) -> tuple[bytes, bytes]:
    """The PDF and the digital certificate; a PDF that is only proposed is marked as such."""
    release = version("gyrofleet")
    digital = digital_certificate(content, release=release, supersedes=wanted.supersedes)
    data = sha256_of(results_of(content).encode())
    digest = "数据 SHA-256" if wanted.language == "zh" else "data SHA-256"
    pdf = certificate_pdf(
        content, figures_of(catalog, wanted.unit, content.facts.rows), wanted.language, attached=digital,
        mark=f"gyrofleet {release}, {digest} {data}", set_at=now.astimezone(dt.UTC), is_proposed=is_proposed,
    )  # fmt: skip
    return pdf, digital


def _document(
    content: Content, wanted: Wanted, pdf: bytes, digital: bytes, specification: str
) -> CertificateIssued:  # fmt: skip
    facts, results = content.facts, results_of(content)
    days = facts.evidence.days
    assert days is not None  # otherwise it is a draft
    return CertificateIssued(
        run="", t_ns=time.time_ns(), number=facts.number, unit=wanted.unit, standard=wanted.standard.name,
        language=wanted.language, sha256=sha256_of(pdf), digital_sha256=sha256_of(digital),
        data_sha256=sha256_of(results.encode()), results=results,
        runs=tuple(run.run for run in facts.evidence.runs),
        valid_until="" if wanted.order.valid_months is None else later(days[1], wanted.order.valid_months).isoformat(),
        by=Words.of(wanted.order.people.issued_by).en, software=f"gyrofleet {version('gyrofleet')}",
        identity=wanted.by.identity, specification=specification, supersedes=wanted.supersedes, reason=wanted.reason,
    )  # fmt: skip


def results_of(content: Content) -> str:
    """The results as JSON, of which the log keeps the text and its hash."""
    return msgspec.json.encode(content.facts.rows, order="sorted").decode()


def _written(
    wanted: Wanted, pdf: bytes, digital: bytes, content: Content, document: CertificateIssued | None
) -> Issued:
    beside = wanted.out.with_suffix(".xml")
    _write(beside, digital)
    _write(wanted.out, pdf)
    return Issued(
        number=None if document is None else document.number, is_draft=document is None,
        missing=[f"{clause}: {each.en}" if clause else each.en for clause, each in content.missing],
        missing_zh=[f"{clause_in_chinese(at)}：{each.zh}" if at else each.zh for at, each in content.missing],
        sha256=sha256_of(pdf),
        deviations=[each.en for each in departures(content.facts.rows)],
        compensated=sorted({each.signal for row in content.facts.rows for each in row.results if each.is_compensated}),
        left_out=[each.en for each in left_out(content.facts.evidence.excluded, wanted.order.device.received)],
        digital=str(beside), valid_until=document.valid_until or None if document is not None else None,
    )  # fmt: skip


def _write(path: Path, content: bytes) -> None:
    try:
        write_durably(path, content)
    except OSError as error:
        raise StoreError(f"cannot write {path}: {error.strerror or error}") from error
