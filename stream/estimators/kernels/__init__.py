"""Machine code of the estimators, and how its parts are compiled."""

from collections.abc import Callable
from typing import Any, TypeVar

from numba import njit

F = TypeVar("F", bound=Callable[..., Any])


def kernel_part(*fastmath: str) -> Callable[[F], F]:
    """Compile a function for use in kernels only: without the wrappers for Python and C, in a quarter of the time.

    It is not kept on disk; the kernels that contain it are. `fastmath` names the liberties that the compiler may take
    with floating-point numbers, such as "reassoc".
    """
    decorate: Callable[[F], F] = njit(  # type: ignore[call-overload]  # numba's stubs know neither wrapper option
        nogil=True, no_cpython_wrapper=True, no_cfunc_wrapper=True, fastmath=set(fastmath)
    )
    return decorate
