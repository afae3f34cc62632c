"""The command `gyrofleet estimate`."""

import functools
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import click

from stream.roles.config_file import configured
from stream.roles.role_log import RoleLog, logged
from stream.security.rights import Role
from stream.terminal.console import (
    estimates_option,
    print_json,
    reporting,
    status_listen_option,
    store_option,
    until_stopped,
)
from stream.terminal.option_checks import check_listen, options_checked
from stream.terminal.security_options import secured
from stream.worker.compile_kernels import compile_kernels

if TYPE_CHECKING:
    from stream.events import AnyDocument


@click.command("estimate")
@store_option
@click.option(
    "--average", "averages_s", type=click.FloatRange(min=1e-9), multiple=True, metavar="SECONDS",
    help="Bias stability at this averaging time too, besides raw samples and 1, 10 and 100 s.",
)  # fmt: skip
@click.option(
    "--checkpoint-every", "checkpoint_every_s", type=click.FloatRange(min=0.1), default=30.0, show_default=True,
    help="Seconds between checkpoints, from which it resumes after a stop or a kill.",
)  # fmt: skip
@click.option("--connect", help="Address of the recorder; by default of the one that writes the store.")
@click.option(
    "--every", "every_s", type=click.FloatRange(min=0.001), default=60.0, show_default=True,
    help="Seconds of signal time between estimates; resumed signals keep theirs.",
)  # fmt: skip
@click.option("--no-spectrum", is_flag=True, help="Omit the spectral density and its lines, a third of the work.")
@estimates_option
@status_listen_option
@configured("estimate")
@reporting
@logged("estimate")
@options_checked(check_listen)
@secured(Role.ESTIMATOR)
def estimate(
    folder: Path, connect: str | None, every_s: float, averages_s: tuple[float, ...], checkpoint_every_s: float,
    estimated: tuple[str, ...], status_listen: str | None, *, no_spectrum: bool, as_json: bool,
) -> None:  # fmt: skip
    """Estimate bias stability, Allan deviation, spectrum and noise of the rates on the bus, until stopped.

    It estimates angular rates, signals with limits, and those that --estimates names. It keeps a checkpoint in the
    store, and resumes from it with what was recorded since, also after a kill. Estimates go to the recorder; it shows
    early decisions and the final estimates of each run (of a curve its minimum), with --json all.
    """
    from storage.log.tail import LogTail
    from storage.recording.client import is_recorded
    from storage.store import Store, only_one, writer_endpoint
    from stream.delivery.publisher import DurablePublisher
    from stream.errors import BusError
    from stream.estimators.base import default_estimators
    from stream.estimators.bias_stability import BiasStability
    from stream.status.reporter import served
    from stream.transport.zenoh_bus import ZenohBus
    from stream.worker.estimated_signals import EstimatedSignals
    from stream.worker.worker import EstimationWorker

    connect = connect or writer_endpoint(folder)
    if connect is None:
        raise BusError(f"no `gyrofleet record` writes {folder} now; start one, or give --connect with its address")
    log_of_role = RoleLog("estimate")
    printing = threading.Lock()
    shown: set[str] = set()

    also = {BiasStability(each).key: functools.partial(BiasStability, each) for each in averages_s}

    def show(document: "AnyDocument") -> None:
        with printing:
            if as_json:
                print_json(document)
                return
            line = describe(document)
            if line and line not in shown:
                shown.add(line)
                log_of_role.write("info", "estimate", line)

    compile_kernels(quiet=as_json)
    with ExitStack() as stack:
        bus = stack.enter_context(ZenohBus(connect=[connect]))
        # the log of another recorder's store does not match what comes over the bus
        store = Store.open(folder) if is_recorded(bus, folder, connect) else None
        log = None if store is None else LogTail(store)
        checkpoint = None if log is None else folder / "checkpoints" / "estimate.checkpoint"
        if checkpoint is not None:
            stack.enter_context(only_one(checkpoint.with_suffix(".lock"), "gyrofleet estimate"))
        only_store = None if store is None else store.identity
        publisher = stack.enter_context(DurablePublisher(bus, timeout_s=10.0, only_store=only_store))
        stopped = stack.enter_context(until_stopped())
        worker = EstimationWorker(
            bus, publisher, every_s=every_s, estimators={**default_estimators(), **also}, on_document=show, log=log,
            checkpoint=checkpoint, checkpoint_every_s=checkpoint_every_s, spectrum=not no_spectrum,
            estimated=EstimatedSignals.named(estimated),
        )  # fmt: skip
        with worker, served(status_listen, worker.status):
            resumed = f", resumed from {checkpoint}" if worker.resumed else ""
            log_of_role.write("info", "estimating", f"estimating what arrives on {connect}{resumed}; Ctrl-C ends")
            if log is None:
                log_of_role.write(
                    "warning",
                    "no_checkpoint",
                    f"without a checkpoint, and missed samples are not read again: {folder} is not the store that is "
                    "recorded to; give --store with the recorder's folder",
                )
            reported_at, reported_samples = time.monotonic(), 0
            warned = 0
            while not stopped.wait(0.2) and worker.failure is None:
                for warning in worker.warnings[warned:]:
                    warned += 1
                    log_of_role.write("warning", "warning", warning)
                if time.monotonic() - reported_at >= 5.0 and worker.counts.samples != reported_samples:
                    reported_at, reported_samples = time.monotonic(), worker.counts.samples
                    text = f"{reported_samples:,} samples, {worker.counts.estimates:,} estimates published"
                    log_of_role.write("info", "progress", text, samples=reported_samples)
        publisher.drain()
    counts = worker.counts
    text = f"{counts.samples:,} samples, {counts.estimates:,} estimates, {counts.lost:,} samples missed"
    log_of_role.write("info", "ended", text, samples=counts.samples, estimates=counts.estimates, missed=counts.lost)


def describe(document: "AnyDocument") -> str | None:
    """A document in one line for people; None if it is not for them now.

    >>> from stream.events import EstimatePublished
    >>> describe(EstimatePublished(run="r1", t_ns=0, unit="FOG-1", signal="rate", estimator="allan_deviation",
    ...     unit_of_measure="deg/h", confidence=0.95, samples=1, missing=0, sample_interval_s=1.0, reason="too few",
    ...     final=True))
    'FOG-1 rate allan_deviation: no estimate (too few)'
    """
    from stream.events import EarlyDecision, EstimatePublished, NoiseFitted, SpectralLinesFound

    match document:
        case EstimatePublished(final=True):
            head = f"{document.unit} {document.signal} {document.estimator}"
            if not document.points:
                return f"{head}: no estimate ({document.reason})"
            least = min(document.points, key=lambda point: point.value)
            return (
                f"{head}: {least.value:.4g} {document.unit_of_measure} ({least.lo:.4g} to {least.hi:.4g}) "
                f"at {least.tau_s:g} s, {document.samples:,} samples"
            )
        case NoiseFitted(coefficients=dict(coefficients)):
            seen = [
                f"{name.replace('_', ' ')} {found['value']:.4g} {found['unit_of_measure']} "
                f"({found['lo']:.4g} to {found['hi']:.4g})"
                for name, found in coefficients.items()
                if isinstance(found, dict) and found.get("observable")
            ]
            return f"{document.unit} {document.signal} noise: {', '.join(seen) or 'no term observable'}"
        case SpectralLinesFound(lines=tuple(lines)) if lines:
            seen = [f"{line['frequency_hz']:.4g} Hz {line['amplitude']:.3g}" for line in lines]
            return f"{document.unit} {document.signal} lines: {', '.join(seen)} {document.unit_of_measure}"
        case EarlyDecision() if document.outcome != "UNDECIDED" and document.looked_at_fraction < 1.0:
            limit = document.limit
            return (
                f"{document.unit} {document.signal} {limit.characteristic} at {limit.tau_s or 0:g} s: "
                f"{document.outcome} after {document.looked_at_fraction:.0%} of the test; {document.reason}"
            )
    return None
