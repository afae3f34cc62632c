"""Kernels compiled by numba when they are needed: importing numba takes longer than many commands run, and 90 MB."""

import os
import sys
import time
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

# set where nothing can be compiled, as in the process that runs users' statements; numba has the same rule
_IS_DISABLED = os.environ.get("NUMBA_DISABLE_JIT", "0") != "0"
# arrays that take more than a twentieth of the time are worth machine code, which takes a second to import
_PERIOD_S = 10.0
_MOST_S = 0.5


def compiled(
    kernel: Callable[Parameters, Result], *, instead: Callable[Parameters, Result] | None = None
) -> Callable[Parameters, Result]:
    """Compile a kernel on its first call, or once it is called often.

    `instead` gives the same result with arrays. It runs where nothing can be compiled, and in a process without numba
    as long as it takes less than half a second in ten; without it the kernel is compiled at once.
    """
    if _IS_DISABLED:
        return instead or kernel
    made: list[Callable[Parameters, Result]] = []
    began_s = spent_s = 0.0

    @wraps(kernel)
    def call(*arguments: Parameters.args, **named: Parameters.kwargs) -> Result:
        nonlocal began_s, spent_s
        if made:
            return made[0](*arguments, **named)
        if instead is None or spent_s > _MOST_S or "numba" in sys.modules:
            from numba import njit

            made.append(njit(cache=True, nogil=True)(kernel))
            return made[0](*arguments, **named)
        at_s = time.monotonic()
        if at_s - began_s > _PERIOD_S:
            began_s, spent_s = at_s, 0.0
        found = instead(*arguments, **named)
        spent_s += time.monotonic() - at_s
        return found

    return call
