"""Whether the files of issued certificates in a store are those that were issued."""

from collections.abc import Iterator

from analytics.certificate.record import FOLDER, Certificates, file_of, kept_file, read_certificates, sha256_of
from storage.findings import Finding, Severity
from storage.sql.catalog import Catalog
from storage.store import Store
from storage.store_marker import is_replica
from stream.errors import StoreError

_REMEDY = (
    "put the file back from a copy or a backup, whose SHA-256 the log has: `gyrofleet certificate verify FILE` knows it"
)


def certificate_findings(store: Store) -> list[Finding]:
    """Files in ``certificates`` that are missing or changed, and those that were never issued.

    An entry point in the group `gyrofleet.verify`.
    """
    try:
        with Catalog(store) as catalog:
            known = read_certificates(store, catalog)
    except StoreError:
        return []  # the log or the lake is damaged, which its own check reports
    return [*_changed(store, known), *_unknown(store, known)]


def _changed(store: Store, known: Certificates) -> Iterator[Finding]:
    absent = Severity.NOTE if is_replica(store.folder) else Severity.DAMAGE  # files may arrive after documents
    for document in known.issued:
        number, unit = document.number, document.unit
        for suffix, sha256 in ((".pdf", document.sha256), (".xml", document.digital_sha256)):
            path = kept_file(store, number, suffix)
            try:
                found = sha256_of(path.read_bytes())
            except OSError:
                what = f"the file of certificate {number} of {unit} is missing"
                yield Finding("certificate_missing", absent, str(file_of(store, number, suffix)), what, _REMEDY)
                continue
            if found != sha256:
                what = f"it is not the file that was issued as certificate {number} of {unit}"
                yield Finding("certificate_changed", Severity.DAMAGE, str(path), what, _REMEDY)


def _unknown(store: Store, known: Certificates) -> Iterator[Finding]:
    issued = {kept_file(store, each.number, suffix) for each in known.issued for suffix in (".pdf", ".xml")}
    for path in sorted((store.folder / FOLDER).glob("*")):
        if path.suffix in {".pdf", ".xml"} and path.is_file() and path not in issued:
            what = "this store never issued it, or was interrupted as it did: it is no certificate"
            yield Finding("certificate_not_issued", Severity.NOTE, str(path), what, "delete it")
