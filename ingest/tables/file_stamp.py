"""Whether a file that is read twice is still the same."""

from pathlib import Path

from stream.errors import BadInput


class FileStamp:
    """Size and time of change of a file as it was found.

    Parameters
    ----------
    path: The file.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder) / "drift.csv"
    ...     _ = path.write_text("1")
    ...     stamp = FileStamp(path)
    ...     stamp.check()
    ...     _ = path.write_text("12")
    ...     stamp.check()  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    stream.errors.BadInput: ...drift.csv: changed while it was read; import it again once it is complete
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._found = self._now()

    def check(self) -> None:
        """Raise BadInput where the file has changed, or is gone."""
        if self._now() != self._found:
            raise BadInput(f"{self._path}: changed while it was read; import it again once it is complete")

    def _now(self) -> tuple[int, int]:
        try:
            status = self._path.stat()
        except OSError:
            return -1, -1
        return status.st_size, status.st_mtime_ns
