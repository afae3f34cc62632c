"""Validation of decoded documents: invalid ones are refused on arrival, and skipped in a log."""

import re
from uuid import UUID

from stream.bounds import MAX_MESSAGE_BYTES, MAX_SEQ, beyond_bounds
from stream.errors import BadInput, WireError
from stream.events import (
    RAW_ROWS_DROPPED,
    RAW_ROWS_RESTORED,
    AnyDocument,
    EventMessage,
    RunEnded,
    StoreNoted,
    StreamTotal,
    decode_event,
)
from stream.identity import check_name, is_name

_EPOCH = re.compile(r"[0-9A-Za-z-]{1,64}")
_MOST_SAMPLES = 2**53


def decode_received(payload: bytes) -> EventMessage:
    """Read a document from the wire; raises WireError if it is none, or is invalid.

    >>> from stream.events import RunEnded, StreamTotal, encode_event
    >>> total = StreamTotal(unit="U1", signal="rate", epoch="zzz", samples=7)
    >>> decode_received(encode_event(RunEnded(run="r1", t_ns=0, totals=(total,)), "e", 0))
    Traceback (most recent call last):
    stream.errors.WireError: not a run document: total of unit 'U1': epoch 'zzz' is no UUID
    """
    if len(payload) > MAX_MESSAGE_BYTES:
        raise WireError(f"not a run document: {len(payload)} bytes, a message may have {MAX_MESSAGE_BYTES}")
    message = decode_event(payload)
    if message.seq > MAX_SEQ:
        raise WireError(f"not a run document: seq {message.seq} is beyond its bounds")
    if _EPOCH.fullmatch(message.epoch) is None:
        raise WireError(f"not a run document: epoch {message.epoch[:80]!r} is not 1 to 64 of 0-9, A-Z, a-z and -")
    reason = invalid_reason(message.document) or _invalid_name(message.document)
    if reason is not None:
        raise WireError(f"not a run document: {reason}")
    return message


def _invalid_name(document: AnyDocument) -> str | None:
    """Why the document names no unit, signal or run; those that a log has already are read as they are."""
    for kind in ("run", "unit", "signal"):
        name = getattr(document, kind, None)
        if name and not is_name(name):
            return f"{kind} {name[:80]!r} has characters that no name has"
    return None


def invalid_reason(document: AnyDocument) -> str | None:
    """Why a document is invalid; None if it is valid.

    >>> from stream.events import NoteAdded
    >>> invalid_reason(NoteAdded(run="r1", t_ns=0, text="door opened"))
    >>> invalid_reason(StoreNoted(run="", t_ns=0, what="numbers_missing", text="", details={"lost": 7}))
    'what is lost is no list of stretches'
    """
    if (reason := beyond_bounds(document)) is not None:
        return reason
    if isinstance(document, RunEnded):
        return next((reason for total in document.totals if (reason := _invalid_total(total)) is not None), None)
    return _invalid_details(document) if isinstance(document, StoreNoted) else None


def _invalid_total(total: StreamTotal) -> str | None:
    whose = f"total of unit {total.unit[:80]!r}"
    try:
        check_name("unit", total.unit)
        check_name("signal", total.signal)
    except BadInput as error:
        return f"{whose}: {error}"
    try:
        UUID(total.epoch)
    except ValueError:
        return f"{whose}: epoch {total.epoch[:80]!r} is no UUID"
    if not 0 <= total.samples <= _MOST_SAMPLES:
        return f"{whose}: {total.samples} samples"
    return None


def _invalid_details(document: StoreNoted) -> str | None:
    details = document.details
    lost = details.get("lost")
    if lost is not None and not (isinstance(lost, list) and all(_is_stretch(each) for each in lost)):
        return "what is lost is no list of stretches"
    of_raw_rows = document.what in {RAW_ROWS_DROPPED, RAW_ROWS_RESTORED}
    if not _are_texts(details.get("segments", None if of_raw_rows else [])):
        return "the segments are no list of names"
    if document.what == RAW_ROWS_RESTORED and not _are_texts(details.get("documents")):
        return "the documents are no list of identities"
    if not isinstance(details.get("store", ""), str):
        return "the store is no text"
    return None


def _are_texts(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(each, str) for each in value)


def _is_stretch(lost: object) -> bool:
    if not isinstance(lost, dict):
        return False
    is_named = all(isinstance(lost.get(name), str) for name in ("key", "epoch"))
    return is_named and all(type(lost.get(name)) is int for name in ("first_seq", "last_seq"))
