"""Checks of a specification against the metrics, before it is entered."""

import math
import re
from contextlib import suppress

from analytics.methods.repeatability import KINDS
from analytics.metric_registry.magnitudes import is_nearer_zero
from analytics.metric_registry.registry import alike, check_metrics, metrics
from storage.specifications import specification
from storage.specifications.specification import Specification, SpecificationLimit
from stream.errors import BadInput, UnknownUnit
from stream.quantities import check_result_unit, is_noise_density, result_factor, side_of

# parameters that have one of a few words
_WORDS = {"earth_rate": ("none", "removed"), "kind": KINDS}
_OF_OUTPUT = frozenset({"scale_factor"})  # in the unit of the output over deg/s, where that is no rate
_OUTPUTS = ("count", "V", "A", "Hz")


def checked_specification(content: bytes, source: str) -> Specification:
    """Read a specification and check it against the metrics.

    The `source` it comes from is for messages, and for its name where the file gives none. Raises BadInput if anything
    in it is not right: an unknown metric or standard, a unit of measure that does not fit, limits that repeat each
    other; the message names the file, the line and the key.
    """
    found = specification.parse_specification(content, source)
    where = f"specification {source}"
    specification.check_names(found, where)
    _check_limits(found, content, where)
    return found


def _check_limits(found: Specification, content: bytes, where: str) -> None:
    lines = [at for at, line in enumerate(content.decode().splitlines(), 1) if re.match(r"\s*\[\[\s*limit", line)]
    for at, limit in enumerate(found.limits):
        line = f"line {lines[at]}, " if at < len(lines) else ""
        place = f"{where}: {line}$.limit[{at}] ({limit.metric})"
        _check_limit(limit, found, place)
        if (first := next((i for i in range(at) if found.limits[i].meets(limit)), None)) is not None:
            same = f"$.limit[{first}] limits the same; keep one, or tell them apart by their parameters"
            raise BadInput(f"{place}: {same}")


def _check_limit(limit: SpecificationLimit, found: Specification, place: str) -> None:
    check_metrics([limit.metric], place)
    header = metrics()[limit.metric].header
    _check_unit(limit, header.unit, place)
    for name, value in limit.parameters.items():
        if name not in header.parameters:
            known = alike(name, header.parameters, "its parameters are")
            raise BadInput(f"{place}: no value of {limit.metric} has a parameter {name!r}; {known}")
        if name in _WORDS and value not in _WORDS[name]:
            known = alike(str(value), _WORDS[name], "there is")
            raise BadInput(f"{place}: no value of {limit.metric} has {name} = {value!r}; {known}")
    _check_sides(limit, place)
    if limit.standard is not None:
        of_metric = list(dict.fromkeys(source.standard for source in header.sources))
        if limit.standard not in of_metric:
            raise BadInput(f"{place}: standard {limit.standard!r} is not one of the metric's: {', '.join(of_metric)}")
    if limit.product is not None and found.products and limit.product not in found.products:
        raise BadInput(
            f"{place}: product {limit.product!r} has no [product.NAME] in this file; "
            f"{alike(limit.product, found.products, 'those that have are')}"
        )


def _check_sides(limit: SpecificationLimit, place: str) -> None:
    if limit.lower is None and limit.upper is None:
        raise BadInput(f"{place}: it has neither lower nor upper")
    for key, number in (("lower", limit.lower), ("upper", limit.upper)):
        if number is not None and not math.isfinite(number):
            raise BadInput(f"{place}: {key} is {number}; leave it out where there is no such limit")
    if limit.lower is not None and limit.upper is not None and limit.lower > limit.upper:
        raise BadInput(f"{place}: lower {limit.lower:g} lies above upper {limit.upper:g}")
    if is_nearer_zero(limit.metric) and limit.upper is None:
        raise BadInput(
            f"{place}: by lower alone every value above it passes: write upper too, as lower = -1, upper = 1"
        )
    if is_nearer_zero(limit.metric) and limit.lower is None and limit.upper is not None and limit.upper < 0:
        raise BadInput(f"{place}: upper alone limits the magnitude, and {limit.upper:g} is below 0")


def _check_side(limit: SpecificationLimit, unit: str, place: str) -> None:
    """Refuse a noise density that does not say its side: data sheets mean either, which differ by sqrt(2)."""
    measure, side = side_of(limit.unit_of_measure)
    if side is not None or is_noise_density(unit) or not is_noise_density(measure):
        return
    value = limit.upper if limit.upper is not None else limit.lower
    assert value is not None  # a limit has one side or both
    one, two = (value * result_factor(f"{measure}, {each}-sided", unit) for each in ("one", "two"))
    raise BadInput(
        f"{place}: unit_of_measure: say which noise density: '{measure}, one-sided' as on data sheets of vibratory "
        f"gyros ({value:g} is {one:.4g} {unit}), or '{measure}, two-sided' as in IEEE 952 and on data sheets of "
        f"fibre-optic gyros ({two:.4g} {unit})"
    )


def _is_per_rate(unit: str) -> bool:
    """Whether a unit is that of an output that is no rate, over a rate: count/(deg/s), V/(deg/s)."""
    for output in _OUTPUTS:
        with suppress(UnknownUnit):
            result_factor(f"({unit})*(deg/s)", output)
            return True
    return False


def _check_unit(limit: SpecificationLimit, unit: str, place: str) -> None:
    try:
        check_result_unit(limit.unit_of_measure)
    except UnknownUnit as error:
        raise BadInput(f"{place}: unit_of_measure: {error}") from error
    _check_side(limit, unit, place)
    # what a metric's header names may depend on the output, as "output/(deg/s)": then it is known with the value
    with suppress(UnknownUnit):
        check_result_unit(unit)
        try:
            result_factor(unit, limit.unit_of_measure)
        except UnknownUnit as error:
            if limit.metric in _OF_OUTPUT and _is_per_rate(limit.unit_of_measure):
                return
            raise BadInput(f"{place}: unit_of_measure: {error}; {limit.metric} is in {unit}") from error
