"""What is known of the units can be asked in SQL, and comes back from the log when the lake is gone."""

import shutil
from typing import Any

from storage.sql.catalog import Catalog
from storage.sql.views import VIEWS
from stream.events import RunStarted, UnitMounted
from tests.storage.conftest import START_NS, Filler

COLUMNS = "unit, run, product, lot, slot, fixture, operator, firmware, details->>'$.备注' as note, mountings, t_ns"


def mounted(unit: str, t_ns: int = START_NS, **said: Any) -> UnitMounted:
    return UnitMounted(run="r1", t_ns=t_ns, unit=unit, **said)


def fill(filler: Filler) -> None:
    filler.document(RunStarted(run="r1", t_ns=START_NS, operator="李", lot="L1"))
    u1 = mounted("U1", slot="A1", product="FOG-70", fixture="F'3", firmware="1.2", details={"备注": "红"})
    filler.document(u1)
    filler.document(u1)  # sent twice it is one
    filler.document(mounted("U2", slot="A2", lot="L2", operator="王"))
    filler.counts("rate", START_NS, 100)
    filler.seal()
    # mounted again, in another segment of the log
    filler.document(mounted("U2", START_NS + 10**9, slot="A3", lot="L2"))
    filler.seal()
    filler.build()


EXPECTED = [
    ("U1", "r1", "FOG-70", "L1", "A1", "F'3", "李", "1.2", "红", 1, START_NS),
    ("U2", "r1", None, "L2", "A3", None, "李", None, None, 2, START_NS + 10**9),
]


def test_one_row_a_unit_with_its_last_mounting(filler: Filler) -> None:
    fill(filler)
    assert "units" in VIEWS
    with Catalog(filler.store) as catalog:
        assert catalog.rows(f"select {COLUMNS} from units order by unit") == EXPECTED
        joined = catalog.rows("select count(*), any_value(slot) from samples join units using (run, unit)")
        assert joined == [(100, "A1")]
        assert catalog.rows("select count(*) from events where kind = 'UnitMounted' and unit = 'U2'") == [(2,)]
        assert catalog.rows("select mounted from units where unit = 'U1'")[0][0].year == 2025


def test_the_view_is_the_same_from_a_lake_made_anew(filler: Filler) -> None:
    fill(filler)
    shutil.rmtree(filler.store.lake)
    filler.store.lake.mkdir()
    filler.build()
    with Catalog(filler.store) as catalog:
        assert catalog.rows(f"select {COLUMNS} from units order by unit") == EXPECTED


def test_a_run_of_unknown_date_has_no_moment_of_mounting(filler: Filler) -> None:
    filler.document(RunStarted(run="r1", t_ns=0, date_known=False))
    filler.document(mounted("U1", 0))
    filler.seal()
    filler.build()
    with Catalog(filler.store) as catalog:
        assert catalog.rows("select mounted, t_ns, details from units") == [(None, 0, None)]


def test_a_run_of_several_files_says_how_many(filler: Filler) -> None:
    for number, name in enumerate(("a.csv", "b.csv", "a.csv", "c.csv")):  # one has grown and came again
        filler.document(RunStarted(run="r1", t_ns=START_NS + number, source=f"file {name}"))
    filler.document(RunStarted(run="r2", t_ns=START_NS, source="file a.csv"))
    filler.document(RunStarted(run="r3", t_ns=START_NS))
    filler.seal()
    filler.build()
    with Catalog(filler.store) as catalog:
        found = catalog.rows("select run, source from runs order by run")
        assert found == [("r1", "file a.csv and 2 more"), ("r2", "file a.csv"), ("r3", None)]
