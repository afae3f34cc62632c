"""The command `gyrofleet replay`."""

import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from storage.commands.stored_names import RUN
from stream.errors import BadInput
from stream.security.rights import Role
from stream.terminal.console import notes, print_json, progress_bar, reporting, results, store_option
from stream.terminal.security_options import secured
from stream.worker.compile_kernels import compile_kernels

if TYPE_CHECKING:
    from ingest.run.replaying import Replayed
    from storage.log.replay import Comparison

_TOLD = 10


@click.command("replay")
@click.argument("run", type=RUN)
@store_option
@click.option(
    "--speed", type=click.FloatRange(min=0.0), default=0.0, show_default=True,
    help="So many times as fast as it was measured; 0 as fast as can be.",
)  # fmt: skip
@click.option("--into", type=click.Path(path_type=Path, file_okay=False), help="Record it in this store as well.")
@click.option("--connect", help="Send it to the `gyrofleet record` that listens there.")
@click.option(
    "--every", "every_s", type=click.FloatRange(min=0.001),
    help="Seconds of a signal's time between estimates; by default as the stored ones came.",
)  # fmt: skip
@reporting
@secured(Role.STATION)
def replay(
    run: str, folder: Path, speed: float, into: Path | None, connect: str | None, every_s: float | None, *,
    as_json: bool,
) -> None:  # fmt: skip
    """Send a stored run through the bus once more, as its sources sent it.

    Without --into or --connect it is estimated again in this process, and every estimate is compared with the stored
    one: exit code 0 only if all are equal to the last bit.
    """
    from ingest.run.replaying import compared, interval_s, sent_into, sent_to
    from storage.log.replay import StoredRun
    from storage.store import Store

    if into and connect:
        raise BadInput("give --into or --connect, not both")
    if into and into.exists() and into.resolve() == folder.resolve():
        raise BadInput(f"--into {into} is the store that the run is read from; give another one")
    stored = StoredRun(Store.open(folder), run)
    every_s = every_s or interval_s(stored)
    if not connect:
        compile_kernels(quiet=as_json)
    began = time.monotonic()
    with progress_bar(hidden=as_json) as bar:
        task = bar.add_task(f"replaying {run}", total=1.0)

        def progress(done: float) -> None:
            bar.update(task, completed=done)

        if into:
            found, comparison = sent_into(stored, into, every_s, speed, progress), None
        elif connect:
            found, comparison = sent_to(stored, connect, speed, progress), None
        else:
            found, comparison = compared(stored, every_s, speed, progress)
    _print_result(found, comparison, time.monotonic() - began, every_s, as_json=as_json)
    if comparison is not None and not comparison.is_equal:
        raise SystemExit(1)


def _print_result(
    found: "Replayed", comparison: "Comparison | None", seconds: float, every_s: float, *, as_json: bool
) -> None:
    if as_json:
        sent = {"messages": found.messages, "samples": found.samples, "every_s": every_s, "seconds": seconds}
        print_json({**sent, "estimates": comparison})
        return
    rate = f", {found.samples / seconds / 1e6:.2f} M samples/s" if found.samples > 1e5 else ""
    notes().print(f"{found.samples:,} samples in {found.messages:,} messages sent once more in {seconds:.2f} s{rate}")
    if comparison is None:
        return
    results().print(f"{comparison.equal:,} of {comparison.stored:,} estimates equal bit for bit")
    kinds = {"different": comparison.different, "stored, but not made": comparison.missing}
    for what, names in {**kinds, "made, but not stored": comparison.extra}.items():
        if names:
            more = " and more" if len(names) > _TOLD else ""
            results().print(f"{what}: {', '.join(names[:_TOLD])}{more}", soft_wrap=True)
