"""A store compared with an attestation: nothing that it lists may have changed, gone, or come in another order."""

from collections.abc import Iterator
from itertools import pairwise

from storage.attestation.attestation import Attestation, Statement, entry_digest, kept_attestations, read_attestation
from storage.attestation.signing_key import fingerprint
from storage.findings import Finding, Severity
from storage.manifests.log import LogManifest, read_log_manifest
from storage.segments.disk import sha256_of
from storage.store import Store
from stream.errors import StoreError

_ASK = "what changed it is not known; restore it from a backup or a replica that agrees with the attestation"


def against(store: Store, attestation: Attestation, where: str, signer: str = "") -> list[Finding]:
    """What differs from an attestation; `signer` is the fingerprint of the key that must have signed it.

    The bytes of the segments are compared with the manifest by `gyrofleet verify`, the manifest with the attestation
    here.
    """
    if not attestation.is_genuine:
        what = "its signature is not that of its key and text: it was changed, or never signed"
        return [Finding("attestation_forged", Severity.DAMAGE, where, what, "use the attestation that was kept")]
    by = fingerprint(attestation.public)
    if signer and by != signer:
        what = f"it is signed by the key {by}, not by {signer}"
        return [Finding("attestation_foreign", Severity.DAMAGE, where, what, "ask whose key this is")]
    try:
        stated = attestation.stated
    except StoreError as error:
        return [Finding("attestation_forged", Severity.DAMAGE, where, str(error), "")]
    if stated.store != store.identity:
        what = f"it is of the store {stated.store}, this one is {store.identity}"
        return [Finding("attestation_foreign", Severity.DAMAGE, where, what, "give the attestation of this store")]
    found = read_log_manifest(store, whole=True)
    return [*_segments(store, stated, found), *_order(store, stated, found), *_files(store, stated)]


def own_findings(store: Store) -> Iterator[Finding]:
    """The newest of the store's own attestations compared with it, and the chain of them."""
    kept = kept_attestations(store)
    for before, path in pairwise(kept):
        try:
            previous = read_attestation(path).stated.previous
        except StoreError as error:
            yield Finding("attestation_forged", Severity.DAMAGE, str(path), str(error), _ASK)
            continue
        if previous != sha256_of(before):
            what = f"the attestation before {path.name} is not the one that it names"
            yield Finding("attestation_changed", Severity.DAMAGE, str(before), what, _ASK)
    numbers = [int(path.stem) for path in kept]
    for number in sorted(set(range(1, max(numbers, default=0) + 1)).difference(numbers)):
        what = "the attestation is missing, a later one is there"
        yield Finding("attestation_changed", Severity.DAMAGE, str(kept[-1].with_name(f"{number:08d}.json")), what, _ASK)
    if kept:
        try:
            yield from against(store, read_attestation(kept[-1]), str(kept[-1]))
        except StoreError as error:
            yield Finding("attestation_forged", Severity.DAMAGE, str(kept[-1]), str(error), _ASK)


def _segments(store: Store, stated: Statement, found: LogManifest) -> Iterator[Finding]:
    for each in stated.segments:
        where, entry = str(store.log / each.name), found.entries.get(each.name)
        if entry is None:
            gone = "listed as lost" if each.name in found.lost else "not listed any more"
            what = f"segment {each.name} was attested with SHA-256 {each.sha256[:12]}; it is {gone}"
            yield Finding("attested_missing", Severity.LOSS, where, what, _ASK)
        elif (entry.size, entry.sha256) != (each.size, each.sha256):
            what = (
                f"segment {each.name} was attested with {each.size:,} bytes and SHA-256 {each.sha256[:12]}, it is "
                f"listed with {entry.size:,} and {entry.sha256[:12]}"
            )
            yield Finding("attested_changed", Severity.DAMAGE, where, what, _ASK)
        elif entry_digest(entry) != each.entry:
            what = f"the line of segment {each.name} in the log's manifest is another one than was attested"
            yield Finding("attested_changed", Severity.DAMAGE, where, what, _ASK)


def _order(store: Store, stated: Statement, found: LogManifest) -> Iterator[Finding]:
    attested = list(dict.fromkeys(each.name for each in stated.segments if each.name in found.entries))
    known = set(attested)
    listed = [name for name in found.entries if name in known]
    for mine, theirs in zip(listed, attested, strict=True):
        if mine != theirs:
            what = f"the log's manifest has segment {mine} where {theirs} was attested: it was reordered"
            yield Finding("attested_changed", Severity.DAMAGE, str(store.log / mine), what, _ASK)
            return
    newest = max(attested, default="")
    fresh = [name for name in found.entries if name not in known and name < newest]
    for name in fresh:
        what = f"segment {name} is older than {newest}, and was not there when that was attested"
        yield Finding("attested_changed", Severity.DAMAGE, str(store.log / name), what, _ASK)


def _files(store: Store, stated: Statement) -> Iterator[Finding]:
    for each in stated.files:
        path = store.folder / each.path
        if not path.is_file():
            what = f"{each.path} was attested with SHA-256 {each.sha256[:12]}; it is missing"
            yield Finding("attested_missing", Severity.LOSS, str(path), what, _ASK)
        elif sha256_of(path) != each.sha256:
            what = f"{each.path} is another file than was attested with SHA-256 {each.sha256[:12]}"
            yield Finding("attested_changed", Severity.DAMAGE, str(path), what, _ASK)
