"""numba is imported where arrays take too long, and not before."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

_COUNTED = """
import sys
from pathlib import Path
import numpy as np
from stream.wire.count_residuals import join_counts, split_counts
counts = np.arange(-300, 300, dtype=np.int32)
calls = 0
while calls < {least} or ({until_numba} and "numba" not in sys.modules and calls < 10**6):
    assert np.array_equal(join_counts(split_counts(counts), 600), counts)
    calls += 1
print("numba" in sys.modules)
"""


def imports_numba(least: int, *, until_numba: bool) -> str:
    code = _COUNTED.format(least=least, until_numba=until_numba)
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def test_a_few_messages_are_read_without_machine_code() -> None:
    assert imports_numba(100, until_numba=False) == "False"


@pytest.mark.long
def test_many_messages_are_read_with_it() -> None:
    assert imports_numba(100, until_numba=True) == "True"


_PREPARED = """
from stream.worker import compile_kernels as own
from stream.estimators.noise import noise_kernel
before = own._is_compiled(noise_kernel)
own.compile_kernels(quiet=True)
stats = noise_kernel.descend.made().stats
print(before, sum(stats.cache_hits.values()), sum(stats.cache_misses.values()), own._is_compiled(noise_kernel))
"""


@pytest.mark.long
def test_the_noise_fit_is_compiled_in_a_process_beside(tmp_path: Path) -> None:
    if len(os.sched_getaffinity(0)) < 2:
        pytest.skip("one processor only")
    with_place = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    for known in ("False", "True"):
        done = subprocess.run(
            [sys.executable, "-c", _PREPARED], capture_output=True, text=True, check=True, env=with_place
        )
        assert done.stdout.split() == [known, "1", "0", "True"]
