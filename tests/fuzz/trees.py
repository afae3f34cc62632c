"""Folders kept in memory, so that what belongs around a file fits the sound contents of that file."""

import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path


class Tree:
    """The files of a folder, with their modes."""

    def __init__(self, folder: Path) -> None:
        paths = [path for path in sorted(folder.rglob("*")) if path.is_file()]
        self.files = {str(path.relative_to(folder)): (path.read_bytes(), path.stat().st_mode & 0o777) for path in paths}
        self._folders = [str(path.relative_to(folder)) for path in sorted(folder.rglob("*")) if path.is_dir()]

    def write(self, folder: Path) -> None:
        """Write them into a folder."""
        for name in self._folders:
            (folder / name).mkdir(parents=True, exist_ok=True)
        for name, (content, mode) in self.files.items():
            (folder / name).write_bytes(content)
            (folder / name).chmod(mode)

    def contents(self, *names: str) -> list[bytes]:
        """Contents of files."""
        return [self.files[name][0] for name in names]


@cache
def made_by(make: Callable[[Path], object]) -> Tree:
    """What a function makes in an empty folder; it is called once in a process."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "made"
        folder.mkdir()
        make(folder)
        return Tree(folder)
