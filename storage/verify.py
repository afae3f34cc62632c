"""Is a store what was written to it: log, lake, and the estimators' checkpoints, held against each other."""

import time
from collections.abc import Callable
from pathlib import Path

from storage.findings import Finding, Severity, Verification
from storage.lake import parts
from storage.lake_check import lake_problems
from storage.store import Store, writer_is_active
from storage.verify_log import LogState, verify_log
from stream.checkpoint import generations, read_checkpoint
from stream.delivery import StreamId
from stream.errors import EstimatorError, GyrofleetError, StoreError
from stream.spool import held_messages

CHECKPOINT = Path("checkpoints") / "estimate.checkpoint"


def verify(store: Store, progress: Callable[[float], None] | None = None) -> tuple[Verification, LogState]:
    """Read everything in a store and say what is not as it should be; nothing is changed.

    Parameters
    ----------
    store : Store
        Which store; it may be written meanwhile, what is not sealed yet is then not looked at.
    progress : callable, optional
        Called with the fraction of the log that is read.
    """
    began = time.monotonic()
    state = verify_log(store, progress)
    findings = [*state.findings, *lake_findings(store, state), *checkpoint_findings(store, state), *_spools(store)]
    try:
        in_force = parts(store)
    except StoreError:
        in_force = []
    verification = Verification(
        store=str(store.folder),
        segments=len(state.samples),
        messages=state.messages,
        samples=sum(state.samples.values()),
        parts=len(in_force),
        lake_samples=sum(part.samples for part in in_force),
        findings=tuple(findings),
        seconds=time.monotonic() - began,
    )
    return verification, state


def lake_findings(store: Store, state: LogState) -> list[Finding]:
    """What is wrong with the lake, by itself and beside the log."""
    found = []
    for problem in lake_problems(store):
        damaged_file = store.lake / problem.part / problem.file
        found.append(Finding("lake_damaged", Severity.DAMAGE, str(damaged_file), problem.what, problem.remedy))
    try:
        in_force = parts(store)
    except StoreError:
        return found  # said above
    damaged = {path.stem for path in state.damaged}
    held: set[str] = set()
    for part in in_force:
        held.update(part.segments)
        if not damaged.isdisjoint(part.segments):
            continue  # its segment cannot be counted, which is said
        expected = sum(state.samples.get(f"{segment}.mcap", 0) for segment in part.segments)
        where = str(store.lake / part.name)
        gone = {segment for segment in part.segments if f"{segment}.mcap" not in state.samples}
        if part.samples > expected and not (salvaged(state) | gone).isdisjoint(part.segments):
            what = f"{part.samples - expected:,} samples that the log has lost are still in the lake"
            found.append(Finding("lake_has_more", Severity.NOTE, where, what, "`gyrofleet rebuild` would lose them"))
        elif part.samples != expected:
            what = f"{part.samples:,} samples, its segments have {expected:,}"
            found.append(Finding("lake_disagrees", Severity.DAMAGE, where, what, "make it anew from the log"))
    missing = sorted({name.removesuffix(".mcap") for name in state.samples} - held)
    if missing and not writer_is_active(store.folder):
        what = f"{len(missing)} sealed segments are not in it: {', '.join(missing[:5])}"
        found.append(Finding("lake_behind", Severity.UNFINISHED, str(store.lake), what, "bring them to the lake"))
    return found


def salvaged(state: LogState) -> set[str]:
    """Segments that are not what was recorded, but what could be saved of it."""
    return {name.removesuffix(".mcap") for name, entry in state.entries.items() if entry.origin == "salvaged"}


def checkpoint_findings(store: Store, state: LogState) -> list[Finding]:
    """What is wrong with the estimators' checkpoints, by themselves and beside the log."""
    found = []
    for path in generations(store.folder / CHECKPOINT):
        try:
            checkpoint = read_checkpoint(path)
        except EstimatorError as error:
            remedy = "move it aside; the one before it, or the log, has all it knew"
            found.append(Finding("checkpoint_damaged", Severity.DAMAGE, str(path), str(error), remedy))
            continue
        if checkpoint is None or writer_is_active(store.folder):
            continue
        if checkpoint.store != store.identity:
            what = "it is of another store; it is not gone on from"
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
            f"it has seen {len(ahead)} streams further than the log has them, the first {ahead[0].key}: their sources "
            "send that again, or it is lost and said so"
        )
        found.append(Finding("checkpoint_ahead", Severity.NOTE, str(path), what))
    return found


def _spools(store: Store) -> list[Finding]:
    found = []
    for folder in sorted(path for path in (store.folder / "spool").glob("*") if path.is_dir()):
        try:
            held = held_messages(folder)
        except GyrofleetError as error:
            found.append(Finding("spool_damaged", Severity.DAMAGE, str(folder), str(error), "look at it by hand"))
            continue
        if held:
            what = f"{held:,} messages of a source wait there to be sent; they are safe"
            found.append(Finding("spool_waits", Severity.NOTE, str(folder), what, "give the `gyrofleet run` again"))
    return found
