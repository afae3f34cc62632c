"""Joining lakes: whatever builders publish in whatever order, no segment is lost, doubled, or left behind."""

from hypothesis import given
from hypothesis import strategies as st

from storage.lake.drops import Drops
from storage.manifests.part import DroppedRows, Part, PartFile
from storage.object_lake.merge import Merge, merge

NO_DROPS = Drops({}, {})
RAW = {"samples.parquet": PartFile(10, 5, "s")}


def part(segments: tuple[int, ...], *, dropped: bool = False, source: str = "x") -> Part:
    names = tuple(f"{segment:08d}" for segment in segments)
    return Part(
        name="-".join(names), segments=names, files={} if dropped else RAW, samples=5,
        sources=dict.fromkeys(names, source), dropped=DroppedRows("d", 5, 10) if dropped else None,
    )  # fmt: skip


@st.composite
def lakes(draw: st.DrawFn, dropped: frozenset[int]) -> list[Part]:
    """Some of ten segments in parts of neighbours; what is dropped stands apart, as in a lake."""
    held = sorted(draw(st.sets(st.integers(0, 9))))
    parts: list[list[int]] = []
    for segment in held:
        joins = parts and (parts[-1][-1] in dropped) == (segment in dropped) and draw(st.booleans())
        if joins:
            parts[-1].append(segment)
        else:
            parts.append([segment])
    return [part(tuple(each), dropped=each[0] in dropped) for each in parts]


def published(before: list[Part], plan: Merge, drops: Drops) -> list[Part]:
    """What is in force after a merge."""
    alone = [part((int(each),), dropped=each in drops.dropped) for each in plan.alone]
    return [*plan.stays, *plan.trimmed, *plan.fresh, *plan.adds, *alone]


def held(parts: list[Part]) -> list[str]:
    return sorted(segment for each in parts for segment in each.segments)


@given(st.data())
def test_builders_in_turns_lose_nothing_and_come_to_rest(data: st.DataObject) -> None:
    views = []
    for _ in range(3):
        dropped = data.draw(st.frozensets(st.integers(0, 9), max_size=4))
        drops = Drops({f"{segment:08d}": "d" for segment in dropped}, {})
        views.append((data.draw(lakes(dropped)), drops))
    lake: list[Part] = []
    known = NO_DROPS
    expected: set[str] = set()
    for turn in range(9):
        own, drops = views[turn % 3]
        plan = merge(own, drops, lake, known)
        assert {each.name for each in plan.stays} <= {each.name for each in lake}
        before = {segment for each in lake if each.dropped is None for segment in each.segments}
        known = plan.drops
        lake = published(lake, plan, known)
        expected |= set(held(own))
        assert held(lake) == sorted(expected)
        raw = {segment for each in lake if each.dropped is None for segment in each.segments}
        assert before - raw <= set(known.dropped)
    for own, drops in views:  # at rest
        plan = merge(own, drops, lake, known)
        assert (*plan.fresh, *plan.adds, *plan.trimmed, *plan.alone) == ()


def test_merged_parts_replace_theirs_and_not_the_reverse() -> None:
    whole, halves = [part((1, 2))], [part((1,)), part((2,))]
    plan = merge(whole, NO_DROPS, halves, NO_DROPS)
    assert (plan.adds, plan.replaces, plan.stays) == (tuple(whole), tuple(halves), ())
    assert merge(halves, NO_DROPS, whole, NO_DROPS).stays == tuple(whole)


def test_parts_without_raw_rows_replace_none_that_have_them_unless_they_are_dropped() -> None:
    plan = merge([part((1, 2), dropped=True)], NO_DROPS, [part((1,)), part((2,))], NO_DROPS)
    assert (plan.adds, len(plan.stays)) == ((), 2)
    drops = Drops({"00000001": "d", "00000002": "d"}, {})
    plan = merge([part((1, 2), dropped=True)], drops, [part((1, 2))], NO_DROPS)
    assert (plan.adds, plan.trimmed) == ((), (part((1, 2), dropped=True),))


def test_segments_of_other_files_stay_and_are_reported() -> None:
    plan = merge([part((1,), source="y"), part((2,))], NO_DROPS, [part((1,))], NO_DROPS)
    assert plan.conflicting == ("00000001",)
    assert plan.stays == (part((1,)),)
    assert plan.fresh == (part((2,)),)
