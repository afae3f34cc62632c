"""A procedure as it stands in a TOML file, before its loops are unrolled."""

import difflib
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from ingest.procedures.series import Kind
from stream.errors import BadInput
from stream.identity import check_name
from stream.toml_text import decode_toml

Value = float | str
Least1 = msgspec.Meta(min_length=1)
Text = Annotated[str, Least1]
Name = Annotated[str, msgspec.Meta(pattern=r"^[a-z][a-z0-9_]*$")]

_READY = "procedures"
_MOST_BYTES = 1_000_000


class Names(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A text in two languages."""

    en: Text
    zh: Text


class Parameter(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a user may choose.

    Parameters
    ----------
    default: Used where nothing else is asked for. A whole number without a unit stays a whole number.
    unit: Unit of measure, as in the name's ending; empty for counts and words.
    en, zh: What it is.
    source: The clause that says how large it is, or that the product's specification does.
    least, most: Bounds.
    choices: The words that are possible, where it is a word.
    """

    default: int | float | str | tuple[int | float | str, ...]
    en: Text
    zh: Text
    source: Text
    unit: str = ""
    least: float | None = None
    most: float | None = None
    choices: tuple[str, ...] = ()


class Series(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A list by rule, see `ingest.procedures.series.series`; with `both_directions` each value and its negative."""

    kind: Kind
    min: Value | None = None
    max: Value | None = None
    count: Value | None = None
    room: Value | None = None
    apart: Value | None = None
    both_directions: bool = False
    order: Literal["rising", "falling"] = "rising"


class Item(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    rename={"over": "for", "overrides": "set", "items": "step"},
):
    """One `[[step]]`: a step, a loop over steps, or the use of another procedure.

    Parameters
    ----------
    name: The step's name in the data; of a loop, what its time is summed up under.
    over: ``for``: the loop's variable; `values` or `series` say what it goes over.
    values: Numbers, words, or tables with one value for each of several variables; ``"$parameter"`` for a list
        parameter.
    times: Do the steps so often; `$repeat` counts from 1 and is the step's `repeat`.
    items: ``step``: what the loop does. What the loop itself says of rate, temperature, position and so on holds for
        every step in it that does not say otherwise.
    use: Do the steps of this procedure, a ready one or a file beside this one, with `overrides` (``set``) as its
        parameters.
    rate_deg_per_s, temperature_deg_c, frequency_hz, amplitude_deg_per_s: What the table, the chamber and the angular
        vibration table are set to; what is not said stays as it is.
    angle_deg: Angle that the table goes to and stands at; a rate takes its place.
    position, axis, phase: Words for the step.
    settle_s, record_s, warm_up_s, off_s: Seconds: dropped at the step's start, recorded after that, waited after
        power-on, and without power.
    power: ``off``, ``on``, or ``cycle`` (off for `off_s`, then on); ``none`` changes nothing.
    prompt: What an operator does and confirms before the step.
    room: The step at room temperature.
    wait_settled: Settings that must have settled before the step; by default those that change.
    """

    name: Text | None = None
    over: Name | None = None
    values: tuple[int | float | str | dict[Name, int | float | str], ...] | str | None = None
    series: Series | None = None
    times: Value | None = None
    items: tuple["Item", ...] = ()
    use: Text | None = None
    overrides: dict[Name, Value] = {}
    rate_deg_per_s: Value | None = None
    temperature_deg_c: Value | None = None
    frequency_hz: Value | None = None
    amplitude_deg_per_s: Value | None = None
    angle_deg: Value | None = None
    position: Text | None = None
    axis: Text | None = None
    phase: Text | None = None
    settle_s: Value | None = None
    record_s: Value | None = None
    warm_up_s: Value | None = None
    off_s: Value | None = None
    power: str | None = None
    prompt: Names | None = None
    room: bool | None = None
    wait_settled: tuple[str, ...] | None = None


class ProcedureFile(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, rename={"items": "step"}):
    """The file: a name, its names, where it comes from, parameters and steps."""

    name: Text
    names: Names
    items: Annotated[tuple[Item, ...], Least1]
    source: tuple[Text, ...] = ()
    notes: Names | None = None
    parameters: dict[Name, Parameter] = {}


def ready_names() -> tuple[str, ...]:
    """Names of the procedures that come with gyrofleet.

    Examples
    --------
    >>> "static_bias" in ready_names()
    True
    """
    folder = files("ingest").joinpath(_READY)
    return tuple(sorted(each.name.removesuffix(".toml") for each in folder.iterdir() if each.name.endswith(".toml")))


def read_procedure(name: str | Path, beside: Path | None = None) -> tuple[ProcedureFile, str, Path | None]:
    """Read a procedure: a ready one by its name, or a file.

    Parameters
    ----------
    name: Name of a ready procedure, or path of a file: whatever ends with ``.toml`` or holds a slash.
    beside: Folder that a relative path counts from.

    Returns
    -------
    file : ProcedureFile
        What it says.
    source : str
        Where it comes from, for messages.
    folder : Path or None
        Folder of the file; None of a ready one.

    Raises
    ------
    BadInput: If there is none, or it cannot be read.
    """
    text = str(name)
    if not isinstance(name, Path) and not text.endswith(".toml") and "/" not in text:
        if text not in (ready := ready_names()):
            near = difflib.get_close_matches(text, ready, n=1)
            hint = f", did you mean {near[0]}?" if near else ";"
            raise BadInput(
                f"no procedure {text!r}{hint} `gyrofleet procedure list` shows those that are ready, a file of your "
                f"own is given by its path, as ./{text}.toml"
            )
        found = files("ingest").joinpath(_READY, f"{text}.toml")
        return parse_procedure(found.read_bytes(), f"procedure {text}"), f"procedure {text}", None
    path = Path(name) if beside is None else beside / name
    try:
        with path.open("rb") as file:
            content = file.read(_MOST_BYTES + 1)
    except OSError as error:
        raise BadInput(f"procedure {path} cannot be read: {error.strerror or error}") from error
    if len(content) > _MOST_BYTES:
        raise BadInput(f"procedure {path} is longer than {_MOST_BYTES:,} bytes: this is no procedure")
    return parse_procedure(content, str(path)), str(path), path.parent


def parse_procedure(text: str | bytes, source: str) -> ProcedureFile:
    r"""Read a procedure from TOML.

    Raises
    ------
    BadInput: If it is none; the message names the file and the key, such as ``$.step[2].settle_s``.

    Examples
    --------
    >>> parse_procedure('name = "a"\nnames = {en = "A", zh = "甲"}\n[[step]]\nname = "s"\nrecrod_s = 1', "a.toml")
    Traceback (most recent call last):
    stream.errors.BadInput: a.toml: Object contains unknown field `recrod_s` - at `$.step[0]`
    """
    try:
        parsed = decode_toml(text, ProcedureFile)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise BadInput(f"{source}: {error}") from error
    try:
        check_name("procedure", parsed.name)
    except BadInput as error:
        raise BadInput(f"{source}: $.name: {error}") from error
    for key, parameter in parsed.parameters.items():
        _check_parameter(parameter, f"{source}: $.parameters.{key}")
    return parsed


def _check_parameter(parameter: Parameter, where: str) -> None:
    default = parameter.default
    for value in default if isinstance(default, tuple) else (default,):
        check_value(parameter, value, f"{where}.default")
    if isinstance(default, tuple) and not default:
        raise BadInput(f"{where}.default: an empty list")


def check_value(parameter: Parameter, value: float | str, where: str) -> None:
    """Check one value of a parameter against its kind, bounds and choices.

    Raises
    ------
    BadInput: If it is not of the kind of the default, out of bounds, or none of the choices.
    """
    if isinstance(value, str):
        if parameter.choices and value not in parameter.choices:
            raise BadInput(f"{where}: {value!r} is none of {', '.join(parameter.choices)}")
        return
    if not -1e300 < value < 1e300:
        raise BadInput(f"{where}: {value} is no finite number")
    unit = f" {parameter.unit}" if parameter.unit else ""
    if parameter.least is not None and value < parameter.least:
        raise BadInput(f"{where}: {value:g}{unit} is below the least, {parameter.least:g}{unit}")
    if parameter.most is not None and value > parameter.most:
        raise BadInput(f"{where}: {value:g}{unit} is above the most, {parameter.most:g}{unit}")
