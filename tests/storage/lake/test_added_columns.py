"""A column of the lake that a later version adds: what was built before can be read, and has null there."""

import json
import subprocess
import sys
from typing import Any

from storage.sql.catalog import Catalog
from storage.store import Store
from tests.storage.conftest import DAY_NS, START_NS, Filler

# the later version: `tables.py` with a column more, and what fills it
LATER = """
import json, sys
import pyarrow as pa
from pathlib import Path
from storage.lake import tables
tables.CHANNEL_COLUMNS = tables.TABLES["channels"] = tables.CHANNEL_COLUMNS.append(pa.field("messages", pa.int64()))
tables.COLUMNS_VERSION = 2
from storage.lake import channel_buffer
row = channel_buffer.ChannelBuffer.row
channel_buffer.ChannelBuffer.row = lambda self: row(self) | {"messages": len(self.messages.seq)}
from storage.check.verify import verify
from storage.lake.builder import build_missing, builder_lock
from storage.lake.rebuild import rebuild
from storage.sql.catalog import Catalog
from storage.store import Store
store = Store.open(Path(sys.argv[1]))
for step in ("build", "rebuild"):
    if step == "rebuild":
        list(rebuild(store))
    else:
        with builder_lock(store):
            list(build_missing(store))  # merges the parts of finished days
    with Catalog(store) as catalog:
        channels = "select unit, samples, messages from internal.lake_channel_parts order by t_first_ns"
        print(json.dumps({
            "channels": catalog.rows(channels),
            "samples": catalog.rows("select count(*), sum(value) from samples"),
            "parts": sorted(part.columns for part in catalog.parts),
            "problems": [str(each) for each in verify(store)[0].findings],
        }))
"""


def later(store: Store) -> list[dict[str, list[Any]]]:
    """What the later version finds after it has built, and after it has rebuilt."""
    command = [sys.executable, "-c", LATER, str(store.folder)]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr
    return [json.loads(line) for line in answer.stdout.splitlines()]


def test_parts_that_were_built_before_have_null_in_an_added_column_until_the_lake_is_rebuilt(days: Filler) -> None:
    days.build()
    with Catalog(days.store) as catalog:
        (before,) = catalog.rows("select count(*), sum(value) from samples")
    noon_ns = START_NS + 2 * DAY_NS + DAY_NS // 2
    days.counts("rate", noon_ns, 1000)
    days.counts("rate", noon_ns + 10**10, 500)
    days.seal()
    days.release()
    found, rebuilt = later(days.store)
    assert found["parts"] == [1, 1, 1, 2], "parts of one day merge, those of two versions do not"
    assert [row[2] for row in found["channels"]] == [None] * 6 + [2]
    assert found["samples"][0][0] == before[0] + 1500
    assert found["problems"] == []
    assert set(rebuilt["parts"]) == {2}
    assert all(row[2] is not None for row in rebuilt["channels"])
    assert rebuilt["samples"] == found["samples"]
    assert rebuilt["problems"] == []
