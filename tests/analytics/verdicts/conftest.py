"""Stores with specifications."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from analytics.specifications.entering import add_specification
from storage.store import Store
from tests.analytics.verdicts.judged_store import Judged
from tests.analytics.verdicts.specification_documents import Specify


@pytest.fixture
def judged(tmp_path: Path) -> Iterator[Judged]:
    """A store whose runs and values are what the test says."""
    made = Judged(tmp_path)
    yield made
    made.close()


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """An empty store."""
    return Store.create(tmp_path / "store")


@pytest.fixture
def specify(tmp_path: Path) -> Specify:
    """Enter a specification; its label."""

    def run(store: Store, revision: str, text: str, name: str = "fog", **words: Any) -> str:
        path = tmp_path / f"{name}.toml"
        path.write_text(f'revision = "{revision}"\n{text}')
        return add_specification(store, path, **words)[0].label

    return run
