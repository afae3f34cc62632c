"""The TOML file of a procedure, with its loops."""

import re
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from ingest.procedures.series import Kind
from stream.errors import BadInput
from stream.files.toml_text import decode_toml
from stream.identity import check_name
from stream.mistakes import near_name

Value = float | str
Least1 = msgspec.Meta(min_length=1)
Text = Annotated[str, Least1]
Name = Annotated[str, msgspec.Meta(pattern=r"^[a-z][a-z0-9_]*$")]

_MOST_BYTES = 1_000_000


class Names(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A text in two languages."""

    en: Text
    zh: Text


class Parameter(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A parameter that a user may choose; a whole number without a unit as `default` allows whole numbers only."""

    default: int | float | str | tuple[int | float | str, ...]  # its value where a user gives none
    en: Text  # what it is, in English
    zh: Text  # what it is, in Chinese
    source: Text  # the clause that gives its value, or refers to the product's specification
    unit: str = ""  # unit of measure, as in the name's ending; empty for counts and words
    least: float | None = None  # smallest value that is taken
    most: float | None = None  # largest value that is taken
    choices: tuple[str, ...] = ()  # the words that are possible, where it is a word


class Series(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A list by a rule, see `ingest.procedures.series.series`; with `both_directions` each value and its negative."""

    kind: Kind
    min: Value | None = None
    max: Value | None = None
    count: Value | None = None
    room: Value | None = None
    apart: Value | None = None
    both_directions: bool = False
    order: Literal["rising", "falling"] = "rising"


_ITEM_KEYS = {"over": "for", "overrides": "set", "items": "step"}


class Item(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, rename=_ITEM_KEYS):
    """One `[[step]]`: a step, a loop over steps, or the use of another procedure.

    `values` are numbers, words, or tables with one value for each of several variables, or ``"$parameter"`` for a list
    parameter. Settings, times and words of a loop are the defaults of the steps in it. Settings that are left out keep
    their values; a rate ends an angle, and an angle a rate. `wait_settled` has settings that must have settled before
    the step; by default those that change.
    """

    name: Text | None = None  # name of the step in the data; of a loop, name of its part in estimates of time
    over: Name | None = None  # ``for``: the loop's variable, with its values in `values` or `series`
    # values that the loop's variable takes, one by one
    values: tuple[int | float | str | dict[Name, int | float | str], ...] | str | None = None
    series: Series | None = None  # the same as a series: ``kind``, ``min``, ``max``, ``count``
    times: Value | None = None  # number of repetitions; `$repeat` counts from 1 and is the step's `repeat`
    items: tuple["Item", ...] = ()  # ``step``: the steps of the loop
    use: Text | None = None  # procedure whose steps are done: a ready one, or a file beside this one
    overrides: dict[Name, Value] = {}  # ``set``: parameters of the procedure that is used
    rate_deg_per_s: Value | None = None  # rate of the table
    temperature_deg_c: Value | None = None  # of the chamber
    frequency_hz: Value | None = None  # of the angular vibration
    amplitude_deg_per_s: Value | None = None  # of the angular vibration's rate
    angle_deg: Value | None = None  # position of the table
    position: Text | None = None  # how the input axis lies, as IRA_up
    axis: Text | None = None  # that turns, where the unit has several
    phase: Text | None = None  # part of the test, such as before and after a shock
    settle_s: Value | None = None  # dropped at the step's start, seconds
    record_s: Value | None = None  # recorded after that, seconds
    warm_up_s: Value | None = None  # waited after power-on, seconds
    off_s: Value | None = None  # without power, seconds
    power: str | None = None  # ``off``, ``on``, or ``cycle`` (off for `off_s`, then on); ``none`` changes nothing
    prompt: Names | None = None  # action that an operator performs and confirms before the step
    room: bool | None = None  # whether it is the step at room temperature
    wait_settled: tuple[str, ...] | None = None  # settings that settle before it begins


class ProcedureFile(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, rename={"items": "step"}):
    """The whole file."""

    name: Text
    names: Names
    items: Annotated[tuple[Item, ...], Least1]
    source: tuple[Text, ...] = ()
    notes: Names | None = None
    parameters: dict[Name, Parameter] = {}


def ready_names() -> tuple[str, ...]:
    """Names of the procedures that come with gyrofleet."""
    found = [each.name for each in files("ingest").joinpath("procedures").iterdir()]
    return tuple(sorted(name.removesuffix(".toml") for name in found if name.endswith(".toml")))


def ready_text(name: str) -> str:
    """Text of a procedure that comes with gyrofleet."""
    return files("ingest").joinpath("procedures", f"{name}.toml").read_text(encoding="utf-8")


def read_procedure(name: str | Path, beside: Path | None = None) -> tuple[ProcedureFile, str, Path | None]:
    """The file of a procedure, its name for messages, and its folder, which is None for a ready procedure.

    `name` is that of a ready procedure, or a path, relative to `beside`, that ends with ``.toml`` or holds a slash.
    Raises BadInput if there is none, or it cannot be read.
    """
    text = str(name)
    if not isinstance(name, Path) and not text.endswith(".toml") and "/" not in text:
        if text not in (ready := ready_names()):
            raise BadInput(
                f"no procedure {text!r}{near_name(text, ready)}; `gyrofleet procedure list` shows the ready ones, "
                f"a file of your own is given by its path, as ./{text}.toml"
            )
        return parse_procedure(ready_text(text), f"procedure {text}"), f"procedure {text}", None
    path = Path(name) if beside is None else beside / name
    try:
        with path.open("rb") as file:
            content = file.read(_MOST_BYTES + 1)
    except OSError as error:
        raise BadInput(f"procedure {path} cannot be read: {error.strerror or error}") from error
    if len(content) > _MOST_BYTES:
        raise BadInput(f"procedure {path} is longer than {_MOST_BYTES:,} bytes: it is no procedure")
    return parse_procedure(content, str(path)), str(path), path.parent


def parse_procedure(text: str | bytes, source: str) -> ProcedureFile:
    r"""Read a procedure from TOML; raises BadInput if it is none; the message names the file and the key, such as
    ``$.step[2].settle_s``.

    >>> parse_procedure('name = "a"\nnames = {en = "A", zh = "甲"}\n[[step]]\nname = "s"\nrecrod_s = 1', "a.toml")
    Traceback (most recent call last):
    stream.errors.BadInput: a.toml: Object contains unknown field `recrod_s` - at `$.step[0]`, did you mean record_s?
    """
    try:
        parsed = decode_toml(text, ProcedureFile)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise BadInput(f"{source}: {error}{_brackets(str(error))}") from error
    try:
        check_name("procedure", parsed.name)
    except BadInput as error:
        raise BadInput(f"{source}: $.name: {error}") from error
    for key, parameter in parsed.parameters.items():
        default, where = parameter.default, f"{source}: $.parameters.{key}.default"
        for value in default if isinstance(default, tuple) else (default,):
            check_value(parameter, value, where)
        if default == ():
            raise BadInput(f"{where}: an empty list")
    return parsed


def _brackets(message: str) -> str:
    """What to write for a table that is to be one of several."""
    found = re.fullmatch(r"Expected `array`, got `object` - at `\$\.((?:step(?:\[\d+\])?\.?)+)`", message)
    return f"; write [[{re.sub(r'[^a-z.]', '', found[1])}]], with two brackets, also for one" if found else ""


def check_value(parameter: Parameter, value: float | str, where: str) -> None:
    """Check one value of a parameter against its bounds and choices."""
    if isinstance(value, str):
        if parameter.choices and value not in parameter.choices:
            near = near_name(value, parameter.choices)
            raise BadInput(f"{where}: {value!r} is none of {', '.join(parameter.choices)}{near}")
        return
    if not -1e300 < value < 1e300:
        raise BadInput(f"{where}: {value} is no finite number")
    unit = f" {parameter.unit}" if parameter.unit else ""
    if parameter.least is not None and value < parameter.least:
        raise BadInput(f"{where}: {value:g}{unit} is below the least, {parameter.least:g}{unit}")
    if parameter.most is not None and value > parameter.most:
        raise BadInput(f"{where}: {value:g}{unit} is above the most, {parameter.most:g}{unit}")
