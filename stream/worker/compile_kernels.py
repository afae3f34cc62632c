"""The machine code of all estimators, compiled or loaded before a command takes samples."""

from contextlib import nullcontext
from pathlib import Path
from uuid import UUID

from stream.terminal.console import notes


def compile_kernels(*, quiet: bool) -> None:
    """Prepare the machine code of the estimators and say so: it takes some seconds the first time."""
    status = notes().status("preparing the estimators (some seconds, the first time only)")
    with nullcontext() if quiet else status:
        warm_up()


def compile_new_kernels(*, quiet: bool) -> None:
    """The same only where they were not compiled before: else each is loaded for the first sample that needs it."""
    from stream.estimators.kernels import averages_kernel, pyramid_kernel

    for source in (Path(averages_kernel.__file__), Path(pyramid_kernel.__file__)):
        kept = source.with_name("__pycache__").glob(f"{source.stem}.*.nbi")
        if max((path.stat().st_mtime_ns for path in kept), default=0) < source.stat().st_mtime_ns:
            compile_kernels(quiet=quiet)
            return


def warm_up() -> None:
    """Compile the machine code of all estimators, or load it where it was compiled before.

    It is kept on disk beside the modules, or in the user's cache directory where that cannot be written; compiling
    takes some seconds, once an installation.
    """
    import numpy as np

    from stream.batch import SampleBatch
    from stream.estimators.base import all_estimators
    from stream.estimators.block_means import BlockMeans
    from stream.estimators.noise.noise_kernel import descend, least_deviances, weighted_least_squares
    from stream.wire.batches import encode_batch
    from stream.wire.continued_batches import JoinedMessages, StreamStates

    values = np.array([1.0, np.nan, 2.0, 4.0])
    times_ns = np.array([0, 1, 5, 6], np.int64) * 10**9
    regular = SampleBatch("unit", "signal", "run", UUID(int=0), 0, 0, 10**9, "1", values=values)
    irregular = SampleBatch(
        "unit", "signal", "run", UUID(int=0), 0, 0, 10**9, "1", values=values, times_ns=times_ns, irregular=True
    )
    counts = SampleBatch("unit", "signal", "run", UUID(int=0), 1, 1, 1, "1", counts=np.array([1, 2], np.int32))
    states, message = StreamStates(), encode_batch(counts)
    states.expect(states.add(), message, 1, 1, 1, 10, 10)
    states.read(JoinedMessages([message], [0]), 0)
    for batch in (regular, irregular):
        for factory in all_estimators().values():
            estimator = factory()
            estimator.update(batch)
            estimator.merge(estimator.continuation())
            estimator.estimate()
        BlockMeans(1.0).push(batch)
    descend(np.ones((2, 1)), np.ones(2), np.ones(1), np.ones(1, np.bool_))
    least_deviances(np.ones((2, 1)), np.ones(2), np.ones((2, 2), order="F"))  # as the likelihood has them
    weighted_least_squares(np.ones((2, 1)), np.ones(2), np.ones(2), np.zeros(2), np.ones(1, np.bool_))
