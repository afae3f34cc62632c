"""Conversion macros for the units of measure that occur in a store."""

from collections.abc import Iterable
from contextlib import suppress

from stream.errors import UnknownUnit
from stream.quantities import conversion, is_angular_rate

_ALWAYS = ("deg/s", "deg/h", "rad/s", "degC", "K", "degF")


def conversion_macros(units: Iterable[str]) -> str:
    """Statements that define ``deg_per_h(value, unit_of_measure)`` and ``deg_c(value, unit_of_measure)``.

    Both give null for units of other quantities.

    Examples
    --------
    >>> "when 'rpm' then value * '21600.0'::double + '0.0'::double" in conversion_macros(["rpm"])
    True
    """
    rates: list[tuple[str, float, float]] = []
    temperatures: list[tuple[str, float, float]] = []
    for unit in sorted({*units, *_ALWAYS}):
        with suppress(UnknownUnit):
            if is_angular_rate(unit):
                rates.append((unit, *conversion(unit, "deg/h")))
            else:
                temperatures.append((unit, *conversion(unit, "degC")))
    return (
        f"create or replace macro deg_per_h(value, unit_of_measure) as {_cases(rates)};"
        f"create or replace macro deg_c(value, unit_of_measure) as {_cases(temperatures)};"
    )


def _cases(factors: list[tuple[str, float, float]]) -> str:
    cases = []
    for unit, factor, offset in factors:
        quoted = unit.replace("'", "''")
        # plain literals would be decimals, whose products overflow
        cases.append(f"when '{quoted}' then value * '{factor!r}'::double + '{offset!r}'::double")
    return f"case unit_of_measure {' '.join(cases)} end"
