"""Kernels compiled by numba when they are first called: importing numba takes longer than many commands run."""

import os
import threading
from collections.abc import Callable
from functools import update_wrapper
from types import FunctionType, ModuleType
from typing import Any, ParamSpec, TypeVar, cast

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")
Function = TypeVar("Function", bound=Callable[..., Any])

# set where nothing can be compiled, as in the process that runs users' statements; numba has the same rule
_IS_DISABLED = os.environ.get("NUMBA_DISABLE_JIT", "0") != "0"
_making = threading.RLock()


class _Kernel:
    """A function that numba compiles on its first call, with the kernels that it calls."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        update_wrapper(self, function)
        self._function, self._options = function, options
        self._made: Callable[..., Any] | None = None
        self._is_ready = False

    def __call__(self, *arguments: Any) -> Any:
        if not self._is_ready:
            with _making:
                self.made()
                self._is_ready = True
        assert self._made is not None
        return self._made(*arguments)

    def made(self) -> Callable[..., Any]:
        """Numba's function, whose module has numba's functions in place of the kernels."""
        if self._made is None:
            from numba import njit

            own = self._function
            assert isinstance(own, FunctionType)
            names = dict(own.__globals__)
            self._made = njit(**self._options)(
                update_wrapper(FunctionType(own.__code__, names, own.__name__, own.__defaults__), own)
            )
            _put_made(names)
        return self._made


def _put_made(names: dict[str, Any]) -> None:
    """Put numba's functions in place of kernels, and of those in the modules of kernels that are named."""
    for name, value in names.items():
        if isinstance(value, _Kernel):
            names[name] = value.made()
        elif isinstance(value, ModuleType) and any(isinstance(each, _Kernel) for each in vars(value).values()):
            names[name] = ModuleType(value.__name__)
            vars(names[name]).update(vars(value))
            _put_made(vars(names[name]))


def kernel(function: Function) -> Function:
    """Compile a kernel, which may call others, on its first call; it is kept on disk."""
    return cast("Function", _Kernel(function, {"cache": True, "nogil": True}))


def kernel_part(*fastmath: str) -> Callable[[Function], Function]:
    """Compile a function for use in kernels only: without the wrappers for Python and C, in a quarter of the time.

    It is not kept on disk; the kernels that contain it are. `fastmath` names the liberties that the compiler may take
    with floating-point numbers, such as "reassoc".
    """
    options = {"nogil": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True, "fastmath": set(fastmath)}

    def decorate(function: Function) -> Function:
        return cast("Function", _Kernel(function, options))

    return decorate


def compiled(
    kernel: Callable[Parameters, Result], *, instead: Callable[Parameters, Result] | None = None
) -> Callable[Parameters, Result]:
    """Compile a kernel that calls no other on its first call.

    Where nothing can be compiled, `instead` runs, which gives the same result with arrays; without it the kernel as it
    is, slowly.
    """
    if _IS_DISABLED:
        return instead or kernel
    return cast("Callable[Parameters, Result]", _Kernel(kernel, {"cache": True, "nogil": True}))
