"""Steps from step words."""

from collections.abc import Callable
from typing import Any

import pytest

from ingest.tables.columns import TableOptions
from ingest.tables.file import TableFile
from ingest.tables.steps import StepTracker, WordColumn, word_column
from stream.batch import SampleBatch
from stream.errors import BadInput
from stream.events import StepEnded, StepStarted, StepWords

Tool = Callable[..., Any]
G1 = TableOptions(unit="G1")


@pytest.mark.parametrize(
    ("title", "name", "unit", "cell", "value"),
    [
        ("step", "step", None, " x_p ", "x_p"),
        ("step", "step", None, 3, "3"),
        ("step", "step", None, 3.0, "3"),
        ("step", "step", None, " ", None),
        ("repeat", "repeat", None, "7", 7),
        ("repeat", "repeat", None, 2.0, 2),
        ("room", "room", None, False, False),
        ("rate_command[rad/s]", "rate_command", "rad/s", "0", 0.0),
        ("rate_command[rpm]", "rate_command", "rpm", -10, -60.0),
        ("temperature_command[K]", "temperature_command", "K", "293.15", 20.0),
        ("settle[min]", "settle", "min", "1.5", 90.0),
        ("frequency[kHz]", "frequency", "kHz", "2", 2000.0),
        ("amplitude[g_0]", "amplitude", "g_0", "2", 2.0),
    ],
)
def test_cells_become_words(title: str, name: str, unit: str | None, cell: object, value: object) -> None:
    assert word_column(title, name, unit).read(cell) == (
        pytest.approx(value, abs=1e-9) if isinstance(value, float) else value
    )


@pytest.mark.parametrize(
    ("word", "cell"),
    [("repeat", "1.5"), ("repeat", "x"), ("room", "perhaps"), ("settle_s", "1,5"), ("settle_s", "nan"),
     ("settle_s", float("inf")), ("step", float("nan")), ("step", "x" * 1001), ("settle_s", "1e999")],
)  # fmt: skip
def test_cells_that_cannot_be_read(word: str, cell: object) -> None:
    with pytest.raises(BadInput):
        WordColumn(word, word).read(cell)


def test_steps_stand_around_their_samples(write: Tool, deliver: Tool) -> None:
    rows = [(0, "a", "1"), (1, "a", "1.0"), (2, "", ""), (3, "a", "1"), (4, "a", "2")]
    lines = [f"{time},{time}.5,{step},{rate}" for time, step, rate in rows]
    table = TableFile(write("time[s],rate[deg/s],step,rate_command[deg/s]\n" + "\n".join(lines)), G1)
    story: list[Any] = []
    for item in deliver(table):
        match item:
            case SampleBatch():
                story.append([round(time / 1e9) for time in item.time_array.tolist()])
            case StepStarted():
                story.append(("begin", item.words.step, item.words.rate_command_deg_per_s, item.t_ns // 10**9))
            case StepEnded():
                story.append(("end", item.t_ns // 10**9))
    assert story == [
        ("begin", "a", 1.0, 0), [0, 1], ("end", 1),
        [2],
        ("begin", "a", 1.0, 3), [3], ("end", 3),
        ("begin", "a", 2.0, 4), [4], ("end", 4),
    ]  # fmt: skip
    assert len(table.check().steps) == 3


def test_the_same_file_gives_the_same_documents(write: Tool, deliver: Tool) -> None:
    path = write("unit,time[s],rate[deg/s],step\nA,0,1,a\nB,0,1,a\nA,1,1,b\n")
    first, second = (deliver(TableFile(path, TableOptions())) for _ in range(2))
    assert first == second
    uids = [item.uid for item in first if not isinstance(item, SampleBatch)]
    assert len(set(uids)) == len(uids) == 6


def test_a_unit_without_samples_still_has_its_steps(write: Tool, deliver: Tool) -> None:
    path = write("unit,time[s],rate[deg/s],step\nA,0,1,a\nB,0,,a\n")
    documents = [item for item in deliver(TableFile(path, TableOptions())) if not isinstance(item, SampleBatch)]
    assert [type(item).__name__ for item in documents].count("StepEnded") == 2


def test_tracker_knows_whether_a_step_goes_on() -> None:
    tracker = StepTracker()
    words = StepWords(step="a")
    assert tracker.is_open("A", "r", None)
    tracker.follow("A", "r", words, first_ns=0, last_ns=1)
    assert tracker.is_open("A", "r", StepWords(step="a"))
    assert not tracker.is_open("A", "q", words)
    ended, started = tracker.follow("A", "r", None, first_ns=2, last_ns=3)
    assert ended is not None
    assert (ended.t_ns, started, tracker.close("A", "r")) == (1, None, None)
