"""A simulated fleet from TOML: what is planted in every unit, with distributions drawn once for each."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Generic, NamedTuple, TypeVar

import msgspec

from ingest.simulator.physics.draws import NotNegative, unit_generator
from stream.decoding import converted
from stream.errors import BadInput
from stream.files.toml_text import decode_toml
from stream.identity import check_name

_TRIES = 1000

Settings = TypeVar("Settings", bound=msgspec.Struct)


class ParameterSpread(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Distribution of a number over the units: normal, truncated to `low` to `high`."""

    mean: float
    sd: NotNegative
    low: float = -math.inf
    high: float = math.inf


class FleetSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What the `[fleet]` of the file says besides the parameters common to all units."""

    seed: Annotated[int, msgspec.Meta(ge=0)]
    units: tuple[str, ...] = ()
    power_ons_per_day: Annotated[int, msgspec.Meta(ge=1)] = 1
    hours_per_power_on: NotNegative = 0.0


class Fleet(NamedTuple, Generic[Settings]):
    """Settings of a fleet, and the parameters of its units by serial number."""

    settings: FleetSettings
    parameters: Mapping[str, Settings]


def read_fleet(path: Path, kind: type[Settings]) -> Fleet[Settings]:
    """Read a fleet from a file; see `parse_fleet`."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise BadInput(f"simulated fleet {path}: cannot be read ({error.strerror or error})") from error
    return parse_fleet(content, str(path), kind)


def parse_fleet(text: str | bytes, source: str, kind: type[Settings]) -> Fleet[Settings]:
    """Read a fleet of units with parameters of a kind.

    `[fleet]` has the `FleetSettings` and the effects of every unit. `[unit."FOG-0231"]` has what is different in one;
    its `off` lists effects of the fleet that this unit does not have, such as ``bias.jumps``. A list in a unit replaces
    the fleet's. In place of a number, a `ParameterSpread` is allowed: ``{mean = 0.5, sd = 0.1, low = 0.0}``, drawn once
    for each unit. Raises BadInput if it is not such a fleet; the message names the place, such as
    ``$.unit.FOG-0231.bias.line[0].frequency_hz``.
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
    usual = _replaced(common, "$.fleet", what, lambda _, spread: spread.mean)
    if not isinstance(usual, dict):  # its keys are those of a spread
        raise BadInput(f"{what}: a table of settings and effects is needed - at `$.fleet`")
    own_fields = FleetSettings.__struct_fields__
    settings = _convert({k: v for k, v in usual.items() if k in own_fields}, FleetSettings, "$.fleet", what)
    _convert({k: v for k, v in usual.items() if k not in own_fields}, kind, "$.fleet", what)

    own: dict[str, Any] = tree.get("unit", {})
    shared = {key: value for key, value in common.items() if key not in own_fields}
    parameters = {}
    for unit in dict.fromkeys((*settings.units, *own)):
        parameters[unit] = _unit_parameters(unit, shared, own.get(unit, {}), settings.seed, what, kind)
    if not parameters:
        raise BadInput(f'{what}: it has no unit; list them in fleet.units or give each a [unit."..."]')
    return Fleet(settings, MappingProxyType(parameters))


def _unit_parameters(
    unit: str, shared: dict[str, Any], own: Any, seed: int, what: str, kind: type[Settings]
) -> Settings:
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

    return _convert(_replaced(_merged(shared, own), place, what, draw), kind, place, what)


def _convert(tree: Any, kind: type[Settings], place: str, what: str) -> Settings:
    try:
        return converted(tree, kind)
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
