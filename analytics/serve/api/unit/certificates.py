"""Certificates of a unit, and their files as they were issued."""

from typing import TYPE_CHECKING

import msgspec

from analytics.serve.answer_cache import Answer
from analytics.serve.api.encoding import Form
from analytics.serve.api.operation import Call, Nothing, get, link
from analytics.serve.api.rows import iso
from stream.errors import NotFound

if TYPE_CHECKING:
    from analytics.certificate.record import Certificates


class CertificateRow(msgspec.Struct, frozen=True, kw_only=True):
    """An issued certificate: valid until `valid_until` (its last day) unless another supersedes it.

    `valid_until` is None where no interval was agreed. `pdf` is the address of the file as it was issued, None where
    the store no longer has it.
    """

    number: str
    unit: str
    standard: str
    language: str
    issued_ns: int
    issued: str | None
    valid_until: str | None
    by: str
    superseded_by: str | None
    superseded_for: str | None  # the reason
    supersedes: str | None
    sha256: str
    runs: list[str]
    software: str
    pdf: str | None


class CertificatePdf(msgspec.Struct, frozen=True, kw_only=True):
    """The PDF of a certificate."""

    number: str
    content: bytes

    def encoded(self, form: Form) -> Answer:
        """The file itself, whatever form is asked for."""
        del form
        return Answer(self.content, "application/pdf")


def certificates_of(call: Call, unit: str) -> list[CertificateRow]:
    """The certificates of a unit, the latest first; documents without the seal of the store are none."""
    from analytics.certificate.record import kept_file

    known = _logged(call)
    rows = []
    for each in known.issued:
        if each.unit != unit:
            continue
        successor = known.successor(each.number)
        is_kept = kept_file(call.store, each.number).is_file()
        rows.append(
            CertificateRow(
                number=each.number, unit=each.unit, standard=each.standard, language=each.language,
                issued_ns=each.t_ns, issued=iso(each.t_ns), valid_until=each.valid_until or None, by=each.by,
                superseded_by=None if successor is None else successor.number,
                superseded_for=None if successor is None else successor.reason, supersedes=each.supersedes or None,
                sha256=each.sha256, runs=list(each.runs), software=each.software,
                pdf=link("api", "certificates", each.number, "pdf") if is_kept else None,
            )
        )  # fmt: skip
    return rows[::-1]


def _logged(call: Call) -> "Certificates":
    """All certificates, those of all units found once for each version of the documents."""
    from analytics.certificate.record import logged_certificates

    key = ("certificates", call.state.documents_tag)
    found: Certificates = call.service.memo.result(key, lambda: logged_certificates(call.store, call.fresh))
    return found


@get("/api/certificates/{number:path}/pdf", is_kept=False, media_type="application/pdf")
def certificate_pdf(call: Call, asked: Nothing) -> CertificatePdf:
    """The PDF of an issued certificate, byte for byte."""
    from analytics.certificate.record import kept_file, sha256_of

    del asked
    number = call.path["number"]
    known = _logged(call).by_number(number)
    if known is None:
        raise NotFound(f"no certificate {number!r} is issued by this store")
    path = kept_file(call.store, number)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise NotFound(f"the PDF of certificate {number} is no longer in the store: {error.strerror}") from error
    if sha256_of(content) != known.sha256:
        raise NotFound(f"the PDF of certificate {number} in the store is changed: it is not the file that was issued")
    return CertificatePdf(number=number, content=content)
