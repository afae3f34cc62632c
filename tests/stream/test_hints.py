"""Commands that messages propose can be run as they are printed: with the store and the certificate of one's own."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner

from gyrofleet import main
from storage.store import Store
from stream.errors import StoreError
from stream.roles.role_log import RoleLog, set_up
from stream.security.rights import Role
from stream.terminal.console import notes, reporting, results, store_option
from stream.terminal.hints import completed
from stream.terminal.security_options import secured
from tests.secured_sites import make_site

HINTS = {
    "see `gyrofleet verify`": "see `gyrofleet verify --store 'my store'`",
    "`gyrofleet verify` says more, `gyrofleet recover --quarantine` saves":
        "`gyrofleet verify --store 'my store'` says more, `gyrofleet recover --quarantine --store 'my store'` saves",
    "`gyrofleet limits add FILE` adds one": "`gyrofleet limits add FILE --store 'my store' --security PEER` adds one",
    "is `gyrofleet record` running?": "is `gyrofleet record --store 'my store'` running?",
    "`gyrofleet verify --store other`": "`gyrofleet verify --store other`",
    "`gyrofleet proposal approve 1f --security FOLDER`":
        "`gyrofleet proposal approve 1f --security FOLDER --store 'my store'`",
    "`gyrofleet replicate --recall`": "`gyrofleet replicate --recall`",  # its --store is another thing
    "`gyrofleet site list` has who is who": "`gyrofleet site list` has who is who",
    "`gyrofleet limits`, `gyrofleet nothing` and `other verify`":
        "`gyrofleet limits`, `gyrofleet nothing` and `other verify`",
}  # fmt: skip


@pytest.fixture
def telling(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[str, str]]:
    """A command of the program that says a hint in a way, run with options; what it has printed on both outputs."""
    monkeypatch.chdir(tmp_path)

    def run(hint: str, way: str, *options: str) -> tuple[str, str]:
        @click.command("tell")
        @store_option
        @reporting
        @secured(Role.APPROVER)
        def tell(folder: Path, *, as_json: bool) -> None:
            if way == "note":
                notes().print(hint, soft_wrap=True)
            elif way == "result":
                results().print(hint, soft_wrap=True)
            elif way == "log":
                set_up("tell", "text", "info")
                RoleLog("tell").write("info", "told", hint)
            else:
                raise StoreError(hint)

        monkeypatch.setitem(main.commands, "tell", tell)
        done = CliRunner().invoke(main, ["tell", *options])
        return done.stdout, done.stderr

    return run


@pytest.mark.long
@pytest.mark.parametrize("hint", HINTS)
@pytest.mark.parametrize("way", ["note", "log", "error"])
def test_a_hint_has_what_the_command_was_given(hint: str, way: str, tmp_path: Path, telling: Any) -> None:
    make_site(tmp_path / "site")
    lead = tmp_path / "site/approver/lead"
    _, err = telling(hint, way, "--store", "my store", "--security", "site/approver/lead")
    assert HINTS[hint].replace("PEER", str(lead)) in err


@pytest.mark.parametrize("way", ["note", "log", "error"])
def test_a_hint_stays_where_nothing_was_given(way: str, telling: Any) -> None:
    assert "see `gyrofleet verify`" in telling("see `gyrofleet verify`", way)[1]


def test_results_are_printed_as_they_are(telling: Any) -> None:
    """They may be what somebody has written, as a note."""
    assert "see `gyrofleet verify`" in telling("see `gyrofleet verify`", "result", "--store", "S")[0]
    assert completed("see `gyrofleet verify`") == "see `gyrofleet verify`"


@pytest.mark.long
def test_real_commands_propose_what_can_be_run(tmp_path: Path, gyrofleet: Callable[..., Any]) -> None:
    Store.create(tmp_path / "S")
    assert "`gyrofleet limits add FILE --store S`" in gyrofleet("limits", "list", "--store", "S").out
    none = gyrofleet("proposal", "approve", "x", "--store", "S")
    assert "`gyrofleet proposal list --store S` has those that wait" in none.err
    nowhere = gyrofleet("replicate", "--from", "nowhere", "--to", "F")
    assert "--from nowhere: there is no such folder; give a plant's store, its endpoint" in nowhere.err
