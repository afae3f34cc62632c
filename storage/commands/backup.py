"""The commands `gyrofleet backup` and `gyrofleet restore`."""

import shlex
import sys
from pathlib import Path

import click

from stream.terminal.console import counted, notes, print_json, progress_bar, reporting, results, store_option

_folder = click.Path(path_type=Path, file_okay=False)


@click.command("backup")
@click.argument("destination", type=_folder)
@store_option
@click.option("--check", is_flag=True, help="Read what is in the backup already, there and in the store.")
@reporting
def backup(destination: Path, folder: Path, *, check: bool, as_json: bool) -> None:
    """Back up a store into the folder DESTINATION, also while it is written.

    It holds the log, whose segments are verified as they are copied, the segment that is open, specifications, error
    models, certificates, keys and alerts. The same folder again gets only what is new. The lake is not in it:
    `gyrofleet restore` builds it from the log. A segment that the store has lost stays in the backup.

    With --check a segment that is damaged in the backup is copied again. One that is damaged in the store stays whole
    in the backup, is named, and the exit code is 1; without --check one is noticed by its length alone.
    """
    from storage.backup.backup import back_up
    from storage.store import Store

    with progress_bar(hidden=as_json) as progress:
        task = progress.add_task(f"backing up {folder}", total=1.0)
        done = back_up(
            Store.open(folder), destination, is_checked=check,
            progress=lambda share: progress.update(task, completed=share),
        )  # fmt: skip
    found = done.backup
    if as_json:
        print_json(
            {
                "backup": str(destination), "store": found.store, "at_ns": found.at_ns,
                "segments": len(found.segments), "samples": found.samples, "added_segments": done.added_segments,
                "added_bytes": done.added_bytes, "open_bytes": sum(each.size for each in found.open),
                "files": len(found.files), "rewritten": done.rewritten,
                "lost": [entry.segment for entry in found.lost], "damaged": done.damaged,
            }
        )  # fmt: skip
        sys.exit(1 if done.damaged else 0)
    for name in done.rewritten:
        notes().print(f"{destination / 'log' / name} was damaged in the backup and is copied again", soft_wrap=True)
    for name in done.damaged:
        restored = f"`gyrofleet restore {shlex.quote(str(destination))} --store NEW` makes a store that has it"
        remedy = f"`gyrofleet verify` says what is wrong, {restored}"
        notes().print(f"{folder / 'log' / name} is damaged; it is whole in the backup: {remedy}", soft_wrap=True)
    for entry in found.lost:
        notes().print(f"{folder} has lost segment {entry.segment}; it is in the backup", soft_wrap=True)
    results().print(
        f"{counted(done.added_segments, 'segment')} added ({done.added_bytes / 1e6:,.1f} MB), "
        f"{len(found.segments):,} with {found.samples:,} samples in all; the open segment has "
        f"{sum(each.size for each in found.open) / 1e6:,.1f} MB, {counted(len(found.files), 'other file')}"
    )
    sys.exit(1 if done.damaged else 0)


@click.command("restore")
@click.argument("source", type=_folder)
@store_option
@reporting
def restore(source: Path, folder: Path, *, as_json: bool) -> None:
    """Restore the backup SOURCE into a new folder, given as --store.

    Every file is verified; the segment that was open is sealed as after a power loss, and the lake is built. The new
    store has the identity of the old one: let only one of them be written.
    """
    from storage.backup.restore import restore as restore_backup
    from storage.check.verify import verify
    from storage.store import Store

    with progress_bar(hidden=as_json) as progress:
        task = progress.add_task(f"restoring {source}", total=1.0)
        found, actions = restore_backup(source, folder, lambda share: progress.update(task, completed=share))
    checked, _ = verify(Store.open(folder))
    if as_json:
        print_json(
            {
                "store": str(folder), "identity": found.store, "backed_up_ns": found.at_ns, "actions": actions,
                "sound": checked.is_sound, "samples": checked.samples, "findings": checked.findings,
            }
        )  # fmt: skip
    else:
        for action in actions:
            notes().print(f"{action.what} {action.where}: {action.text}", soft_wrap=True, markup=False)
        state = "it is sound" if checked.is_sound else "it is NOT sound, see `gyrofleet verify`"
        results().print(f"{folder}: {checked.segments:,} segments with {checked.samples:,} samples; {state}")
    sys.exit(0 if checked.is_sound else 1)
