"""The commands `gyrofleet alert run`, `list`, `acknowledge` and `check`."""

import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stream.errors import BadInput, GyrofleetError, NotFound
from stream.roles.config_file import configured
from stream.roles.role_log import RoleLog, logged
from stream.security.actor import acting
from stream.security.rights import Role
from stream.terminal.command_group import CommandGroup
from stream.terminal.console import (
    notes,
    print_json,
    reporting,
    results,
    status_listen_option,
    store_option,
    until_stopped,
)
from stream.terminal.option_checks import WRONG_USE, about, check_listen, options_checked
from stream.terminal.result_table import ResultTable
from stream.terminal.security_options import secured

if TYPE_CHECKING:
    from analytics.alerts.targets import Target

_EVERY_S = 1.0
_LONGEST_TEST_S = 60.0
_rules_option = click.option(
    "--rules", "rules_path", type=click.Path(path_type=Path), required=True, help="The rules, a TOML file."
)


def _check(options: Mapping[str, Any]) -> None:
    from analytics.alerts.rules import load_rules

    check_listen(options)
    with about("rules_path"):
        load_rules(options["rules_path"])


@click.group("alert", cls=CommandGroup)
def alert() -> None:
    """Tell people by e-mail or webhook when something needs them; list alerts, take note of them."""


@alert.command("run")
@store_option
@_rules_option
@status_listen_option
@configured("alert")
@reporting
@logged("alert")
@options_checked(_check, exit_code=WRONG_USE)
def run(folder: Path, rules_path: Path, status_listen: str | None, *, as_json: bool) -> None:
    """Watch a store and send alerts, until stopped.

    Each alert is sent once to each target, also when this command or the target was away meanwhile; raised, sent,
    acknowledged and cleared alerts stand in the log (the view `events`). The rules are read again when their file
    changes; while it is wrong they stay as they were.
    """
    from analytics.alerts.service import AlertService
    from storage.recording.status_board import StatusBoard
    from storage.store import Store, only_one
    from stream.status.reporter import StatusReporter, served

    store, log = Store.open(folder), RoleLog("alert")
    (folder / "alerts").mkdir(exist_ok=True)

    def report(text: str) -> None:
        if as_json:
            print_json({"event": "warning", "text": text})
        log.write("warning", "warning", text)

    with (
        only_one(folder / "alerts" / "run.lock", "gyrofleet alert run"),
        until_stopped() as stopped,
        AlertService(store, rules_path, report) as service,
        served(status_listen, service.status),
        StatusReporter(service.status, StatusBoard(store).put),
    ):
        rules = service.rules
        watching = f"watching {folder}: {len(rules.rules)} rules, {len(rules.targets)} targets; Ctrl-C ends"
        if as_json:
            print_json({"event": "watching", "rules": len(rules.rules), "targets": sorted(rules.targets)})
        log.write("info", "watching", watching, rules=len(rules.rules))
        while True:
            service.look()
            if stopped.wait(_EVERY_S):
                break


@alert.command("list")
@store_option
@click.option("--all", "is_all", is_flag=True, help="Those that have cleared or were acknowledged as well.")
@reporting
def list_alerts(folder: Path, *, is_all: bool, as_json: bool) -> None:
    """List the alerts that are open, the newest first."""
    from analytics.alerts.kept_alerts import raised_alerts
    from storage.store import Store

    found = raised_alerts(Store.open(folder))
    shown = [each for each in found if is_all or (each.acknowledged_ns is None and each.cleared_ns is None)]
    if as_json:
        print_json(shown)
        return
    if not shown:
        results().print("no alert is open")
        return
    table = ResultTable("id", "since", "severity", "rule", "text", "sent", "acknowledged")
    for each in shown:
        waiting = sum(delivery.sent_ns is None for delivery in each.deliveries)
        sent = "all" if not waiting else f"{waiting} waiting"
        since = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime((each.raised_ns or 0) / 1e9))
        state = each.acknowledged_by or ((each.ending or "cleared") if each.cleared_ns else "")
        table.add_row(each.id, since, each.severity, each.rule, each.text, sent, state)
    results().print(table)


@alert.command("acknowledge")
@click.argument("alert_id", metavar="ID")
@store_option
@click.option("--by", help="Who takes note; with --security whom the certificate names.")
@click.option("--note", default="", help="What was done.")
@reporting
@secured(Role.APPROVER, Role.RECORDER, Role.STATION)
def acknowledge(alert_id: str, folder: Path, by: str | None, note: str, *, as_json: bool) -> None:
    """Take note of an alert; it stands in the log who did."""
    from analytics.alerts.kept_alerts import raised_alerts
    from analytics.alerts.service import PLACE
    from storage.recording.client import record_documents
    from storage.store import Store
    from stream.events import AlertAcknowledged

    actor = acting(by, may_be_user=False)
    store = Store.open(folder)
    known = {each.id for each in raised_alerts(store)}
    if alert_id not in known:
        raise NotFound(f"there is no alert {alert_id!r} in {folder}; `gyrofleet alert list --all` has them")
    document = AlertAcknowledged(
        run="", t_ns=time.time_ns(), alert=alert_id, by=actor.name[:200], identity=actor.identity, note=note[:1000]
    )
    record_documents(store, [document], role="gyrofleet alert acknowledge", place=PLACE, builds_lake=True)
    if as_json:
        print_json({"acknowledged": alert_id, "by": document.by, "identity": document.identity})
    else:
        results().print(f"alert {alert_id} is acknowledged by {document.by}", markup=False)


@alert.command("check")
@_rules_option
@click.option("--send", "is_sent", is_flag=True, help="Send a test message to every target.")
@reporting
def check(rules_path: Path, *, is_sent: bool, as_json: bool) -> None:
    """Check a file of rules, and with --send whether the targets take messages."""
    from analytics.alerts.patience import Patience
    from analytics.alerts.rules import load_rules
    from analytics.alerts.targets import Message

    rules = load_rules(rules_path)
    failures: dict[str, str] = {}
    text, text_zh = "This is a test of the alerts.", "这是一条测试告警。"
    for name, target in rules.targets.items() if is_sent else ():
        message = Message(
            id=f"test{time.time_ns():x}"[:16], event="test", rule="test", severity="warning", subject="test", text=text,
            text_zh=text_zh, raised_ns=time.time_ns(), store="",
        )  # fmt: skip
        try:
            with Patience(_LONGEST_TEST_S) as patience:
                target.send([message], "", patience)
        except GyrofleetError as error:
            failures[name] = str(error)
    lacking = {} if is_sent else _lacking(rules.targets)
    if as_json:
        names = [rule.name for rule in rules.rules]
        document = {"rules": names, "targets": sorted(rules.targets), "failures": failures, "lacking": lacking}
        print_json(document)
    else:
        results().print(f"{len(rules.rules)} rules, {len(rules.targets)} targets: {rules_path} can be used")
        for name, why in failures.items():
            notes().print(f"target {name}: {why}", soft_wrap=True, markup=False)
        for name, why in lacking.items():
            text = f"warning: target {name}: {why}; `gyrofleet alert run` needs it"
            notes().print(text, soft_wrap=True, markup=False)
    sys.exit(1 if failures else 0)


def _lacking(targets: "Mapping[str, Target]") -> dict[str, str]:
    """What the environment here lacks for each target; that of a service may have it."""
    found = {}
    for name, target in targets.items():
        try:
            target.check()
        except BadInput as error:
            found[name] = str(error)
    return found
