"""Tests of properties with fewer examples in the gate than among the long tests."""

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, settings


def examples(
    gate: int, full: int, *strategies: Any, derandomize: bool = False, **named: Any
) -> Callable[[Callable[..., None]], Callable[[int], None]]:
    """As `given` with `max_examples`: so many in the gate, and the full number in the long form."""

    def decorate(body: Callable[..., None]) -> Callable[[int], None]:
        @pytest.mark.parametrize("examples", [gate, pytest.param(full, marks=pytest.mark.long)])
        def test(examples: int) -> None:
            over: Any = given
            settings(max_examples=examples, deadline=None, derandomize=derandomize)(over(*strategies, **named)(body))()

        for name in ("__module__", "__name__", "__qualname__", "__doc__"):
            setattr(test, name, getattr(body, name))
        return test

    return decorate
