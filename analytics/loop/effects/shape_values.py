"""Reading shape parameters, which may come from a text that a person wrote."""

import math

import numpy as np

from analytics.loop.effects.base import Shape
from stream.batch import FloatArray
from stream.errors import BadInput


def number(shape: Shape, name: str) -> float:
    """A shape parameter that is one number.

    Examples
    --------
    >>> number({"time_constant": 600}, "time_constant")
    600.0
    >>> number({}, "time_constant")
    Traceback (most recent call last):
    stream.errors.BadInput: time_constant is missing; give it as time_constant=NUMBER
    """
    value = shape.get(name)
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < math.inf:
        return float(value)
    what = "is missing" if value is None else f"is {value!r}, not a number"
    raise BadInput(f"{name} {what}; give it as {name}=NUMBER")


def positive(shape: Shape, name: str) -> float:
    """A shape parameter that must be above 0, such as a time constant."""
    value = number(shape, name)
    if not value > 0:
        raise BadInput(f"{name} is {value:g}; it must be above 0")
    return value


def numbers(shape: Shape, name: str) -> FloatArray:
    """A shape parameter that is a list of increasing numbers, such as knots."""
    value = shape.get(name)
    if not isinstance(value, list | tuple) or not all(isinstance(each, int | float) for each in value):
        raise BadInput(f"{name} is {value!r}; a list of numbers is needed")
    found = np.asarray(value, dtype=np.float64)
    if found.size < 2 or not np.isfinite(found).all() or not np.all(np.diff(found) > 0):
        raise BadInput(f"{name} is {value!r}; at least two increasing numbers are needed")
    return found
