"""Who may read or write a file that others must not."""

from pathlib import Path


def fault_of_secret(path: Path) -> str:
    """Why a file is no secret, and what to do; empty if only its owner can read and write it. OSError if there is none.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "ca.key"
    ...     path.touch(0o600)
    ...     fault_of_secret(path)
    ''
    """
    mode = path.stat().st_mode & 0o777
    return f"others can read it (mode {mode:o}): chmod 600 {path}" if mode & 0o077 else ""


def fault_of_rules(path: Path) -> str:
    """Why a file does not say what its owner wants, and what to do; empty if nobody else can write it.

    OSError if there is none.
    """
    mode = path.stat().st_mode & 0o777
    return f"others can change it (mode {mode:o}): chmod 600 {path}" if mode & 0o022 else ""
