"""Functions compiled by numba when they are first called: its import takes longer than many commands."""

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

Result = TypeVar("Result")


def compiled(function: Callable[..., Result]) -> Callable[..., Result]:
    """Compile a function with `numba.njit` at its first call; other compiled functions cannot call it.

    The machine code is kept on disk, and the interpreter's lock is released while it runs.

    >>> @compiled  # doctest: +SKIP
    ... def _double(values: FloatArray) -> FloatArray:
    ...     return 2.0 * values
    """
    made: list[Callable[..., Result]] = []

    @wraps(function)
    def call(*arguments: Any) -> Result:
        if not made:
            from numba import njit

            made.append(njit(cache=True, nogil=True)(function))
        return made[0](*arguments)

    return call
