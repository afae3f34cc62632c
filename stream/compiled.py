"""Kernels compiled by numba when they are needed: importing numba takes longer than many commands run, and 90 MB."""

import importlib
import os
import sys
import threading
import time
from collections.abc import Callable
from functools import update_wrapper, wraps
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, ParamSpec, TypeVar, cast

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")
Function = TypeVar("Function", bound=Callable[..., Any])

# set where nothing can be compiled, as in the process that runs users' statements; numba has the same rule. A process
# that is forked may set it later
_IS_DISABLED = os.environ.get("NUMBA_DISABLE_JIT", "0") != "0"
# arrays that take more than a twentieth of the time are worth machine code, which takes a second to import
_PERIOD_S = 10.0
_MOST_S = 0.5
_KEPT = {"cache": True, "nogil": True}
_making = threading.RLock()


class Kernel:
    """A function that numba compiles on its first call, with the kernels that it calls."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        update_wrapper(self, function)
        self._function, self._options = function, options
        self._made: Callable[..., Any] | None = None
        self._is_ready = False

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        """Call the compiled function."""
        if not self._is_ready:
            with _making:
                self.made()
                self._is_ready = True
        assert self._made is not None
        return self._made(*arguments, **named)

    @property
    def is_kept(self) -> bool:
        """Whether its machine code is kept on disk."""
        return bool(self._options.get("cache"))

    def folder(self) -> Path:
        """Where its machine code is kept; imports numba."""
        return Path(str(cast("Any", self.made()).stats.cache_path))

    def made(self) -> Callable[..., Any]:
        """Numba's function, whose module has numba's functions in place of the kernels."""
        if self._made is None:
            njit = _numba().njit
            own = self._function
            assert isinstance(own, FunctionType)
            names = dict(own.__globals__)
            self._made = njit(**self._options)(
                update_wrapper(FunctionType(own.__code__, names, own.__name__, own.__defaults__), own)
            )
            _put_made(names)
        return self._made


def _numba() -> Any:
    """Numba; whether there is a BLAS it asks by importing `scipy.linalg`, half as long as itself, which no kernel uses.

    A kernel that does need it imports it when it is compiled.
    """
    import numba

    if "numba.np.arraymath" not in sys.modules:
        from numba.np import linalg

        asked = linalg.ensure_blas
        linalg.ensure_blas = lambda: None
        try:
            importlib.import_module("numba.np.arraymath")
        finally:
            linalg.ensure_blas = asked
    return numba


def _put_made(names: dict[str, Any]) -> None:
    """Put numba's functions in place of kernels, and of those in the modules of kernels that are named."""
    for name, value in names.items():
        if isinstance(value, Kernel):
            names[name] = value.made()
        elif isinstance(value, ModuleType) and any(isinstance(each, Kernel) for each in vars(value).values()):
            names[name] = ModuleType(value.__name__)
            vars(names[name]).update(vars(value))
            _put_made(vars(names[name]))


def kernel(function: Function) -> Function:
    """Compile a kernel, which may call others, on its first call; it is kept on disk."""
    return cast("Function", Kernel(function, _KEPT))


def fast_kernel(*fastmath: str) -> Callable[[Function], Function]:
    """The same with liberties that the compiler may take with floating-point numbers, such as "reassoc"."""
    return _decorator({**_KEPT, "fastmath": set(fastmath)})


def kernel_part(*fastmath: str) -> Callable[[Function], Function]:
    """Compile a function for use in kernels only: without the wrappers for Python and C, in a quarter of the time.

    It is not kept on disk; the kernels that contain it are. `fastmath` names the liberties that the compiler may take
    with floating-point numbers, such as "reassoc".
    """
    return _decorator({"nogil": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True, "fastmath": set(fastmath)})


def _decorator(options: dict[str, Any]) -> Callable[[Function], Function]:
    def decorate(function: Function) -> Function:
        return cast("Function", Kernel(function, options))

    return decorate


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
        if instead is None or (not _IS_DISABLED and (spent_s > _MOST_S or "numba" in sys.modules)):
            made.append(cast("Callable[Parameters, Result]", Kernel(kernel, _KEPT)))
            return made[0](*arguments, **named)
        at_s = time.monotonic()
        if at_s - began_s > _PERIOD_S:
            began_s, spent_s = at_s, 0.0
        found = instead(*arguments, **named)
        spent_s += time.monotonic() - at_s
        return found

    return call
