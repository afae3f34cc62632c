"""Where the coefficients of an error model hold: the reference points of the channels in its terms."""

import re
from collections.abc import Iterator

import msgspec

from analytics.loop.effects.channel_names import reference_point
from analytics.loop.effects.monomial import NOMINAL, Monomial
from analytics.loop.effects.registry import effect
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.model.model_text import BIAS

_UNITS = re.compile(r"[^/*()^]+")


class ReferencePoint(msgspec.Struct, frozen=True, kw_only=True):
    """A term takes a channel from this value on; `unit_of_measure` is empty where the model does not have it."""

    term: str
    channel: str
    value: float
    unit_of_measure: str

    def __str__(self) -> str:
        return f"{self.channel} {self.value:g} {self.unit_of_measure}".strip()


def reference_points(model: ErrorModel) -> list[ReferencePoint]:
    """Reference points other than 0: those of temperatures, and the nominal values of channels without a zero.

    >>> text = "rate = bias + temperature + supply_voltage_squared(supply_voltage_nominal=12.1)"
    >>> units = ("deg/h", "deg/h/degC", "deg/h/V^2")
    >>> model = ErrorModel.parse(text).fitted([10.0, 0.5, 2.0], unit_of_measure="deg/h", units=units)
    >>> [str(each) for each in reference_points(model)]
    ['temperature 25 degC', 'supply_voltage 12.1 V']
    """
    return list(_points(model))


def _points(model: ErrorModel) -> Iterator[ReferencePoint]:
    at = 0
    for term in model.terms:
        per = model.units[at] if at < len(model.units) else ""
        at += len(term.labels())
        found = None if term.name == BIAS else effect(term.name)
        if not isinstance(found, Monomial):
            continue
        units = _UNITS.findall(per.removeprefix(model.unit_of_measure or ""))
        for channel in found.powers:
            nominal = term.shape.get(channel + NOMINAL)
            if nominal is not None:
                unit = units[0] if len(found.powers) == 1 and units else ""
                yield ReferencePoint(term=str(term), channel=channel, value=float(nominal), unit_of_measure=unit)
            elif "temperature" in channel or channel == "chamber_setpoint":
                known = next((each for each in units if reference_point(each)), None)
                if known is not None:
                    value = reference_point(known)
                    yield ReferencePoint(term=str(term), channel=channel, value=value, unit_of_measure=known)


def reference_sentence(points: list[ReferencePoint]) -> str:
    """For people: from where the channels in powers and products count.

    >>> reference_sentence([])
    'reference points of powers and products of channels: 0 of each'
    """
    named = ", ".join(dict.fromkeys(map(str, points)))
    of = "reference points of powers and products of channels"
    return f"{of}: {named}; 0 of each other channel" if named else f"{of}: 0 of each"
