"""All effects, found by themselves in the files of this package."""

import difflib
import functools
import importlib
import inspect
import pkgutil
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from analytics.loop.blocks.run_blocks import STANDARD_CHANNELS, RunBlocks
from analytics.loop.effects.base import Effect
from analytics.loop.effects.channel_linear import PREFIX, ChannelLinear
from analytics.loop.effects.turn_on import TURN_ON, TurnOnScatter
from stream.errors import BadInput

_PACKAGE = __name__.rpartition(".")[0]


@functools.cache
def effects() -> Mapping[str, Effect]:
    """Every effect of the library by its name, in the order of names.

    Examples
    --------
    >>> effects()["warm_up"].en
    'warm-up after power-on'
    """
    package = importlib.import_module(_PACKAGE)
    for module in pkgutil.iter_modules(package.__path__):
        importlib.import_module(f"{_PACKAGE}.{module.name}")
    found = [instance for cls in _concrete() for instance in cls.instances()]
    return MappingProxyType({instance.name: instance for instance in sorted(found, key=lambda e: e.name)})


def effect(name: str) -> Effect:
    """The effect of this name; ``channel:NAME`` is the linear effect of any channel.

    Raises
    ------
    BadInput: If there is none; the message names those that look alike.

    Examples
    --------
    >>> effect("channel:compressor").needs
    ('compressor',)
    >>> effect("temprature")
    Traceback (most recent call last):
    stream.errors.BadInput: effect 'temprature' is not known; did you mean temperature, ...
    """
    known = effects()
    if name in known:
        return known[name]
    if name == TURN_ON:
        return TurnOnScatter()
    if name.startswith(PREFIX) and len(name) > len(PREFIX):
        return ChannelLinear(name.removeprefix(PREFIX))
    near = difflib.get_close_matches(name, known, n=3, cutoff=0.5)
    plain = [each for each in known if "*" not in each]
    hint = (
        f"did you mean {', '.join(near)}?" if near else f"known are {', '.join(plain)}, and {PREFIX}NAME of a channel"
    )
    raise BadInput(f"effect {name!r} is not known; {hint}")


def effects_for(runs: Sequence[RunBlocks]) -> Mapping[str, Effect]:
    """The effects that can be looked for in these runs, with the linear effect of each channel of another name."""
    candidates = {**effects(), **{each.name: each for each in _of_other_channels(runs)}}
    return MappingProxyType({name: each for name, each in candidates.items() if each.unavailable(runs) is None})


def unavailable_effects(runs: Sequence[RunBlocks]) -> Mapping[str, str]:
    """Why each of the other effects cannot be looked for in these runs."""
    candidates = {**effects(), **{each.name: each for each in _of_other_channels(runs)}}
    reasons = {name: each.unavailable(runs) for name, each in candidates.items()}
    return MappingProxyType({name: reason for name, reason in reasons.items() if reason is not None})


def _of_other_channels(runs: Sequence[RunBlocks]) -> list[ChannelLinear]:
    present = {channel for run in runs for channel in run.channels}
    others = present - set(STANDARD_CHANNELS)
    if "temperature" not in present:
        others |= present & {"case_temperature"}  # else it is temperature and temperature_gradient together
    return [ChannelLinear(channel) for channel in sorted(others)]


def _concrete() -> list[type[Effect]]:
    found: set[type[Effect]] = set()
    waiting = list(Effect.__subclasses__())
    while waiting:
        each = waiting.pop()
        waiting.extend(each.__subclasses__())
        if not inspect.isabstract(each) and each.__module__.startswith(f"{_PACKAGE}."):
            found.add(each)
    return list(found)
