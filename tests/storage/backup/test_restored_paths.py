"""Paths that a backup states lie within it and within the new store."""

import pytest

from storage.backup.restore import _place
from stream.errors import StoreError


@pytest.mark.parametrize(
    "path",
    ["log/../../x", "../log/x", "/etc/passwd", "files//etc/passwd", "files/a\0b", "log", "open/../x", "files/.."],
)
def test_a_path_elsewhere_is_refused(path: str) -> None:
    with pytest.raises(StoreError, match="is no path of a backup"):
        _place(path)


def test_a_path_within_is_placed() -> None:
    assert _place("log/2026/segment.mcap") == "log/2026/segment.mcap"
    assert _place("files/models/a.json") == "models/a.json"
