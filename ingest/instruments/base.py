"""What an instrument of a station is: what it can be set to, what it measures, and on which clock.

An instrument is one file in this package with one subclass of `Instrument`, and one table in `station.toml`. The
station finds it by its `kind`.
"""

import importlib
import inspect
import pkgutil
import threading
from abc import ABC, abstractmethod
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, Self

import msgspec

from ingest.station_clock import StationClock
from stream.errors import BadInput


class Reading(NamedTuple):
    """One value that an instrument measured."""

    signal: str
    t_ns: int
    value: float


class Options(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What every instrument's table in `station.toml` may say; subclasses add what theirs needs.

    Parameters
    ----------
    sample_interval_s: How often it is read, seconds at the station.
    calibration_due: Day on which its calibration ends, as 2027-03-31.
    serial: Its serial number.
    """

    sample_interval_s: float = 1.0
    calibration_due: str | None = None
    serial: str = ""


class Instrument(ABC):
    """One instrument; its methods are called from one thread at a time.

    Where several threads use it, each holds `lock` while it calls a method: the sampler that reads it does, and so does
    whoever sets it meanwhile.

    Parameters
    ----------
    name: What the station calls it; its samples are those of a unit of this name.
    options: Its table in `station.toml`.
    clock: The station's clock.

    Attributes
    ----------
    kind: Name by which a station file asks for it.
    names: What it is called, ``en`` and ``zh``.
    options_type: The `Options` that it takes.
    settings: What it can be set to, and in which unit of measure: ``{"rate": "deg/s"}``.
    signals: What it measures, and in which unit of measure.
    lock: Held by whoever calls a method, where several threads do.
    """

    kind: ClassVar[str]
    names: ClassVar[Mapping[str, str]]
    options_type: ClassVar[type[Options]] = Options
    settings: ClassVar[Mapping[str, str]] = MappingProxyType({})
    signals: ClassVar[Mapping[str, str]] = MappingProxyType({})

    def __init__(self, name: str, options: Any, clock: StationClock) -> None:
        self.name = name
        self.options = options
        self.clock = clock
        self.lock = threading.RLock()

    @abstractmethod
    def open(self) -> str:
        """Connect; what it says it is.

        Raises
        ------
        InstrumentError: If it cannot be reached or is another one.
        """

    @abstractmethod
    def close(self) -> None:
        """Let go of it; never raises."""

    def set(self, what: str, value: float) -> None:
        """Command one of its settings, in that setting's unit; it returns at once.

        Raises
        ------
        InstrumentError: If it cannot be reached, refuses, or the value is beyond its range.
        """
        raise BadInput(f"the {self.names['en']} {self.name} cannot be set to a {what} of {value:g}")

    def is_settled(self, what: str) -> bool:  # noqa: ARG002
        """Whether it has reached what a setting was last set to.

        Raises
        ------
        InstrumentError: If it cannot be reached.
        """
        return True

    def sample(self) -> list[Reading]:
        """Measure once; an instrument without signals measures nothing.

        Raises
        ------
        InstrumentError: If it cannot be reached, or what it answers is no measurement.
        """
        return []

    def make_safe(self) -> None:  # noqa: B027  most have nothing to bring to rest
        """Bring it to where it can be left alone: a table at rest, a chamber at room temperature.

        Raises
        ------
        InstrumentError: If it cannot be reached.
        """

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def instrument_kinds() -> dict[str, type[Instrument]]:
    """Every instrument in this package by its kind; simulated ones are reached like real ones and have none."""
    package = importlib.import_module("ingest.instruments")
    found: dict[str, type[Instrument]] = {}
    for module in pkgutil.iter_modules(package.__path__, "ingest.instruments."):
        if module.ispkg:
            continue
        for _, each in inspect.getmembers(importlib.import_module(module.name), inspect.isclass):
            if not issubclass(each, Instrument) or each.__module__ != module.name:
                continue
            if not inspect.isabstract(each) and hasattr(each, "kind"):  # without one, others build on it
                found[each.kind] = each
    return found
