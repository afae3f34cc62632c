"""Kernels compiled by numba when they are first called: importing numba takes longer than many commands run."""

import os
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

# set where nothing can be compiled, as in the process that runs users' statements; numba has the same rule
_IS_DISABLED = os.environ.get("NUMBA_DISABLE_JIT", "0") != "0"


def compiled(
    kernel: Callable[Parameters, Result], *, instead: Callable[Parameters, Result] | None = None
) -> Callable[Parameters, Result]:
    """Compile a kernel on its first call.

    Where nothing can be compiled, `instead` runs, which gives the same result with arrays; without it the kernel as it
    is, slowly.
    """
    if _IS_DISABLED:
        return instead or kernel
    made: list[Callable[Parameters, Result]] = []

    @wraps(kernel)
    def call(*arguments: Parameters.args, **named: Parameters.kwargs) -> Result:
        if not made:
            from numba import njit

            made.append(njit(cache=True, nogil=True)(kernel))
        return made[0](*arguments, **named)

    return call
