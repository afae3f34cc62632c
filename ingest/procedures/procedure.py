"""Test procedures as data in TOML: settings, settling, records.

A file has the procedure's names in two languages, the clauses that it follows, parameters that a user may choose, and
steps. A `[[step]]` is a step, a loop over `[[step.step]]`, or the `use` of another procedure, as described in
`ingest.procedures.file`.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path

import msgspec

from ingest.procedures.file import Parameter, ProcedureFile, check_value, read_procedure
from ingest.procedures.plan import SETTINGS, PlannedStep, Planner, Used
from ingest.procedures.run_steps import Spent, StationRates, spent_by_part
from ingest.procedures.values import Scalar, items_of
from stream.errors import BadInput
from stream.mistakes import near_name

_MOST_NESTED = 8

Choice = Scalar | tuple[Scalar, ...]
Given = Mapping[str, str | Choice] | None


class Requirement(msgspec.Struct, frozen=True, kw_only=True):
    """A setting that a procedure needs: from `least` to `most`, in `unit`, and how many steps set it."""

    setting: str
    unit: str
    least: float
    most: float
    steps: int


class Procedure:
    """A procedure with its steps and parameters, and those of the procedures that it uses."""

    def __init__(self, file: ProcedureFile, used: Used, parameters: Mapping[str, Parameter]) -> None:
        self.name, self.names, self.notes = file.name, file.names, file.notes
        self.source = file.source  # the clauses that it follows
        self.parameters, self._used = parameters, used

    def chosen(self, given: Given = None) -> dict[str, Choice]:
        """Every parameter's value, as given or its default; raises BadInput if it is none, or out of bounds."""
        values: dict[str, Choice] = {name: each.default for name, each in self.parameters.items()}
        for name, value in (given or {}).items():
            if name not in self.parameters:
                raise BadInput(f"procedure {self.name} has no parameter {_unknown(name, self.parameters)}")
            values[name] = _read(self.parameters[name], value, f"procedure {self.name}: {name}")
        return values

    def steps(self, parameters: Given = None) -> tuple[PlannedStep, ...]:
        """All steps in order; raises BadInput, with file and key, if a parameter or a step is invalid.

        >>> steps = load_procedure("static_bias").steps({"bias_record_s": 7200})
        >>> [(each.words.step, each.record_s) for each in steps if each.is_recorded]
        [('static', 7200.0)]
        """
        return Planner(self.name).plan(self._used, self.chosen(parameters))

    def requirements(self, parameters: Given = None) -> tuple[Requirement, ...]:
        """Settings that a station needs, with their ranges."""
        found: dict[str, list[float]] = {}
        for step in self.steps(parameters):
            for name, value in step.settings.items():
                found.setdefault(name, []).append(value)
        return tuple(
            Requirement(setting=name, unit=SETTINGS[name], least=min(values), most=max(values), steps=len(values))
            for name in SETTINGS
            if (values := found.get(name))
        )

    def unmet(self, settings: Iterable[str], parameters: Given = None) -> tuple[str, ...]:
        """Sentences on what a station with these settings lacks; empty where it can do the procedure."""
        able = set(settings)
        return tuple(
            f"{each.steps} steps set the {each.setting}, from {each.least:g} to {each.most:g} {each.unit}, and no "
            "instrument of the station has that setting"
            for each in self.requirements(parameters)
            if each.setting not in able
        )

    def spent(self, rates: StationRates, parameters: Given = None) -> dict[str, Spent]:
        """Time of each part at a station, see `spent_by_part`."""
        return spent_by_part(self.steps(parameters), rates)

    def duration_s(self, parameters: Given = None) -> float:
        """Total time at a usual station, seconds: power-off, ramps, warm-up, settling, recording and prompts."""
        return sum((each.total_s for each in self.spent(StationRates(), parameters).values()), 0.0)


def load_procedure(name: str | Path) -> Procedure:
    """Read a ready procedure by its name, or a file; raises BadInput if there is none, or it is invalid by default.

    >>> load_procedure("static_bias").names.zh
    '零偏与零偏稳定性'
    """
    file, source, folder = read_procedure(name)
    used, parameters = _with_used(file, source, folder, (source,))
    procedure = Procedure(file, used, parameters)
    try:
        procedure.steps()
    except BadInput as error:
        raise error if source in str(error) else BadInput(f"{source}: {error}") from error
    return procedure


def _with_used(
    file: ProcedureFile, source: str, folder: Path | None, chain: tuple[str, ...]
) -> tuple[Used, dict[str, Parameter]]:
    """The steps with those of used procedures, and the parameters of all; its own take precedence."""
    procedures: dict[str, Used] = {}
    theirs: dict[str, tuple[Parameter, str]] = {}
    for key, item in items_of(file.items):
        if item.use is None:
            continue
        where = f"{source}: {key}.use"
        try:
            other, other_source, other_folder = read_procedure(item.use, folder)
        except BadInput as error:
            raise BadInput(f"{where}: {error}") from error
        if other_source in chain or len(chain) > _MOST_NESTED:
            raise BadInput(f"{where}: {' uses '.join((*chain, other_source))}: a procedure cannot use itself")
        inner, parameters = _with_used(other, other_source, other_folder, (*chain, other_source))
        procedures[item.use] = inner
        for name in item.overrides:
            if name not in parameters:
                raise BadInput(f"{where}: {other_source} has no parameter {_unknown(name, parameters)}")
        for name, parameter in parameters.items():
            if name in file.parameters:
                continue
            before = theirs.setdefault(name, (parameter, other_source))
            if before[0].default != parameter.default:
                raise BadInput(
                    f"{where}: {name} is {parameter.default} in {other_source} and {before[0].default} in "
                    f"{before[1]}; say in [parameters.{name}] what it is here"
                )
    inherited = {name: parameter for name, (parameter, _) in theirs.items()}
    return Used(file.items, source, procedures), {**file.parameters, **inherited}


def _unknown(name: str, parameters: Mapping[str, Parameter]) -> str:
    return f"{name!r}{near_name(name, parameters)}; it has {', '.join(parameters) or 'none'}"


def _read(parameter: Parameter, value: str | Choice, where: str) -> Choice:
    default = parameter.default
    if isinstance(default, tuple):
        parts = value.split(",") if isinstance(value, str) else value if isinstance(value, tuple) else (value,)
        return tuple(_read_one(parameter, default[0], each, where) for each in parts)
    if isinstance(value, tuple):
        raise BadInput(f"{where}: one value is expected, not a list")
    return _read_one(parameter, default, value, where)


def _read_one(parameter: Parameter, like: Scalar, value: Scalar, where: str) -> Scalar:
    read: Scalar = value.strip() if isinstance(value, str) else value
    if not isinstance(like, str):
        try:
            read = float(value)
        except ValueError as error:
            unit = f" in {parameter.unit}" if parameter.unit else ""
            raise BadInput(f"{where}: {value!r} is no number{unit}") from error
        if isinstance(like, int) and not parameter.unit:
            if not read.is_integer():
                raise BadInput(f"{where}: {value} is no whole number")
            read = int(read)
    elif not isinstance(value, str):
        raise BadInput(f"{where}: a word is expected, not {value:g}")
    check_value(parameter, read, where)
    return read
