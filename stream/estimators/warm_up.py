"""The machine code of all estimators, compiled before samples come."""

from uuid import UUID

import numpy as np

from stream.batch import SampleBatch
from stream.estimators.base import default_followers
from stream.estimators.block_means import BlockMeans
from stream.estimators.noise.noise_kernel import descend, weighted_least_squares


def warm_up() -> None:
    """Compile the machine code of all that follow a signal, or load it where it was compiled before.

    It is kept on disk beside the modules, or in the user's cache directory where that cannot be written; compiling
    takes some seconds, once an installation.
    """
    values = np.array([1.0, np.nan, 2.0, 4.0])
    times_ns = np.array([0, 1, 5, 6], np.int64) * 10**9
    regular = SampleBatch("unit", "signal", "run", UUID(int=0), 0, 0, 10**9, "1", values=values)
    irregular = SampleBatch(
        "unit", "signal", "run", UUID(int=0), 0, 0, 10**9, "1", values=values, times_ns=times_ns, irregular=True
    )
    for factory in default_followers().values():
        for batch in (regular, irregular):
            follower = factory()
            follower.update(batch)
            follower.merge(follower.successor())
            follower.estimate()
    for batch in (regular, irregular):
        BlockMeans(1.0).push(batch)
    descend(np.ones((2, 1)), np.ones(2), np.ones(1), np.ones(1, np.bool_))
    weighted_least_squares(np.ones((2, 1)), np.ones(2), np.ones(2), np.zeros(2), np.ones(1, np.bool_))
