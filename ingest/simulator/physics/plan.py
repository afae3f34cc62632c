"""The plan of a simulated fleet, from TOML: the effects planted in each unit."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, TypeVar

import msgspec

from ingest.simulator.physics.draws import NotNegative, unit_generator
from ingest.simulator.physics.environment import Environment
from ingest.simulator.physics.gyro import GyroParameters, SimulatedGyro
from stream.errors import BadInput
from stream.identity import check_name
from stream.toml_text import decode_toml

_TRIES = 1000

Settings = TypeVar("Settings", bound=msgspec.Struct)


class ParameterSpread(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Distribution of a number over the units: normal, truncated to `low` to `high`."""

    mean: float
    sd: NotNegative
    low: float = -math.inf
    high: float = math.inf


class _Fleet(GyroParameters, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The `[fleet]` of the file: parameters common to all units, and their names."""

    seed: Annotated[int, msgspec.Meta(ge=0)]
    units: tuple[str, ...] = ()
    power_ons_per_day: Annotated[int, msgspec.Meta(ge=1)] = 1
    hours_per_power_on: NotNegative = 0.0


class Plan(msgspec.Struct, frozen=True):
    """A simulated fleet."""

    seed: int
    parameters: Mapping[str, GyroParameters]  # by serial number, with everything drawn that is constant over a life
    power_ons_per_day: int = 1  # number of power-ons of a unit on one day
    hours_per_power_on: float = 0.0  # hours of operation from one power-on of a unit to the next

    @property
    def units(self) -> tuple[str, ...]:
        """Serial numbers, in order of the file."""
        return tuple(self.parameters)

    def gyro(
        self, unit: str, power_on: int = 1, *, day: int | None = None, age_h: float | None = None,
        environment: Environment | None = None, start_ns: int = 0,
    ) -> SimulatedGyro:  # fmt: skip
        """One power-on of a unit, numbered from 1, see `SimulatedGyro`; day and age follow from it by default."""
        if unit not in self.parameters:
            raise BadInput(f"simulated fleet: no unit {unit!r} in the plan; it has {', '.join(self.units) or 'none'}")
        if power_on < 1:
            raise BadInput(f"simulated fleet: power-on {power_on} of unit {unit}; they are numbered from 1 on")
        day = (power_on - 1) // self.power_ons_per_day + 1 if day is None else day
        age_h = (power_on - 1) * self.hours_per_power_on if age_h is None else age_h
        return SimulatedGyro(
            self.parameters[unit], seed=self.seed, unit=unit, power_on=power_on, day=day, age_h=age_h,
            environment=environment, start_ns=start_ns,
        )  # fmt: skip


def load_plan(path: Path) -> Plan:
    """Read a plan from a file; see `parse_plan`. Raises BadInput if the file cannot be read or is not such a plan."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise BadInput(f"simulated fleet {path}: cannot be read ({error.strerror or error})") from error
    except UnicodeDecodeError as error:
        raise BadInput(f"simulated fleet {path}: is no text in UTF-8 ({error})") from error
    return parse_plan(text, str(path))


def parse_plan(text: str, source: str) -> Plan:
    """Read a plan from TOML.

    `[fleet]` has the `seed`, optionally `units`, `power_ons_per_day` and `hours_per_power_on`, and the effects of every
    unit (see `GyroParameters`). `[unit."FOG-0231"]` has what is different in one; its `off` lists effects of the fleet
    that this unit does not have, such as ``bias.jumps``. A list in a unit replaces the fleet's. In place of a number, a
    `ParameterSpread` is allowed: ``{mean = 0.5, sd = 0.1, low = 0.0}``, drawn once for each unit. Raises BadInput if it
    is not such a plan; the message names the place, such as ``$.unit.FOG-0231.bias.line[0].frequency_hz``.

    >>> plan = parse_plan('''
    ... [fleet]
    ... seed = 7
    ... units = ["FOG-0230"]
    ... [fleet.bias]
    ... constant_deg_per_h = {mean = 0.0, sd = 0.5}
    ... jumps = {rate_per_h = 0.1, sd_deg_per_h = 0.2}
    ... [unit."FOG-0231"]
    ... off = ["bias.jumps"]
    ... thermal.bias_polynomial_deg_per_h = [0.4]
    ... ''', "fleet.toml")
    >>> plan.units, plan.parameters["FOG-0231"].bias.jumps
    (('FOG-0230', 'FOG-0231'), None)
    >>> plan.gyro("FOG-0231", power_on=2).samples(2).counts.dtype
    dtype('int32')
    """
    what = f"simulated fleet {source}"
    try:
        tree = decode_toml(text, dict[str, Any])
    except msgspec.MsgspecError as error:
        raise BadInput(f"{what}: {error}") from error
    unknown = set(tree) - {"fleet", "unit"}
    extra = f", and nothing else: {', '.join(sorted(unknown))}" if unknown else ""
    if unknown or not isinstance(tree.get("fleet"), dict) or not isinstance(tree.get("unit", {}), dict):
        raise BadInput(f'{what}: one [fleet] and any number of [unit."..."] are needed{extra}')
    common = tree["fleet"]
    settings = _convert(_replaced(common, "$.fleet", what, lambda _, spread: spread.mean), _Fleet, "$.fleet", what)

    own: dict[str, Any] = tree.get("unit", {})
    shared = {key: value for key, value in common.items() if key in GyroParameters.__struct_fields__}
    parameters = {}
    for unit in dict.fromkeys((*settings.units, *own)):
        parameters[unit] = _unit_parameters(unit, shared, own.get(unit, {}), settings.seed, what)
    if not parameters:
        raise BadInput(f'{what}: it has no unit; list them in fleet.units or give each a [unit."..."]')
    return Plan(settings.seed, MappingProxyType(parameters), settings.power_ons_per_day, settings.hours_per_power_on)


def _unit_parameters(unit: str, shared: dict[str, Any], own: Any, seed: int, what: str) -> GyroParameters:
    place = f"$.unit.{unit}"
    try:
        check_name("unit", unit)
    except BadInput as error:
        raise BadInput(f"{what}: {error}") from error
    if not isinstance(own, dict):
        raise BadInput(f"{what}: a table is needed - at `{place}`")
    own = dict(own)
    off = own.pop("off", [])
    if not (isinstance(off, list) and all(isinstance(path, str) for path in off)):
        raise BadInput(f'{what}: a list of names such as "bias.jumps" is needed - at `{place}.off`')
    for i, path in enumerate(off):
        missing = f"{what}: the fleet has no {path} to switch off - at `{place}.off[{i}]`"
        shared = _without(shared, path.split("."), missing)

    def draw(path: str, spread: ParameterSpread) -> float:
        generator = unit_generator(seed, unit, path.removeprefix(f"{place}."))
        for _ in range(_TRIES):
            value = spread.mean + spread.sd * float(generator.standard_normal())
            if spread.low <= value <= spread.high:
                return value
        raise BadInput(f"{what}: low and high leave hardly any of the distribution - at `{path}`")

    return _convert(_replaced(_merged(shared, own), place, what, draw), GyroParameters, place, what)


def _convert(tree: Any, kind: type[Settings], place: str, what: str) -> Settings:
    try:
        return msgspec.convert(tree, kind)
    except msgspec.ValidationError as error:
        text = str(error)
        # msgspec names no place where it is the root
        text = text.replace("`$", f"`{place}") if "`$" in text else f"{text} - at `{place}`"
        raise BadInput(f"{what}: {text}") from error


def _replaced(tree: Any, place: str, what: str, value_of: Callable[[str, ParameterSpread], float]) -> Any:
    """The tree with a number in place of every distribution; numbers that are not finite are refused."""
    if _is_spread(tree):
        for key, bound in tree.items():
            _finite(bound, f"{place}.{key}", what)
        spread = _convert(tree, ParameterSpread, place, what)
        if not spread.low <= spread.mean <= spread.high:
            raise BadInput(f"{what}: the mean does not lie from low to high - at `{place}`")
        return value_of(place, spread)
    if isinstance(tree, dict):
        return {key: _replaced(value, f"{place}.{key}", what, value_of) for key, value in tree.items()}
    if isinstance(tree, list):
        return [_replaced(value, f"{place}[{i}]", what, value_of) for i, value in enumerate(tree)]
    _finite(tree, place, what)
    return tree


def _finite(value: Any, place: str, what: str) -> None:
    if isinstance(value, float) and not math.isfinite(value):
        raise BadInput(f"{what}: {value} is no finite number - at `{place}`")


def _is_spread(tree: Any) -> bool:
    return isinstance(tree, dict) and "mean" in tree


def _merged(common: Any, own: Any) -> Any:
    """`own` over `common`, table by table; distributions and lists are replaced as a whole."""
    if not (isinstance(common, dict) and isinstance(own, dict)) or _is_spread(common) or _is_spread(own):
        return own
    return common | {key: _merged(common[key], value) if key in common else value for key, value in own.items()}


def _without(tree: dict[str, Any], path: list[str], missing: str) -> dict[str, Any]:
    head, *rest = path
    if head not in tree or (rest and not isinstance(tree[head], dict)):
        raise BadInput(missing)
    others = {key: value for key, value in tree.items() if key != head}
    return others | {head: _without(tree[head], rest, missing)} if rest else others
