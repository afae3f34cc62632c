"""Base class of instruments: settings, signals, and the station's clock.

An instrument is one file in this package with one subclass of `Instrument`, found by its `kind`, and one table in
`station.toml`.
"""

import importlib
import inspect
import pkgutil
import threading
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, Self

from ingest.measurement_standards import Standard
from ingest.station_clock import StationClock
from stream.errors import BadInput
from stream.files.own_files import imported

NOTHING: Mapping[str, str] = MappingProxyType({})


class Reading(NamedTuple):
    """One value that an instrument measured."""

    signal: str
    t_ns: int
    value: float


class Moving(NamedTuple):
    """What an instrument that was made safe still does: how far it is from rest, and a sentence."""

    left: float
    text: str


class Options(Standard, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Options of every instrument's table in `station.toml`, with what is stated of it; subclasses add their own."""

    sample_interval_s: float = 1.0  # interval between readings, seconds at the station


class Instrument(ABC):
    """One instrument; its methods are called from one thread at a time, under `lock` where several threads use it.

    They raise InstrumentError if it cannot be reached, is another one, or refuses. Its samples are of a unit `name`.
    """

    kind: ClassVar[str]  # its name in station files
    names: ClassVar[Mapping[str, str]]  # its names, ``en`` and ``zh``
    options_type: ClassVar[type[Options]] = Options  # the `Options` that it takes
    settings: ClassVar[Mapping[str, str]] = NOTHING  # what can be set, with units of measure: ``{"rate": "deg/s"}``
    signals: ClassVar[Mapping[str, str]] = NOTHING  # what it measures, with units of measure
    faults: Mapping[str, str] = NOTHING  # of the last `sample`: why a signal has no value, while others have theirs
    notes: Collection[str] = ()  # what people are to know of how it is read

    def __init__(self, name: str, options: Any, clock: StationClock) -> None:
        self.name, self.options, self.clock = name, options, clock
        self.lock = threading.RLock()

    @abstractmethod
    def open(self) -> str:
        """Connect; returns its identity."""

    @abstractmethod
    def close(self) -> None:
        """Disconnect; never raises."""

    def set(self, what: str, value: float) -> None:
        """Command one of its settings, in that setting's unit; returns at once."""
        raise BadInput(f"the {self.names['en']} {self.name} cannot be set to a {what} of {value:g}")

    def is_settled(self, what: str) -> bool:  # noqa: ARG002
        """Whether a setting has reached its last value."""
        return True

    @property
    def positions(self) -> Collection[str]:
        """Positions, by the names of procedures, to which it carries the units without an operator."""
        return ()

    def carry(self, position: str) -> None:
        """Carry the units to a position; returns when they are there."""
        raise BadInput(f"the {self.names['en']} {self.name} carries no unit to position {position}")

    def sample(self) -> list[Reading]:
        """Measure every signal once."""
        return []

    def try_out(self, settings: Collection[str]) -> list[Reading]:  # noqa: ARG002
        """Measure every signal, and `settings` that will be waited for, once before a run; `faults` as of `sample`."""
        return self.sample()

    def make_safe(self) -> None:  # noqa: B027  most are always safe
        """Bring it to a state in which it can be left alone: a table at rest, a chamber at room temperature."""

    def moving(self) -> Moving | None:
        """What is measured to go on after `make_safe`, as a table that turns; None at rest, or if not measured."""
        return None

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def instrument_kinds() -> dict[str, type[Instrument]]:
    """Every instrument class in this package by its kind; simulated instruments use the same classes."""
    package = "ingest.instruments"
    files = pkgutil.iter_modules(importlib.import_module(package).__path__)
    modules = [imported(package, each.name) for each in files]
    return {
        each.kind: each
        for module in modules
        for _, each in inspect.getmembers(module, inspect.isclass)
        # a class without a kind is a base of others
        if issubclass(each, Instrument) and each.__module__ == module.__name__ and hasattr(each, "kind")
    }
