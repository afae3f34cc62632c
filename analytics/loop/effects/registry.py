"""The library of effects, found in the files of this package."""

import functools
import importlib
import inspect
import pkgutil
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect
from analytics.loop.effects.events import StationChange, TurnOnScatter
from analytics.loop.effects.monomial import PREFIX, Monomial, channel_linear, is_linear
from analytics.loop.effects.temperature import SensorLag
from stream.channel_names import STANDARD_CHANNELS
from stream.errors import BadInput
from stream.files.own_files import imported
from stream.mistakes import similar_names

_PACKAGE = __name__.rpartition(".")[0]
_NOT_SEARCHED = (TurnOnScatter, StationChange, SensorLag)  # noise, and what is of no unit or beside others only


@functools.cache
def effects() -> Mapping[str, Effect]:
    """Every effect of the library by its name, in the order of names."""
    package = importlib.import_module(_PACKAGE)
    found: dict[str, Effect] = {}
    places: dict[str, str] = {}
    for module in pkgutil.iter_modules(package.__path__):
        for each in _effects_in(module.name):
            if each.name in found:
                raise BadInput(
                    f"effect {each.name!r} is in {places[each.name]}.py and in {module.name}.py of "
                    "analytics/loop/effects: give one of them another name"
                )
            found[each.name], places[each.name] = each, module.name
    return MappingProxyType(dict(sorted(found.items())))


def _effects_in(module: str) -> Iterator[Effect]:
    """Effects of a file: the instances in its ``EFFECTS``, and each of its own classes that has a name."""
    found = imported(_PACKAGE, module)
    yield from getattr(found, "EFFECTS", ())
    for _, cls in inspect.getmembers(found, inspect.isclass):
        if cls.__module__ != found.__name__ or cls in _NOT_SEARCHED:
            continue
        if issubclass(cls, Effect) and hasattr(cls, "name"):
            yield cls()


def effect(name: str) -> Effect:
    """The effect of this name; ``channel:NAME`` is the linear effect of any channel.

    >>> effect("channel:compressor").needs
    ('compressor',)
    >>> effect("temprature")
    Traceback (most recent call last):
    stream.errors.BadInput: effect 'temprature' is not known; did you mean temperature, ...
    """
    known = effects()
    if name in known:
        return known[name]
    for cls in _NOT_SEARCHED:
        if name == cls.name:
            return cls()
    if name.startswith(PREFIX) and len(name) > len(PREFIX):
        return channel_linear(name.removeprefix(PREFIX))
    near = similar_names(name, known, most=3)
    plain = [each for each in known if "*" not in each]
    hint = (
        f"did you mean {', '.join(near)}?" if near else f"known are {', '.join(plain)}, and {PREFIX}NAME of a channel"
    )
    raise BadInput(f"effect {name!r} is not known; {hint}")


def effect_name(name: str) -> Bilingual:
    """The name of an effect in words.

    >>> effect_name("ageing"), effect_name("ageing").zh
    ('ageing over days', '长期老化')
    """
    known = effect(name)
    return Bilingual(known.en, known.zh)


def effects_for(runs: Sequence[RunBlocks]) -> Mapping[str, Effect]:
    """The effects that these runs allow to search for, with the linear effect of each channel of another name."""
    candidates = _candidates(runs)
    return MappingProxyType({name: each for name, each in candidates.items() if each.unavailable(runs) is None})


def unavailable_effects(runs: Sequence[RunBlocks]) -> Mapping[str, Bilingual]:
    """Why these runs do not allow a search for each of the other effects."""
    reasons = {name: each.unavailable(runs) for name, each in _candidates(runs).items()}
    return MappingProxyType({name: reason for name, reason in reasons.items() if reason is not None})


def _candidates(runs: Sequence[RunBlocks]) -> dict[str, Effect]:
    present = {channel for run in runs for channel in run.channels}
    others = present - set(STANDARD_CHANNELS)
    if "temperature" not in present:
        others |= present & {"case_temperature"}  # else it is temperature and temperature_gradient together
    # no test separates two effects that have the same column
    named = {next(iter(each.powers)) for each in effects().values() if isinstance(each, Monomial) and is_linear(each)}
    return {**effects(), **{each.name: each for each in map(channel_linear, sorted(others - named))}}
