"""The commands `gyrofleet procedure list | show | check | estimate-time`."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stream.duration import duration
from stream.errors import BadInput
from stream.mistakes import near_name
from stream.terminal.command_group import CommandGroup
from stream.terminal.completion import ListedName
from stream.terminal.console import notes, print_json, reporting, results
from stream.terminal.result_table import ResultTable

if TYPE_CHECKING:
    from ingest.procedures.plan import PlannedStep
    from ingest.procedures.procedure import Procedure

_set_option = click.option(
    "--set", "choices", multiple=True, metavar="NAME=VALUE", help="Value of a parameter; may be given several times."
)
_rate = partial(click.option, show_default=True)
_POSITIVE = click.FloatRange(min=0, min_open=True)
_SHOWN_WORDS = ("repeat", "position", "axis", "phase")


def _procedure_names() -> tuple[str, ...]:
    from ingest.procedures.file import ready_names

    return ready_names()


PROCEDURE = ListedName(_procedure_names)


@click.group("procedure", cls=CommandGroup)
def procedure() -> None:
    """Test procedures: those of the standards, and your own as TOML files."""


@procedure.command("list")
@reporting
def list_procedures(*, as_json: bool) -> None:
    """List the procedures that come with gyrofleet."""
    from ingest.procedures.file import ready_names
    from ingest.procedures.procedure import load_procedure

    ready = [load_procedure(name) for name in ready_names()]
    if as_json:
        print_json([_head(each) for each in ready])
        return
    table = _table("procedure", "name", "名称", "source")
    for each in ready:
        table.add_row(each.name, each.names.en, each.names.zh, "; ".join(each.source))
    results().print(table)


@procedure.command("show")
@click.argument("name", type=PROCEDURE, metavar="NAME|FILE")
@_set_option
@reporting
def show(name: str, choices: tuple[str, ...], *, as_json: bool) -> None:
    """Show a procedure's parameters and its steps one after the other."""
    from ingest.procedures.procedure import load_procedure
    from ingest.procedures.values import shown

    found = load_procedure(name)
    given = _given(choices)
    steps, chosen = found.steps(given), found.chosen(given)
    if as_json:
        parameters = {key: {"value": chosen[key], "description": each} for key, each in found.parameters.items()}
        about = {**_head(found), "parameters": parameters, "requirements": found.requirements(given)}
        print_json({**about, "steps": steps})
        return
    results().print(f"{found.name}: {found.names.en} / {found.names.zh}", style="bold")
    results().print("; ".join(found.source))
    if found.parameters:
        table = _table("parameter", "value", "unit", "what / 含义", "source")
        for key, each in found.parameters.items():
            table.add_row(key, shown(chosen[key]), each.unit, f"{each.en} / {each.zh}", each.source)
        results().print(table)
    results().print(_step_table(steps))
    for step in steps:
        if step.prompt is not None:
            results().print(f"{step.number}: {step.prompt.en}\n   {step.prompt.zh}")


@procedure.command("check")
@click.argument("name", type=PROCEDURE, metavar="NAME|FILE")
@click.option(
    "--settings", help="Settings of the station's instruments, as rate,temperature; without them it is not checked."
)
@click.option("--station", type=click.Path(path_type=Path), help="The station's file, instead of --settings.")
@_set_option
@reporting
def check(name: str, settings: str | None, station: Path | None, choices: tuple[str, ...], *, as_json: bool) -> None:
    """Check a procedure, and whether a station can do it."""
    from ingest.procedures.plan import SETTINGS
    from ingest.procedures.procedure import load_procedure
    from ingest.station.bench import check_limits
    from ingest.station.station import load_station

    found = load_procedure(name)
    given = _given(choices)
    steps = found.steps(given)
    unmet: tuple[str, ...] = ()
    if settings is not None:
        able = [each.strip() for each in settings.split(",") if each.strip()]
        if unknown := [each for each in able if each not in SETTINGS]:
            near = near_name(unknown[0], SETTINGS)
            raise BadInput(f"--settings: {unknown[0]!r} is no setting{near}; there is {', '.join(SETTINGS)}")
        unmet = found.unmet(able, given)
    if station is not None:
        there = load_station(station)
        unmet = found.unmet(there.settings, given)
        if not unmet:
            check_limits(there, there.make_instruments(there.make_clock()), found, given)
    if unmet:
        raise BadInput(f"procedure {found.name} cannot be done at this station: {'; '.join(unmet)}")
    needed = found.requirements(given)
    recorded = sum(each.is_recorded for each in steps)
    if as_json:
        about = {"procedure": found.name, "steps": len(steps), "recorded_steps": recorded, "requirements": needed}
        print_json({**about, "station_checked": settings is not None or station is not None})
        return
    needs = "; ".join(f"{each.setting} {each.least:g} to {each.most:g} {each.unit}" for each in needed) or "nothing"
    results().print(f"{found.name}: {len(steps)} steps, in order. It sets: {needs}.")
    if not recorded:
        from ingest.procedures.run_steps import NOTHING_RECORDED

        notes().print(NOTHING_RECORDED)
    if settings is None and station is None:
        notes().print("Whether a station can do it was not checked; give --station or --settings.")


@procedure.command("estimate-time")
@click.argument("name", type=PROCEDURE, metavar="NAME|FILE")
@_rate("--acceleration", "table_acceleration_deg_per_s2", type=_POSITIVE, default=50.0, help="Rate table, deg/s^2.")
@_rate("--angle-rate", "angle_rate_deg_per_s", type=_POSITIVE, default=20.0, help="Table to an angle, deg/s.")
@_rate("--chamber", "chamber_deg_c_per_min", type=_POSITIVE, default=2.0, help="Chamber, degC/min.")
@_rate("--room", "room_deg_c", type=float, default=23.0, help="Temperature that the chamber starts from, degC.")
@_rate("--prompt", "prompt_s", type=click.FloatRange(min=0), default=300.0, help="An operator's action, s.")
@_set_option
@reporting
def estimate_time(name: str, choices: tuple[str, ...], *, as_json: bool, **given: float) -> None:
    """Estimate how long a procedure takes, in all and by its parts."""
    from ingest.procedures.procedure import load_procedure
    from ingest.procedures.run_steps import Spent, StationRates

    rates = StationRates(**given)
    found = load_procedure(name)
    parts = found.spent(rates, _given(choices))
    total = sum(parts.values(), Spent())
    if as_json:
        listed = [{"part": part, "total_s": each.total_s, "spent": each} for part, each in parts.items()]
        whole = {"total_s": total.total_s, "total": total}
        print_json({"procedure": found.name, "rates": rates, **whole, "parts": listed})
        return
    table = _table("part", "steps", "record", "settle", "warm-up", "off", "ramps", "prompts", "in all", left=("part",))
    for part, each in (*parts.items(), ("in all", total)):
        uses = (each.record_s, each.settle_s, each.warm_up_s, each.off_s, each.ramp_s, each.prompt_s, each.total_s)
        table.add_row(part, str(each.steps), *map(duration, uses))
    results().print(f"{found.name}: {duration(total.total_s)} in all ({total.total_s:,.0f} s)")
    results().print(table)


def _given(choices: tuple[str, ...]) -> dict[str, str]:
    given: dict[str, str] = {}
    for choice in choices:
        name, equals, value = choice.partition("=")
        if not equals or not name.strip() or not value.strip():
            raise BadInput(f"--set {choice!r}: write it as NAME=VALUE, as in --set max_rate_deg_per_s=200")
        if name.strip() in given:
            raise BadInput(f"--set {name.strip()}: it is given twice")
        given[name.strip()] = value.strip()
    return given


def _head(found: "Procedure") -> dict[str, Any]:
    return {"name": found.name, "names": found.names, "source": found.source}


def _table(*titles: str, left: tuple[str, ...] | None = None) -> ResultTable:
    table = ResultTable()
    for title in titles:
        table.add_column(title, justify="left" if left is None or title in left else "right")
    return table


def _step_table(steps: "tuple[PlannedStep, ...]") -> ResultTable:
    table = _table("", "step", "words", "set", "power", "warm-up", "settle", "record", "prompt")
    for step in steps:
        power = "" if step.power is None else step.power + (f" {duration(step.off_s)}" if step.off_s else "")
        words = [f"{name} {value}" for name in _SHOWN_WORDS if (value := getattr(step.words, name))]
        words += ["room"] if step.words.room else []
        table.add_row(
            str(step.number), step.words.step or "", ", ".join(words),
            ", ".join(f"{name} {value:g}" for name, value in step.settings.items()), power, duration(step.warm_up_s),
            duration(step.settle_s), duration(step.record_s), "yes" if step.prompt is not None else "",
        )  # fmt: skip
    return table
