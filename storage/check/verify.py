"""Verification of a store: log, lake, and the estimators' checkpoints, compared with each other."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache, partial
from importlib.metadata import entry_points
from pathlib import Path

import msgspec

from storage.attestation.comparison import own_findings
from storage.attestation.verified_state import VerifiedState
from storage.check.lake_values import value_findings
from storage.check.verify_lake import lasting_problems
from storage.check.verify_log import LogState, verify_log
from storage.findings import Finding, Severity, Verification
from storage.manifests.lake import read_manifest
from storage.manifests.part import Part
from storage.specifications.copies import specification_findings
from storage.store import Store, writer_is_active
from storage.store_marker import MARKER, copy_fault
from stream.delivery.spool import held_messages
from stream.errors import EstimatorError, GyrofleetError, StoreError
from stream.wire.acknowledgement import StreamId
from stream.worker.checkpoint import generations, read_checkpoint

CHECKPOINT = Path("checkpoints") / "estimate.checkpoint"

_TO_BE_EXPLAINED = {Severity.DAMAGE, Severity.LOSS}

Check = Callable[[Store], Iterable[Finding]]
"""Check of what a higher package keeps in a store; an entry point in the group `gyrofleet.verify`."""


def verify(
    store: Store, progress: Callable[[float], None] | None = None, since: VerifiedState | None = None,
    *, with_values: bool = False,
) -> tuple[Verification, LogState]:  # fmt: skip
    """Report what is wrong in the sealed part of a store, without changes; `progress` gets the fraction read.

    Of the lake the files are hashed; `with_values` its rows are compared with those that the log gives as well.

    Of segments that were verified `since`, the SHA-256 is compared. They are read too as soon as one of them is not
    there as it was, or anything is damaged or lost: what the log documents in them may explain it.
    """
    began = time.monotonic()
    found, state = _verify(store, progress, since, began)
    if since is not None:
        is_whole = since.segments.keys() <= state.compared
        if not is_whole or any(finding.severity in _TO_BE_EXPLAINED for finding in found.findings):
            found, state = _verify(store, progress, None, began)
    if with_values:
        more = _run_check(lambda: value_findings(store, progress or (lambda _done: None)), store.lake)
        found = msgspec.structs.replace(
            found, findings=(*found.findings, *more), has_values=True, seconds=time.monotonic() - began
        )
    return found, state


def _verify(
    store: Store, progress: Callable[[float], None] | None, since: VerifiedState | None, began: float
) -> tuple[Verification, LogState]:
    state = verify_log(store, progress, since)
    findings = [
        *state.findings,
        *_run_check(lambda: marker_findings(store), store.log),
        *_run_check(lambda: lake_findings(store, state), store.lake),
        *_run_check(lambda: checkpoint_findings(store, state), store.folder / CHECKPOINT),
        *_run_check(lambda: _spools(store), store.folder / "spool"),
        *_run_check(lambda: specification_findings(store), store.folder),
        *_run_check(lambda: own_findings(store), store.folder),
    ]
    for check in checks():
        findings += _run_check(partial(check, store), store.folder)
    findings += kept_findings(store)
    try:
        in_force = read_manifest(store).parts
    except StoreError:
        in_force = ()
    findings += meanwhile(store, state, in_force)
    verification = Verification(
        store=str(store.folder), segments=len(state.samples), messages=state.messages,
        samples=sum(state.samples.values()), parts=len(in_force), lake_samples=sum(part.samples for part in in_force),
        findings=tuple(findings), seconds=time.monotonic() - began, compared=len(state.compared),
        since="" if since is None else since.where,
    )  # fmt: skip
    return verification, state


@cache
def checks() -> tuple[Check, ...]:
    """The installed checks of higher packages."""
    return tuple(each.load() for each in sorted(entry_points(group="gyrofleet.verify"), key=lambda each: each.name))


def kept_findings(store: Store) -> list[Finding]:
    """What is wrong with what catalogue layers keep."""
    from storage.sql.catalog import layers

    found: list[Finding] = []
    for layer in layers():
        if any((store.folder / layer.folder).glob("*")):
            found += _run_check(partial(layer.findings, store), store.folder / layer.folder)
    return found


def _run_check(check: Callable[[], Iterable[Finding]], where: Path) -> list[Finding]:
    """Findings of a check; its failure, as by damage that another one reports, does not end the others."""
    try:
        return list(check())
    except Exception as error:  # noqa: BLE001  the other findings must be reported
        why = str(error) if isinstance(error, GyrofleetError) else f"{type(error).__name__}: {error}"
        what = f"it cannot be checked: {why}"
        remedy = "repair the other findings, and run `gyrofleet verify` again"
        return [Finding("check_failed", Severity.DAMAGE, str(where), what, remedy)]


def marker_findings(store: Store) -> list[Finding]:
    """What is wrong with the copy of the store's marker, from which a lost marker is rebuilt."""
    if (fault := copy_fault(store.folder)) is None:
        return []
    copy = store.log / MARKER
    severity = Severity.DAMAGE if copy.exists() else Severity.NOTE  # the oldest stores have none
    what = f"{fault}; the store's identity is rebuilt from it if {MARKER} is lost"
    return [Finding("marker_copy", severity, str(copy), what, "write it again")]


def lake_findings(store: Store, state: LogState) -> list[Finding]:
    """What is wrong with the lake, by itself and compared with the log; it may be changed meanwhile."""
    found = []
    for problem in lasting_problems(store):
        damaged_file = store.lake / problem.part / problem.file
        found.append(Finding("lake_damaged", Severity.DAMAGE, str(damaged_file), problem.what, problem.remedy))
    try:
        manifest = read_manifest(store, with_sources=True)
    except StoreError:
        return found  # reported above
    for part in manifest.parts:
        finding = _compare_with_log(store, state, part)
        if finding is not None:
            found.append(finding)
        if part.quarantined:
            what = (
                f"{part.quarantined:,} messages of its segments cannot be built, {part.quarantined_samples:,} samples; "
                f"the documents message_quarantined in the view events give the reasons, the log keeps them"
            )
            found.append(Finding("messages_quarantined", Severity.NOTE, str(store.lake / part.name), what))
    missing = sorted({name.removesuffix(".mcap") for name in state.samples} - manifest.segments)
    if missing and not writer_is_active(store.folder):
        what = f"{len(missing)} sealed segments are not in it: {', '.join(missing[:5])}"
        found.append(Finding("lake_behind", Severity.UNFINISHED, str(store.lake), what, "bring them to the lake"))
    return found


def meanwhile(store: Store, state: LogState, parts: Sequence[Part]) -> Iterator[Finding]:
    """Why the log and the lake have other numbers of samples while a writer works: which segments one of them lacks."""
    if not writer_is_active(store.folder):
        return
    where, held = str(store.lake), {segment for part in parts for segment in part.segments}
    ahead = [samples for name, samples in state.samples.items() if name.removesuffix(".mcap") not in held]
    if sum(ahead):
        what = (
            f"{sum(ahead):,} samples of {len(ahead):,} sealed segments are not in the lake yet: a recorder is at work, "
            "and the newest segments come last; its open segment is not counted"
        )
        yield Finding("lake_follows", Severity.NOTE, where, what)
    newest = max(state.samples, default="")
    later = [each for each in held if each > newest and f"{each}.mcap" not in state.samples]
    if later:
        what = (
            f"the lake has the samples of {len(later):,} segments that a recorder sealed after the log was read: they "
            "are not among those of the log"
        )
        yield Finding("lake_follows", Severity.NOTE, where, what)


def _compare_with_log(store: Store, state: LogState, part: Part) -> Finding | None:
    """What is wrong with a part of the lake compared with its segments."""
    where = str(store.lake / part.name)
    gone = {
        segment
        for segment in part.segments
        if f"{segment}.mcap" not in state.samples and not (store.log / f"{segment}.mcap").exists()
    }
    undeclared = sorted(gone - _declared(state))
    if undeclared:
        what = f"some of its segments are missing in the log without a document: {', '.join(undeclared[:5])}"
        remedy = "restore them from a copy; else document in the log that they are lost"
        return Finding("lake_has_more", Severity.DAMAGE, where, what, remedy)
    there = [segment for segment in part.segments if segment not in gone]
    is_uncounted = any(f"{segment}.mcap" not in state.samples for segment in there)  # sealed since
    if is_uncounted or {path.stem for path in state.damaged}.intersection(there):  # damage is reported
        return None
    expected = sum(state.samples[f"{segment}.mcap"] for segment in there)
    entries = {each: entry for each in there if (entry := state.entries.get(f"{each}.mcap")) is not None}
    whole = {each: entry for each, entry in entries.items() if entry.origin != "salvaged"}
    others = [each for each, entry in whole.items() if part.sources.get(each, entry.sha256) != entry.sha256]
    held = part.samples + part.quarantined_samples
    if held > expected and (gone or len(whole) < len(entries)) and not others:
        what = f"{held - expected:,} samples that the log has lost are still in the lake"
        return Finding("lake_has_more", Severity.NOTE, where, what, "`gyrofleet rebuild` would lose them")
    if others:
        what = f"it was made from other files of these names: {', '.join(others[:5])}"
    elif held != expected:
        what = f"{held:,} samples, its segments have {expected:,}"
    else:
        return None
    return Finding("lake_disagrees", Severity.DAMAGE, where, what, "quarantine it and rebuild it from the log")


def _declared(state: LogState) -> set[str]:
    """Segments that the log, its manifest, or another finding declares missing."""
    return state.declared | {name.removesuffix(".mcap") for name in (*state.lost, *state.gone)}


def only_in_lake(store: Store, state: LogState) -> list[str]:
    """Lost segments that only the lake knows."""
    try:
        held = read_manifest(store).segments
    except StoreError:
        return []
    return sorted(each for each in held - _declared(state) if not (store.log / f"{each}.mcap").exists())


def checkpoint_findings(store: Store, state: LogState) -> list[Finding]:
    """What is wrong with the estimators' checkpoints, by themselves and compared with the log."""
    found = []
    for path in generations(store.folder / CHECKPOINT):
        try:
            checkpoint = read_checkpoint(path)
        except EstimatorError as error:
            remedy = "quarantine it; the previous one, or the log, has all of its data"
            found.append(Finding("checkpoint_damaged", Severity.DAMAGE, str(path), str(error), remedy))
            continue
        if checkpoint is None or writer_is_active(store.folder):
            continue
        if checkpoint.store != store.identity:
            what = "it is of another store, and not used"
            found.append(Finding("checkpoint_foreign", Severity.NOTE, str(path), what))
            continue
        ahead = [
            StreamId(key, epoch)
            for key, epoch, next_seq in checkpoint.positions
            if next_seq > state.check.next_seq.get(StreamId(key, epoch), 0)
        ]
        if not ahead or state.damaged or any(each.kind == "segment_unfinished" for each in state.findings):
            continue
        what = (
            f"it is ahead of the log in {len(ahead)} streams, the first {ahead[0].key}: their sources resend the "
            "rest, or its loss is documented"
        )
        found.append(Finding("checkpoint_ahead", Severity.NOTE, str(path), what))
    return found


def _spools(store: Store) -> list[Finding]:
    found = []
    for folder in sorted(path for path in (store.folder / "spool").glob("*") if path.is_dir()):
        try:
            held = held_messages(folder)
        except GyrofleetError as error:
            found.append(Finding("spool_damaged", Severity.DAMAGE, str(folder), str(error), "examine it by hand"))
            continue
        if held:
            what = f"{held:,} messages of a source wait to be sent; they are safe"
            remedy = "start that source again: the run, `gyrofleet run-simulated`, or another program"
            found.append(Finding("spool_waits", Severity.NOTE, str(folder), what, remedy))
    return found
