"""The command `gyrofleet control`."""

import sys
from pathlib import Path

import click

from stream.errors import BadInput, NotFound
from stream.events import CommandOutcome, RunAction
from stream.security.actor import acting
from stream.security.rights import Role
from stream.terminal.console import notes, print_json, reporting, results, store_option
from stream.terminal.security_options import secured

_ABORT_PATIENCE_S = 60.0  # an instrument that does not answer may keep the station waiting
_ACTIONS = tuple(each.value for each in RunAction)


@click.command("control")
@click.argument("run")
@click.argument("action", type=click.Choice(_ACTIONS), metavar="|".join(_ACTIONS))
@click.option("--reason", required=True, help="Why; it is in the log with your name.")
@click.option("--by", help="Who; by default the name of the user, with --security whom the certificate names.")
@store_option
@reporting
@secured(Role.APPROVER, Role.STATION, Role.RECORDER)
def control(run: str, action: str, reason: str, by: str | None, folder: Path, *, as_json: bool) -> None:
    """Pause, resume or abort the RUN of a procedure that a station on this computer carries out.

    The station answers within some seconds: the exit code is 0 if it obeys, 1 if it refuses, nobody answers, or an
    instrument could not be made safe; a command that the station has not taken by then is withdrawn, `abort` after a
    minute. Command and answer are in `events`.
    """
    from storage.recording.run_command import PATIENCE_S, give_command, is_at_work
    from storage.sql.catalog import Catalog
    from storage.store import Store

    if not reason.strip():
        raise BadInput("--reason is empty; say why")
    store = Store.open(folder)
    ended_as: str | None = None
    if not is_at_work(store.folder, run):
        with Catalog(store, live=True) as catalog:
            found = catalog.user_reader("select outcome from runs where run = $run", {"run": run}).read_all()
        if not found.num_rows:
            raise NotFound(f"run {run!r} is not in {folder}; `gyrofleet status` has the runs that are at work")
        outcome = str(found["outcome"][0].as_py())
        ended_as = None if outcome == "open" else outcome
    given = give_command(
        store, run, RunAction(action), by=acting(by).name, reason=reason.strip(), ended_as=ended_as,
        patience_s=_ABORT_PATIENCE_S if action == RunAction.ABORT else PATIENCE_S,
        report=lambda text: notes().print(text, soft_wrap=True),
    )  # fmt: skip
    answer = given.answer
    is_obeyed = answer.outcome in {CommandOutcome.ACCEPTED, CommandOutcome.DONE}
    if as_json:
        print_json({"run": run, "action": action, "command": given.command.id, "outcome": answer.outcome.value,
                    "text": answer.text, "unsafe": answer.unsafe, "is_logged": given.is_logged})  # fmt: skip
    else:
        (results() if is_obeyed else notes()).print(f"{action} {answer.outcome}: {answer.text}", soft_wrap=True)
    sys.exit(0 if is_obeyed and not answer.unsafe else 1)
