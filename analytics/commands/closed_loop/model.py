"""The command `gyrofleet model`: versions of the units' error models, and which of them are in use."""

import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from analytics.commands.closed_loop.diagnose import block_seconds, holdout_of, noise_of
from analytics.commands.evaluation.limits import by_option
from analytics.commands.records.proposal import print_proposed
from storage.commands.stored_names import RUN, SIGNAL, UNIT
from stream.errors import BadInput, NotFound
from stream.security.actor import acting
from stream.security.rights import Role
from stream.terminal.command_group import CommandGroup
from stream.terminal.console import notes, print_json, reporting, results, status_line, store_option
from stream.terminal.security_options import secured

if TYPE_CHECKING:
    from analytics.loop.model.model_registry import ModelVersion
    from analytics.loop.model.model_use import InUse, Uses

_unit = click.option("--unit", type=UNIT, required=True, help="Which unit.")


@click.group("model", cls=CommandGroup)
def model() -> None:
    """Error models in use: list and show their versions, promote what a trace found, roll back.

    A version is never changed. What is in use stands in the store's log, with who put it there and why.
    """


@model.command("list")
@store_option
@click.option("--unit", type=UNIT, help="Only this unit.")
@reporting
def list_models(folder: Path, unit: str | None, *, as_json: bool) -> None:
    """List the versions of all units, and which are live or only watched (shadow)."""
    from analytics.loop.model.model_registry import ModelRegistry
    from analytics.loop.model.model_use import InUse, read_uses
    from storage.store import Store

    store = Store.open(folder)
    registry, uses = ModelRegistry(store), read_uses(store)
    rows: list[dict[str, Any]] = []
    damaged: list[str] = []
    for each in [unit] if unit else registry.units():
        versions, unreadable = registry.readable(each)
        rows += [_row(version, uses.get((version.unit, version.signal), InUse())) for version in versions]
        damaged += unreadable.values()
    _print_list(rows, unit, is_empty=not rows and not damaged, as_json=as_json)
    for why in damaged:
        notes().print(f"warning: {why}", soft_wrap=True)
    if damaged:
        sys.exit(1)


def _print_list(rows: list[dict[str, Any]], unit: str | None, *, is_empty: bool, as_json: bool) -> None:
    from stream.terminal.result_table import ResultTable

    if as_json:
        print_json(rows)
        return
    if is_empty:
        whose = f"unit {unit}" if unit else "any unit"
        notes().print(
            f"no version of the error model of {whose}: `gyrofleet model promote --unit {unit or 'UNIT'} --model TEXT` "
            "traces its runs and writes one",
            soft_wrap=True,
        )
        return
    titles = ("unit", "version", "stage", "verdict", "made", "by", "model")
    table = ResultTable(*titles)
    for row in rows:
        table.add_row(*(str(row[name]) for name in titles))
    results().print(table)


@model.command("show")
@store_option
@_unit
@click.option("--version", "number", type=click.IntRange(min=1), help="Which version; the newest if left out.")
@reporting
def show(folder: Path, unit: str, number: int | None, *, as_json: bool) -> None:
    """Show a version: its terms and coefficients, what it rests on, and how it was used."""
    import msgspec

    from analytics.commands.closed_loop.reference_points import reference_points, reference_sentence
    from analytics.loop.model.model_registry import ModelRegistry, no_version
    from analytics.loop.model.model_use import InUse, logged_documents, uses_of
    from analytics.loop.report.wording import measured
    from storage.store import Store
    from stream.events import ModelActivated, ResidualWatched

    store = Store.open(folder)
    registry = ModelRegistry(store)
    if number is not None:
        version = registry.version(unit, number)
    elif found := registry.versions(unit):
        version = found[-1]
    else:
        raise NotFound(no_version(unit))
    activations = logged_documents(store, (ModelActivated, ResidualWatched))
    use = uses_of(activations).get((version.unit, version.signal), InUse())
    of_unit = [each for each in activations if isinstance(each, ModelActivated | ResidualWatched) and each.unit == unit]
    history = [each for each in of_unit if each.model == version.hash]
    if as_json:
        content: dict[str, Any] = msgspec.to_builtins(version)
        points = reference_points(version.model)
        stage = use.stage(version.hash).value
        print_json({"hash": version.hash, "stage": stage, **content, "reference_points": points, "history": history})
        return
    console = results()
    console.print(f"{unit} version {version.version}, {use.stage(version.hash).value}: {version.text}")
    for label, value, error, per in zip(
        version.model.labels(), version.model.coefficients, version.model.errors, version.model.units, strict=False
    ):
        console.print(f"  {label}: {measured(value, error)} {per} (standard error {error:.2g})")
    console.print(f"  {reference_sentence(reference_points(version.model))}", soft_wrap=True)
    confirmed = "confirmed by the held-out runs" if version.is_confirmed else "not confirmed by held-out runs"
    added = f"added {', '.join(version.added)}; {confirmed}" if version.added else "added nothing to the declared model"
    console.print(f"verdict {version.verdict}; {added}")
    console.print(f"hash {version.hash}, parent {version.parent or 'none'}")
    console.print(f"made {_day(version.made_ns)} by {version.by} from {len(version.runs)} runs")
    for document in history:
        if isinstance(document, ModelActivated):
            console.print(f"{_day(document.t_ns)} {document.stage}: {document.reason} ({document.by})")
        else:
            gained = f"not judged: {document.reason}" if document.gain is None else f"gain {document.gain:.2f}"
            refused = ", refused" if document.is_refused else ""
            now = f"cusum {document.cusum:.2f} of {document.threshold:.2f}"
            console.print(f"{document.stretch}: {gained}, {now}{refused}")


@model.command("promote")
@store_option
@_unit
@click.option("--version", "number", type=click.IntRange(min=1), help="A version that is there already.")
@click.option("--model", "text", help="Trace the residual of this declared model, and promote it with what is found.")
@click.option("--signal", type=SIGNAL, help="Which signal, as rate; left out where the model names it.")
@click.option(
    "--block", show_default="30s, or the interval of the samples where that is longer",
    help="Length of the blocks that are averaged: 10s, 1min.",
)  # fmt: skip
@click.option("--noise", metavar="N=..,B=..,K=..,turn_on=..", help="Declared noise, as of `gyrofleet diagnose`.")
@click.option("--holdout", default="last-third", show_default=True, metavar="last-third|runs=A,B", help="Held-out set.")
@click.option("--run", "runs", type=RUN, multiple=True, help="Only this run; may be given several times.")
@click.option("--shadow", is_flag=True, help="Only watch it; the live stream is compensated as before.")
@click.option("--reason", default="", help="Why, in free words.")
@by_option
@reporting
@secured(Role.APPROVER, Role.RECORDER)
def promote(
    folder: Path, unit: str, number: int | None, text: str | None, signal: str | None, block: str | None,
    noise: str | None, holdout: str, runs: tuple[str, ...], reason: str, by: str | None, *, shadow: bool, as_json: bool,
) -> None:  # fmt: skip
    """Put an error model to use: what a trace of the unit's runs finds, or a version that is there already.

    What it adds to the declared model has to be confirmed by held-out runs before it goes live. Where the data cannot
    tell which of several effects it is, a warning says so.

    \b
    gyrofleet model promote --unit FOG-0235 --model 'rate = bias + temperature'
    gyrofleet model promote --unit FOG-0235 --version 2 --shadow
    """  # noqa: D301  click's mark for lines that are not to be joined
    from analytics.loop.model.model_registry import ModelRegistry
    from analytics.loop.model.model_use import Stage, activate
    from analytics.loop.model_promotion import check_usable, promote_trace, promotion_warnings
    from analytics.loop.unit_reduction import Question
    from storage.store import Store
    from stream.events import ActProposed

    if (number is None) is (text is None):
        raise BadInput(
            "give either --model 'rate = bias + ...', to trace the unit's runs, or --version N, one of those that "
            f"`gyrofleet model list --unit {unit}` shows"
        )
    store, stage, actor = Store.open(folder), Stage.SHADOW if shadow else Stage.LIVE, acting(by)
    if number is not None:
        version = ModelRegistry(store).version(unit, number)
        check_usable(version, stage)
        done = activate(store, version, stage, reason=reason, by=actor)
    else:
        question = Question(
            model=text or "", signal=signal, block_s=None if block is None else block_seconds(block),
            noise=None if noise is None else noise_of(noise), holdout=holdout_of(holdout), runs=runs or None,
        )  # fmt: skip
        with status_line() as report:
            version, done = promote_trace(store, unit, question, stage, by=actor, note=reason, on_progress=report)
    warnings = [] if stage is not Stage.LIVE else promotion_warnings(store, version)
    if as_json:
        document = {"unit": unit, "version": version.version, "hash": version.hash, "stage": stage}
        proposed = {"proposal": done.uid} if isinstance(done, ActProposed) else {}
        print_json({**document, "text": version.text, "warnings": warnings, **proposed})
        return
    if isinstance(done, ActProposed):
        print_proposed(done)
    else:
        results().print(f"{unit}: version {version.version} is {stage.value}: {version.text}")
    for warning in warnings:
        notes().print(f"warning: {warning}", soft_wrap=True)


@model.command("rollback")
@store_option
@_unit
@click.option("--signal", type=SIGNAL, default="rate", show_default=True, help="Which signal.")
@click.option("--shadow", is_flag=True, help="Take out the version that is only watched.")
@click.option("--reason", required=True, help="Why, in free words; it stands in the log.")
@by_option
@reporting
@secured(Role.APPROVER, Role.RECORDER)
def rollback(folder: Path, unit: str, signal: str, reason: str, by: str | None, *, shadow: bool, as_json: bool) -> None:
    """Take the live version of a unit's error model out of use; the one before it takes its place, if there was one."""
    from analytics.loop.model.model_registry import ModelRegistry
    from analytics.loop.model.model_use import InUse, Stage, enter_activations, read_uses, rollback_documents
    from storage.store import Store

    store = Store.open(folder)
    uses = read_uses(store)
    use = uses.get((unit, signal), InUse())
    stage = Stage.SHADOW if shadow else Stage.LIVE
    if (use.shadow if shadow else use.live) is None:
        hint = _rollback_hint(use, uses, unit, signal)
        raise BadInput(f"unit {unit}, signal {signal}: no version of its error model is {stage.value}; {hint}")
    documents = rollback_documents(ModelRegistry(store), use, stage, reason=reason, by=acting(by))
    enter_activations(store, documents)
    if as_json:
        print_json(documents)
        return
    for document in documents:
        results().print(f"{unit}: version {document.version} is {document.stage}: {document.reason}")


def _rollback_hint(use: "InUse", uses: "Uses", unit: str, signal: str) -> str:
    """What could be rolled back instead."""
    if use.live is not None:
        return f"version {use.live.version} is live: leave --shadow out to take it out of use"
    if use.shadow is not None:
        return f"version {use.shadow.version} is only watched (shadow): give --shadow to take it out"
    others = sorted(name for (of, name), each in uses.items() if of == unit and each.activations)
    if others and signal not in others:
        return f"there is one of signal {', '.join(others)}: give --signal"
    return f"`gyrofleet model list --unit {unit}` shows its versions"


def _row(version: "ModelVersion", use: "InUse") -> dict[str, Any]:
    names = ("unit", "signal", "version", "hash", "parent")
    row = {name: getattr(version, name) for name in names} | {"stage": use.stage(version.hash).value}
    return row | {"verdict": version.verdict, "made": _day(version.made_ns), "by": version.by, "model": version.text}


def _day(t_ns: int) -> str:
    return datetime.fromtimestamp(t_ns / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%SZ")
