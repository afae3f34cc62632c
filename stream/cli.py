"""Commands of the stream: `gyrofleet estimate`."""

import threading

import click

from stream.console import compile_kernels, notes, print_json, reporting, until_stopped


@click.command("estimate")
@click.option("--connect", default="tcp/127.0.0.1:7447", show_default=True, help="Where the recorder listens.")
@click.option(
    "--every",
    "every_s",
    type=click.FloatRange(min=0.001),
    default=60.0,
    show_default=True,
    help="Seconds of a signal's time between estimates.",
)
@reporting
def estimate(connect: str, every_s: float, *, as_json: bool) -> None:
    """Estimate bias stability and Allan deviation of every signal on the bus, until stopped."""
    from stream.delivery import DurablePublisher
    from stream.events import EstimatePublished
    from stream.worker import EstimationWorker
    from stream.zenoh_bus import ZenohBus

    console = notes()
    printing = threading.Lock()

    def show(document: EstimatePublished) -> None:
        with printing:
            if as_json:
                print_json(document)
            else:
                console.print(told(document))

    compile_kernels(quiet=as_json)
    with ZenohBus(connect=[connect]) as bus, DurablePublisher(bus) as publisher, until_stopped() as stopped:
        with EstimationWorker(bus, publisher, every_s=every_s, on_estimate=show) as worker:
            console.print(f"estimating what arrives on {connect}; Ctrl-C ends")
            while not stopped.wait(0.2) and worker.failure is None:
                pass
        publisher.drain()
    if not as_json:
        counts = worker.counts
        console.print(f"{counts.samples:,} samples, {counts.estimates:,} estimates, {counts.lost:,} samples missed")


def told(document: object) -> str:
    """One line on an estimate, for people.

    Examples
    --------
    >>> from stream.events import EstimatePublished
    >>> told(EstimatePublished(run="r1", t_ns=0, unit="FOG-1", signal="rate", estimator="allan_deviation",
    ...     unit_of_measure="deg/h", confidence=0.95, samples=1, missing=0, sample_interval_s=1.0, reason="too few"))
    'FOG-1 rate allan_deviation: no estimate (too few)'
    """
    from stream.events import EstimatePublished

    assert isinstance(document, EstimatePublished)
    head = f"{document.unit} {document.signal} {document.estimator}"
    if not document.points:
        return f"{head}: no estimate ({document.reason})"
    least = min(document.points, key=lambda point: point.value)
    return (
        f"{head}: {least.value:.4g} {document.unit_of_measure} ({least.lo:.4g} to {least.hi:.4g}) "
        f"at {least.tau_s:g} s, {document.samples:,} samples"
    )
