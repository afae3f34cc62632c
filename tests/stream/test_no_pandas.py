"""Commands do without pandas, where it is installed as well; a metric of one's own may import it."""

import subprocess
import sys
from pathlib import Path

import pytest

_PROGRAM = """
import sys
from pathlib import Path
sys.path.insert(0, {folder!r})
Path({folder!r}, "pandas.py").write_text("found, __version__ = True, '0.1'")
Path({folder!r}, "own_metric.py").write_text("import pandas")
from stream.no_pandas import hide_pandas
if {hidden}:
    hide_pandas()
import numpy as np
from storage.lake.rollups import roll_up, rollup_tables
rollup_tables([(1, roll_up(np.arange(4) * 10**9, np.arange(4, dtype=np.int32)))])
print("pandas" in sys.modules)
import own_metric
print(sys.modules["pandas"].found)
"""


@pytest.mark.parametrize("hidden", [True, False])
def test_only_others_import_pandas(tmp_path: Path, hidden: bool) -> None:
    program = _PROGRAM.format(folder=str(tmp_path), hidden=hidden)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=120)
    assert done.stdout.split() == [str(not hidden), "True"], done.stderr
