"""The machine code of all estimators, compiled or loaded before a command takes samples."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from types import ModuleType
from uuid import UUID

from stream.compiled import Kernel
from stream.terminal.console import notes


def compile_kernels(*, quiet: bool) -> None:
    """Prepare the machine code of the estimators and say so: it takes some seconds the first time."""
    from stream.estimators.noise import noise_kernel

    status = notes().status("preparing the estimators (some seconds, the first time only)")
    with nullcontext() if quiet else status:
        if _is_compiled(noise_kernel) or len(os.sched_getaffinity(0)) < 2:
            warm_up()
            return
        with _noise_fit_beside():
            warm_up(is_beside=True)
        warm_up_noise_fit()


def compile_new_kernels(*, quiet: bool) -> None:
    """The same only where they were not compiled before: else each is loaded for the first sample that needs it."""
    from stream.estimators.kernels import averages_kernel, pyramid_kernel

    if not (_is_compiled(averages_kernel) and _is_compiled(pyramid_kernel)):
        compile_kernels(quiet=quiet)


def _is_compiled(module: ModuleType) -> bool:
    """Whether machine code of a module is kept that is newer than it."""
    source = Path(str(module.__file__))
    if "NUMBA_CACHE_DIR" not in os.environ and _has_newer(source.with_name("__pycache__"), source):
        return True
    # elsewhere, as where nothing can be written beside the module: only numba knows the place
    kernel = next(each for each in vars(module).values() if isinstance(each, Kernel) and each.is_kept)
    return _has_newer(kernel.folder(), source)


def _has_newer(folder: Path, source: Path) -> bool:
    kept = folder.glob(f"{source.stem}.*.nbi")
    return max((path.stat().st_mtime_ns for path in kept), default=0) >= source.stat().st_mtime_ns


@contextmanager
def _noise_fit_beside() -> Iterator[None]:
    """Compile the noise fit, a third of the work, in a process beside this one."""
    statement = f"from {__name__} import {warm_up_noise_fit.__name__} as it; it()"
    beside = subprocess.Popen(  # noqa: S603 - our own statement
        [sys.executable, "-c", statement], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        yield
        beside.wait()  # whatever it ends with: what it did not compile, this process does
    finally:
        beside.kill()
        beside.wait()


def warm_up(*, is_beside: bool = False) -> None:
    """Compile the machine code of all estimators, or load it where it was compiled before.

    If `is_beside`, the noise fit's is compiled elsewhere.

    It is kept on disk beside the modules, or in the user's cache directory where that cannot be written; compiling
    takes some seconds, once an installation.

    >>> warm_up()
    """
    import numpy as np

    from stream.batch import SampleBatch
    from stream.estimators.base import all_estimators
    from stream.estimators.block_means import BlockMeans
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
    if not is_beside:
        warm_up_noise_fit()


def warm_up_noise_fit() -> None:
    """Compile or load the machine code of the noise fit."""
    import numpy as np

    from stream.estimators.noise.noise_kernel import (
        descend,
        descend_with,
        least_deviances,
        residual_of,
        weighted_least_squares,
    )

    descend(np.ones((2, 1)), np.ones(2), np.ones(1), np.ones(1, np.bool_))
    descend_with(np.ones((2, 2)), np.ones(2), np.ones(2), 0, 1.0, 1e-9)
    residual_of(np.ones((2, 1)), np.ones((2, 1)))
    least_deviances(np.ones((2, 1)), np.ones(2), np.ones((2, 2), order="F"))  # as the likelihood has them
    weighted_least_squares(np.ones((2, 1)), np.ones(2), np.ones(2), np.zeros(2), np.ones(1, np.bool_))
