"""Tasks in processes of this machine."""

import os
import time

import pytest

from analytics.cluster.process_engine import ProcessEngine
from stream.errors import BadInput
from tests.analytics.cluster.sequential import nobody


def slow_first(number: int) -> tuple[int, int]:
    time.sleep(0.2 if number == 0 else 0.0)
    return number, os.getpid()


def refusing(number: int) -> int:
    if number == 1:
        raise BadInput("unit FOG-1: no rate")
    return number


@pytest.mark.long
def test_results_are_in_the_order_of_the_tasks_and_units_are_counted() -> None:
    seen: list[tuple[int, int]] = []
    found = ProcessEngine(2).map(slow_first, [0, 1, 2, 3], [5, 1, 1, 1], lambda done, total: seen.append((done, total)))
    assert [number for number, _ in found] == [0, 1, 2, 3]
    assert os.getpid() not in {process for _, process in found}
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)
    assert seen[-1] == (8, 8)


@pytest.mark.long
def test_what_a_task_raises_is_raised_here() -> None:
    with pytest.raises(BadInput, match="unit FOG-1: no rate"):
        ProcessEngine(2).map(refusing, [0, 1, 2, 3], [1, 1, 1, 1], nobody)
