"""Where nothing can be compiled, arrays give the buckets and counts that compiled code gives, to the last bit."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from storage.lake import rollups
from stream.batch import CountArray, FloatArray, IntArray
from stream.wire.count_residuals import join_batches, split_counts

_values = st.one_of(st.floats(), st.floats(-1e3, 1e3))
_counts = hnp.arrays(np.int32, st.integers(1, 60), elements=st.integers(-(2**31), 2**31 - 1))
_data = st.one_of(_counts, hnp.arrays(np.float64, st.integers(1, 60), elements=_values))
_BOTH = """
import json, numpy as np
from storage.lake.rollups import roll_up
from stream.batch import count_finite
from stream.wire.count_residuals import join_counts, split_counts
rng = np.random.default_rng(7)
t_ns = np.cumsum(rng.integers(-10**8, 9 * 10**8, 500))
found = [*roll_up(t_ns, rng.normal(0, 50, 500)), *roll_up(t_ns, rng.integers(-9, 9, 500).astype(np.int32), -0.5, 3.0)]
found += [join_counts(split_counts(np.arange(-300, 300, dtype=np.int32)), 600), np.array(count_finite(found[2]))]
print(json.dumps([each.tobytes().hex() for each in found]))
"""


@given(_data, st.data())
@settings(deadline=None)
def test_buckets_by_arrays_are_those_of_compiled_code(data: CountArray | FloatArray, draw: st.DataObject) -> None:
    n = len(data)
    steps = draw.draw(st.lists(st.integers(-(10**9), 2 * 10**9), min_size=n, max_size=n))
    t_ns: IntArray = np.cumsum(np.array(steps, np.int64))
    begins = np.array(sorted({0, *draw.draw(st.lists(st.integers(0, n - 1), max_size=3))}))
    with np.errstate(all="ignore"):
        compiled, arrays = rollups._buckets(t_ns, data, begins), rollups._bucket_arrays(t_ns, data, begins)
    for one, other in zip(compiled, arrays, strict=True):
        assert one.dtype == other.dtype
        assert np.array_equal(one, other, equal_nan=True)


@pytest.mark.long
@given(st.lists(_counts, min_size=1, max_size=20))
@settings(deadline=None)
def test_counts_of_many_batches_are_joined_as_they_were(batches: list[CountArray]) -> None:
    sizes = np.array([len(each) for each in batches])
    assert np.array_equal(join_batches([split_counts(each) for each in batches], sizes), np.concatenate(batches))


@pytest.mark.long
def test_a_process_that_cannot_compile_gives_the_same_without_numba() -> None:
    def run(code: str, **more: str) -> str:
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env={**os.environ, **more})
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert json.loads(run(_BOTH)) == json.loads(run(_BOTH, NUMBA_DISABLE_JIT="1"))
    assert run(_BOTH + "import sys; print('numba' in sys.modules)", NUMBA_DISABLE_JIT="1").endswith("False\n")
