"""Landlock: a Linux process irrevocably restricts itself to reading files below some folders.

Only threads started later inherit it, so it is set before a library starts its own. See the kernel's documentation,
``userspace-api/landlock``.
"""

import ctypes
import os
import struct
from collections.abc import Iterable
from pathlib import Path

# the same numbers on all architectures
_CREATE_RULESET = 444
_ADD_RULE = 445
_RESTRICT_SELF = 446
_VERSION_FLAG = 1
_PATH_BENEATH = 1
_NO_NEW_PRIVILEGES = 38

_READ_FILE = 1 << 2
_READ_FOLDER = 1 << 3
# By version: execute, write, read, remove, make (13 kinds), refer, truncate, ioctl on devices.
_RIGHTS_BY_VERSION = {1: (1 << 13) - 1, 2: (1 << 14) - 1, 3: (1 << 15) - 1, 5: (1 << 16) - 1}
_NETWORK_SINCE = 4
_NETWORK = 0b11  # bind and connect TCP
_SCOPES_SINCE = 6
_SCOPES = 0b11  # abstract UNIX sockets and signals of others

WITHOUT_LANDLOCK = (
    "this kernel has no Landlock (Linux 5.13 or later), which would hold the process of statements to reading the "
    "store; what holds it: only statements that read pass, by their parse tree, without functions of files; DuckDB "
    "opens no file but the lake's, in a transaction that reads; the process can write no byte to a file"
)

_libc = ctypes.CDLL(None, use_errno=True)
_libc.syscall.restype = ctypes.c_long


def landlock_version() -> int:
    """Version of Landlock in this kernel; 0 without it."""
    return max(int(_libc.syscall(_CREATE_RULESET, None, 0, _VERSION_FLAG)), 0)


def allow_reading_only(paths: Iterable[Path]) -> bool:
    """Restrict this thread, and those it starts, to reading `paths` and what is open; False without Landlock."""
    version = landlock_version()
    if version == 0:
        return False
    handled = next(rights for since, rights in sorted(_RIGHTS_BY_VERSION.items(), reverse=True) if version >= since)
    network = _NETWORK if version >= _NETWORK_SINCE else 0
    scopes = _SCOPES if version >= _SCOPES_SINCE else 0
    attributes = struct.pack("QQQ", handled, network, scopes)
    # older kernels accept a longer structure whose unknown fields are 0
    ruleset = _checked(_libc.syscall(_CREATE_RULESET, ctypes.c_char_p(attributes), len(attributes), 0))
    try:
        for path in paths:
            _allow(ruleset, path)
        _checked(_libc.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0))
        _checked(_libc.syscall(_RESTRICT_SELF, ruleset, 0))
    finally:
        os.close(ruleset)
    return True


def _allow(ruleset: int, path: Path) -> None:
    try:
        opened = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except OSError:
        return
    try:
        rights = _READ_FILE | _READ_FOLDER if path.is_dir() else _READ_FILE
        rule = struct.pack("=Qi", rights, opened)
        _checked(_libc.syscall(_ADD_RULE, ruleset, _PATH_BENEATH, ctypes.c_char_p(rule), 0))
    finally:
        os.close(opened)


def _checked(result: int) -> int:
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, f"Landlock: {os.strerror(number)}")
    return int(result)
