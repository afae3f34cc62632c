"""numba is imported where arrays take too long, and not before."""

import subprocess
import sys

import pytest

_COUNTED = """
import sys
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
