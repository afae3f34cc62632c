"""Commands on one store, for tests of judgements."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from gyrofleet import main

Ask = Callable[..., Any]


@pytest.fixture
def ask(tmp_path: Path) -> Ask:
    """A command on one store, with its answer in JSON."""

    def ask(*words: object) -> Any:
        done = CliRunner().invoke(main, [*(str(word) for word in words), "--store", str(tmp_path / "S"), "--json"])
        assert done.exit_code == 0, (done.output, done.exception)
        return json.loads(done.stdout.splitlines()[-1] if words[0] == "import" else done.stdout)

    return ask
