"""Product specifications: what is refused, naming file, line and key; what is kept, and when it holds."""

from collections.abc import Callable
from pathlib import Path

import pyarrow as pa
import pytest

from analytics.evaluation.evaluation import define_views
from analytics.specifications.checking import checked_specification
from analytics.specifications.entering import add_specification
from analytics.step_records.step_table import step_means
from storage.check.verify import verify
from storage.findings import Severity
from storage.specifications.chain import read_chain
from storage.specifications.validity import NEVER, periods_of, specification_named, stored_specifications
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.errors import BadInput, NotFound

LIMIT = '[[limit]]\nmetric = "bias"\nupper = 1.0\nunit_of_measure = "deg/h"\n'

Add = Callable[[str, bytes], bool]


def spec(revision: str = "A", more: str = "", limits: str = LIMIT) -> bytes:
    return f'revision = "{revision}"\n{more}\n{limits}'.encode()


def limit(**keys: object) -> str:
    said = {"metric": '"bias"', "upper": 1.0, "unit_of_measure": '"deg/h"'} | keys
    return "[[limit]]\n" + "".join(f"{key} = {value}\n" for key, value in said.items() if value is not None)


@pytest.fixture
def add(store: Store, tmp_path: Path) -> Add:
    def run(name: str, content: bytes) -> bool:
        path = tmp_path / name
        path.write_bytes(content)
        return add_specification(store, path)[1]

    return run


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (spec(limits=LIMIT + limit(metric='"biass"')), ["line 7", "$.limit[1]", "'biass'", "did you mean bias?"]),
        (spec(limits=limit(unit_of_measure='"degg/h"')), ["line 3", "$.limit[0]", "unit_of_measure", "degg/h"]),
        (spec(limits=limit(unit_of_measure='"Hz"')), ["unit_of_measure", "different quantities", "bias is in deg/h"]),
        (spec(limits=limit(unit_of_measure='"ppm"')), ["unit_of_measure", "different quantities"]),
        (spec(limits=limit(upper=None)), ["neither lower nor upper"]),
        (spec(limits=limit(lower=2.0)), ["lower 2 lies above upper 1"]),
        (spec(limits=limit(upper="nan")), ["upper is nan"]),
        (spec(limits=limit(upper="true")), ["$.limit[0].upper"]),
        (spec(limits=limit(uper=1.0)), ["uper", "$.limit[0]"]),
        (spec(limits=limit(standard='"GJB9999"')), ["GJB9999", "GJB2426A"]),
        (spec(limits=limit(standard='"JJF1536"')), ["JJF1536"]),
        (spec(limits=limit(parameters="{earth_rat = 'none'}")), ["$.limit[0] (bias)", "did you mean earth_rate?"]),
        (
            spec(limits=limit(metric='"bias_stability_averaged"', parameters="{average_ss = 100}")),
            ["line 3", "no value of bias_stability_averaged has a parameter 'average_ss'", "did you mean average_s?"],
        ),
        (spec(limits=limit(parameters="{x = 1}")), ["a parameter 'x'; its parameters are duration_s, earth_rate"]),
        (spec(limits=LIMIT + LIMIT), ["$.limit[1]", "$.limit[0] limits the same"]),
        (spec(limits=LIMIT + limit(product='"X"')), ["$.limit[1]", "limits the same"]),
        (spec(more='[product."FOG-70"]', limits=limit(product='"FOG-7O"')), ["FOG-7O", "did you mean FOG-70?"]),
        (spec(more="valid_from = 2026-01-02\nvalid_until = 2026-01-01"), ["valid_until 2026-01-01 lies before"]),
        (spec(more='valid_from = "2026-01-02"'), ["valid_from", "no date"]),
        (spec(more="valid_from = 2026-01-02T10:00:00"), ["valid_from", "no time zone"]),
        (spec("A/B"), ["revision 'A/B'"]),
        (spec("../x"), ["revision"]),
        (spec(limits=""), ["neither a [[limit]] nor a [product.NAME]"]),
        (b"revision = 'A", ["fog.toml"]),
        (b"\xff\xfe", ["fog.toml"]),
        (LIMIT.encode(), ["revision"]),
    ],
)
def test_what_is_not_right_is_refused_and_named(content: bytes, said: list[str]) -> None:
    with pytest.raises(BadInput) as refused:
        checked_specification(content, "fog.toml")
    assert all(each in str(refused.value) for each in ["fog.toml", *said]), refused.value


@pytest.mark.parametrize(("metric", "unit"), [("bias", "deg/s"), ("bias", "rad/s"), ("bias_stability", "arcsec/s")])
def test_a_unit_that_fits_is_taken(metric: str, unit: str) -> None:
    found = checked_specification(spec(limits=limit(metric=f'"{metric}"', unit_of_measure=f'"{unit}"')), "fog.toml")
    assert found.limits[0].unit_of_measure == unit


def test_the_name_is_the_files_whether_or_not_the_revision_stands_in_it() -> None:
    assert checked_specification(spec("B"), "dir/fog-70.toml").label == "fog-70-B"
    assert checked_specification(spec("B"), "dir/fog-70-B.toml").label == "fog-70-B"
    assert checked_specification(spec("B", 'name = "other"'), "dir/fog-70-B.toml").label == "other-B"


def test_what_is_added_is_kept_as_it_is_and_cannot_be_changed(store: Store, add: Add) -> None:
    content = spec("A", "# 说明")
    assert add("fog.toml", content) is True
    assert add("fog.toml", content) is False
    kept = store.folder / "products" / "fog-A.toml"
    assert kept.read_bytes() == content
    assert kept.stat().st_mode & 0o222 == 0
    with pytest.raises(BadInput, match="revision A of fog is in the store with other content"):
        add("fog.toml", content + b"# changed")
    assert kept.read_bytes() == content
    assert [each.name for each in kept.parent.iterdir() if each.suffix not in {".toml", ".lock"}] == [".lock"]


@pytest.mark.long
def test_a_revision_ends_where_the_next_begins(store: Store, add: Add) -> None:
    add("fog.toml", spec("A"))
    add("fog.toml", spec("B", "valid_from = 2026-01-01"))
    add("fog.toml", spec("C", "valid_from = 2026-03-01\nvalid_until = 2026-03-31"))
    first, second, third = periods_of(stored_specifications(store))
    day = 86_400 * 10**9
    assert first.until_ns == second.from_ns
    assert second.until_ns == third.from_ns
    assert third.until_ns - third.from_ns == 31 * day  # its last day is included
    assert [each.specification.revision for each in (first, second, third)] == ["A", "B", "C"]
    assert specification_named(read_chain(store).links, "fog")[0].specification.revision == "C"
    assert specification_named(read_chain(store).links, "fog-A")[1].encode() == spec("A")
    with pytest.raises(NotFound, match="fog-A, fog-B, fog-C"):
        specification_named(read_chain(store).links, "fog-D")


@pytest.mark.long
@pytest.mark.parametrize(
    ("first", "name", "second", "said"),
    [
        (spec("A"), "fog.toml", spec("B"), "begin to be valid at the same time"),
        (
            spec("A", "valid_until = 2026-06-30"), "fog.toml", spec("B", "valid_from = 2026-06-30"),
            r"valid until 2026-07-01 \(not included\), but B begins at 2026-06-30",
        ),
        (spec("A"), "other.toml", spec("A"), "both limit bias of any product"),
        (spec("A"), "other.toml", spec("A", limits=limit(product='"X"')), "both limit bias"),
        (
            spec("A", "[product.X]\nmax_rate_deg_per_s = 1.0", ""), "other.toml",
            spec("A", "[product.X]\nmax_rate_deg_per_s = 2.0", ""), "different numbers of product X",
        ),
    ],
)  # fmt: skip
def test_specifications_that_contradict_each_other_are_refused(
    store: Store, add: Add, first: bytes, name: str, second: bytes, said: str
) -> None:
    add("fog.toml", first)
    with pytest.raises(BadInput, match=said):
        add(name, second)
    assert len(stored_specifications(store)) == 1


@pytest.mark.long
@pytest.mark.parametrize(
    ("more", "limits"),
    [
        ("valid_from = 2026-07-01", LIMIT),
        ("", limit(metric='"bias_stability"')),
        ("", limit(product='"Y"')),
        ("", limit(parameters='{earth_rate = "none"}', product='"X"')),
    ],
)
def test_specifications_that_do_not_contradict_each_other_stand_beside_each_other(
    store: Store, add: Add, more: str, limits: str
) -> None:
    add("fog.toml", spec("A", "valid_until = 2026-06-30", limit(product='"X"')))
    assert add("other.toml", spec("A", more, limits))
    assert [each.until_ns == NEVER for each in periods_of(stored_specifications(store))] == [False, True]


@pytest.mark.long
def test_the_numbers_of_a_product_are_those_of_the_revision_that_began_last(store: Store, add: Add) -> None:
    for revision, year, rate in (("9", 2025, 9.0), ("10", 2026, 10.0), ("8", 2024, 8.0)):
        add("fog.toml", spec(revision, f"valid_from = {year}-01-01\n[product.X]\nmax_rate_deg_per_s = {rate}", ""))
    year_ns, year_2024_ns = 366 * 86_400 * 10**9, 1_704_067_200 * 10**9
    begins = {"r2023": -1, "r2024": 0, "r2026": 2}
    with Catalog(store) as catalog:
        catalog._unfilled.clear()
        rows = [
            {
                "unit": "U1",
                "run": run,
                "product": "X",
                "date_known": True,
                "unit_of_measure": "deg/h",
                "t_start_ns": year_2024_ns + at * year_ns,
            }
            for run, at in begins.items()
        ]
        define_views(catalog, pa.Table.from_pylist(rows, schema=step_means(catalog).schema))
        found = catalog.rows("select run, max_rate_deg_per_s from internal.run_products order by run")
    assert found == [("r2023", 8.0), ("r2024", 8.0), ("r2026", 10.0)]  # of a time before all, the first


def test_a_file_among_the_copies_counts_for_nothing(store: Store) -> None:
    (store.folder / "products").mkdir()
    (store.folder / "products" / "fog-A.toml").write_bytes(spec("A"))
    assert stored_specifications(store) == []
    (found,) = verify(store)[0].findings
    assert (found.kind, found.severity) == ("specification_not_entered", Severity.UNFINISHED)
    assert "gyrofleet limits add" in found.remedy
    add_specification(store, Path(found.where))  # as after an upgrade
    assert [each.label for each in stored_specifications(store)] == ["fog-A"]
    assert verify(store)[0].is_sound
