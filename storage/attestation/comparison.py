"""A store compared with an attestation: nothing that it lists may have changed, gone, or come in another order."""

from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING

import msgspec

from storage.attestation.attestation import Attestation, Statement, entry_digest, kept_attestations, read_attestation
from storage.attestation.signing_key import fingerprint
from storage.attestation.time_stamp import check_stamp
from storage.carried_names import is_carried
from storage.findings import Finding, Severity
from storage.manifests.entries import SegmentEntry
from storage.manifests.log import LogManifest, read_log_manifest
from storage.segments.disk import sha256_of
from storage.store import Store
from storage.store_marker import RECEIVED, REPLICA, is_replica
from stream.decoding import decode_json
from stream.errors import StoreError

if TYPE_CHECKING:
    from cryptography.x509 import Certificate

_CLOCKS_S = 60.0
_ASK = "what changed it is not known; restore it from a backup or a replica that agrees with the attestation"


def against(
    store: Store, attestation: Attestation, where: str, signer: str = "", roots: "list[Certificate] | None" = None
) -> list[Finding]:
    """What differs from an attestation; `signer` is the fingerprint of the key that must have signed it.

    The bytes of the segments are compared with the manifest by `gyrofleet verify`, the manifest with the attestation
    here. With `roots` of time stamp authorities it needs a stamp that ends at one of them. A fleet store's copy of a
    plant may lack segments that have not arrived yet, and copies of specifications, which do not travel.
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
    stamped = _stamp(attestation, stated, where, roots)
    return [*stamped, *_segments(store, stated, found), *_order(store, stated, found), *_files(store, stated)]


def _stamp(
    attestation: Attestation, stated: Statement, where: str, roots: "list[Certificate] | None"
) -> Iterator[Finding]:
    """What is wrong with the time stamp: it is not of this attestation, of no trusted authority, or of another time."""
    ask = "use the attestation that was kept; its signature still holds"
    if not attestation.time_stamp:
        if roots is not None:
            yield Finding("attestation_unstamped", Severity.DAMAGE, where, "it has no time stamp", ask)
        return
    found = check_stamp(attestation.time_stamp, attestation.signature_bytes, roots)
    if found.why_not:
        what = f"its time stamp does not hold: {found.why_not}"
        yield Finding("attestation_stamp_invalid", Severity.DAMAGE, where, what, ask)
        return
    apart_s = stated.at_ns / 1e9 - found.at.timestamp()
    if apart_s > _CLOCKS_S:
        what = f"it states a time {apart_s:,.0f} s after its time stamp: the clock of the store was ahead then"
        yield Finding("attestation_clock", Severity.NOTE, where, what, "the time stamp counts")


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
    is_copy = is_replica(store.folder)
    for each in stated.segments:
        where, entry = str(store.log / each.name), found.entries.get(each.name)
        if entry is None and is_copy and each.name not in found.lost:
            continue  # it has not arrived yet
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
        elif entry_digest(entry) != each.entry and _is_relisted(entry, each.entry):
            what = (
                f"the line of segment {each.name} in the log's manifest was lost, and written again from the segment: "
                "its content is the attested one"
            )
            yield Finding("attested_relisted", Severity.NOTE, where, what)
        elif entry_digest(entry) != each.entry:
            what = f"the line of segment {each.name} in the log's manifest is another one than was attested"
            yield Finding("attested_changed", Severity.DAMAGE, where, what, _ASK)


def _is_relisted(entry: SegmentEntry, attested: str) -> bool:
    """Whether an entry of a segment that was found without a line is the attested one, but for its origin."""
    others = (msgspec.structs.replace(entry, origin=origin) for origin in ("recorded", "recovered", "salvaged"))
    return entry.origin == "found" and attested in map(entry_digest, others)


def _order(store: Store, stated: Statement, found: LogManifest) -> Iterator[Finding]:
    attested = list(dict.fromkeys(each.name for each in stated.segments if each.name in found.entries))
    known = set(attested)
    listed = [name for name in _in_order(store, found) if name in known]
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


def _in_order(store: Store, found: LogManifest) -> list[str]:
    """Segments in the order of the plant's list; the manifest of a copy has them in the order of their arrival."""
    received = store.folder / REPLICA / RECEIVED
    if not is_replica(store.folder) or not received.is_file():
        return list(found.entries)
    lines = received.read_bytes().split(b"\n")[:-1]
    try:
        names = [decode_json(line.partition(b"\t")[0], SegmentEntry).segment for line in lines]
    except msgspec.MsgspecError as error:
        raise StoreError(f"{received} is damaged ({error}); delete it, the list is then received again") from error
    return [name for name in dict.fromkeys([*names, *found.entries]) if name in found.entries]


def _files(store: Store, stated: Statement) -> Iterator[Finding]:
    is_copy = is_replica(store.folder)
    for each in stated.files:
        if is_copy and not is_carried(each.path):
            continue  # it does not travel
        path = store.folder / each.path
        if not path.is_file():
            what = f"{each.path} was attested with SHA-256 {each.sha256[:12]}; it is missing"
            yield Finding("attested_missing", Severity.LOSS, str(path), what, _ASK)
        elif sha256_of(path) != each.sha256:
            what = f"{each.path} is another file than was attested with SHA-256 {each.sha256[:12]}"
            yield Finding("attested_changed", Severity.DAMAGE, str(path), what, _ASK)
