"""Properties of a plant's list as received: whatever comes next, what was received stays, and survives a kill."""

import hashlib
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
from hypothesis import given, settings
from hypothesis import strategies as st

from storage.manifests.entries import SegmentEntry
from storage.manifests.log import FIRST, LOST
from storage.replication.lines_ahead import LinesAhead
from storage.replication.plant_list import SALVAGED, ListRefused, PlantList
from storage.replication.progress import Lag

_ENTRY = st.tuples(st.integers(1, 6), st.sampled_from(["recorded", "found", SALVAGED, LOST]), st.integers(0, 2))


def lines(entries: list[SegmentEntry]) -> list[bytes]:
    last, found = FIRST, []
    for entry in entries:
        text = msgspec.json.encode(entry)
        last = hashlib.sha256(last.encode() + text).hexdigest()
        found.append(text + b"\t" + last.encode())
    return found


def entry(number: int, origin: str = "recorded", content: int = 0) -> SegmentEntry:
    digest = hashlib.sha256(f"{number}/{content}".encode()).hexdigest()
    return SegmentEntry(f"{number:08d}.mcap", 100, digest, 1, 10, number, number * 10**9, origin=origin)


def fed(found: PlantList, raw_lines: list[bytes]) -> str:
    """Take lines until one is refused; its kind."""
    for raw in raw_lines:
        try:
            found.append(found.check(raw))
        except ListRefused as error:
            return error.kind
    return ""


@settings(max_examples=60)
@given(st.lists(_ENTRY, max_size=8), st.data())
def test_no_continuation_changes_what_was_received(more: list[tuple[int, str, int]], data: st.DataObject) -> None:
    good = [entry(number) for number in (1, 2, 3)]
    chained = lines([*good, *(entry(*each) for each in more)])
    mutation = data.draw(st.sampled_from(["none", "drop", "swap", "double", "flip"]))
    after = chained[3:]
    if mutation == "drop":
        after = after[1:]
    elif mutation == "swap":
        after.reverse()
    elif mutation == "double":
        after = [each for each in after for _ in range(2)]
    elif mutation == "flip" and after:
        at = data.draw(st.integers(0, len(after[0]) - 1))
        after[0] = after[0][:at] + bytes([after[0][at] ^ 1]) + after[0][at + 1 :]
    with TemporaryDirectory() as folder:
        found = PlantList(Path(folder) / "segments.jsonl")
        assert fed(found, chained[:3]) == ""
        before = dict(found.entries)
        kind = fed(found, after)
        assert {name: found.entries[name] for name in before} == before
        if mutation in {"drop", "swap", "double", "flip"} and after and after[:1] != chained[3:4]:
            assert kind != ""  # a line in another place is no continuation
        again = PlantList(found.path)
        assert (again.entries, again.salvaged, again.lost) == (found.entries, found.salvaged, found.lost)
        assert (again.count, again.last) == (found.count, found.last)


@given(st.integers(0, 400))
def test_a_kill_within_a_write_leaves_the_lines_before_it(cut: int) -> None:
    chained = lines([entry(1), entry(2)])
    with TemporaryDirectory() as folder:
        path = Path(folder) / "segments.jsonl"
        whole = chained[0] + b"\n"
        path.write_bytes(whole + chained[1][: min(cut, len(chained[1]))])
        found = PlantList(path)
        assert list(found.entries) == ["00000001.mcap"]
        assert fed(found, chained[1:]) == ""
        assert path.read_bytes() == whole + chained[1] + b"\n"


def test_the_lag_is_what_the_list_has_beyond_what_is_here() -> None:
    entries = [entry(number) for number in range(1, 6)]
    chained = lines(entries)
    held = {each.segment: each for each in entries[:2]}
    ahead = LinesAhead(chained[2:], chained[1].rpartition(b"\t")[2].decode())
    assert ahead.lag(held, []) == Lag(3, 300, 3.0)
    ahead.arrived(entries[2].segment)
    held[entries[2].segment] = entries[2]
    assert ahead.lag(held, []) == Lag(2, 200, 2.0)
    assert LinesAhead([], FIRST).lag(held, [entries[0]]) == Lag(1, 100, 0.0)
