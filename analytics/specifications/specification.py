"""A product specification: limits of metrics under one revision, and from when until when they hold.

Not the limits of estimates (`analytics.curves.limits`), with which `gyrofleet demo` and `allan --limits` compare
curves.
"""

import math
import re
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from analytics.metric_registry.registry import alike, check_metrics, metrics
from analytics.specifications.dates import begin_ns, end_ns
from analytics.specifications.product import Product
from stream.errors import BadInput, UnknownUnit
from stream.quantities import check_result_unit, result_factor
from stream.toml_text import decode_toml

Parameter = float | int | str | bool

_NAME = re.compile(r"[^\W_][\w.+-]{0,63}")


class SpecificationLimit(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One `[[limit]]`.

    Parameters
    ----------
    metric: What is limited.
    unit_of_measure: Of the limits.
    lower, upper: Least and greatest value that is good.
    parameters: Which of the metric's values, such as ``{average_s = 100}``; those that are not named are all meant.
    product, signal, standard: Of which product, signal and standard; all where left out.
    """

    metric: str
    unit_of_measure: str
    lower: float | None = None
    upper: float | None = None
    parameters: dict[str, Parameter] = {}
    product: str | None = None
    signal: str | None = None
    standard: str | None = None

    @property
    def subject(self) -> str:
        """What is limited, in one line; two limits of one subject contradict or repeat each other."""
        asked = [f"{name} = {told_parameter(each)}" for name, each in sorted(self.parameters.items())]
        of = [each for each in (self.standard, self.signal, *asked) if each]
        return f"{self.metric} ({', '.join(of)})" if of else self.metric

    def meets(self, other: "SpecificationLimit") -> bool:
        """Whether a value could be of both."""
        return (
            self.metric == other.metric
            and self.parameters == other.parameters
            and all(
                mine is None or theirs is None or mine == theirs
                for mine, theirs in (
                    (self.product, other.product),
                    (self.signal, other.signal),
                    (self.standard, other.standard),
                )
            )
        )


class Specification(NamedTuple):
    """A file of limits and products.

    Parameters
    ----------
    name, revision: Together they name it; the revisions of one name follow each other.
    from_ns, until_ns: When it holds; without an end, until the next revision begins.
    products: Numbers of products.
    limits: In the file's order.
    """

    name: str
    revision: str
    from_ns: int | None
    until_ns: int | None
    products: Mapping[str, Product]
    limits: tuple[SpecificationLimit, ...]

    @property
    def label(self) -> str:
        """Its name and revision."""
        return f"{self.name}-{self.revision}"


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    revision: str
    name: str | None = None
    note: str = ""
    valid_from: Any = None
    valid_until: Any = None
    product: dict[str, Product] = {}
    limit: tuple[SpecificationLimit, ...] = ()


def parse_specification(content: bytes, source: str, *, is_checked: bool = False) -> Specification:
    r"""Read and check a specification.

    Parameters
    ----------
    content: The TOML.
    source: The file it comes from: for messages, and for its name where the file gives none.
    is_checked: Whether it was checked when it was entered: then metrics that this gyrofleet does not have are no error.

    Raises
    ------
    BadInput: If anything in it is not right: an unknown metric or standard, a unit of measure that does not fit, limits
        that repeat each other; the message names the file, the line and the key.

    Examples
    --------
    >>> found = parse_specification(b'''
    ... revision = "B"
    ... valid_from = 2026-01-01
    ... [[limit]]
    ... metric = "bias"
    ... lower = -1.0
    ... upper = 1.0
    ... unit_of_measure = "deg/h"
    ... ''', "fog-70.toml")
    >>> found.label, found.limits[0].subject
    ('fog-70-B', 'bias')
    """
    where = f"specification {source}"
    try:
        file = decode_toml(content, _File)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise BadInput(f"{where}: {error}") from error
    name = file.name or Path(source).stem.removesuffix(f"-{file.revision}")
    for key, text in (("name", name), ("revision", file.revision)):
        if _NAME.fullmatch(text) is None:
            raise BadInput(
                f"{where}: {key} {text!r} stands in a file's name: 1 to 64 letters, digits or . _ + -, as in 'B'"
            )
    found = Specification(
        name,
        file.revision,
        begin_ns(file.valid_from, f"{where}: valid_from"),
        end_ns(file.valid_until, f"{where}: valid_until"),
        file.product,
        file.limit,
    )
    if found.from_ns is not None and found.until_ns is not None and found.from_ns >= found.until_ns:
        raise BadInput(f"{where}: valid_until {file.valid_until} lies before valid_from {file.valid_from}")
    if not found.limits and not found.products:
        raise BadInput(f"{where}: it has neither a [[limit]] nor a [product.NAME]; see `gyrofleet limits --help`")
    if not is_checked:
        _check_limits(found, content, where)
    return found


def _check_limits(found: Specification, content: bytes, where: str) -> None:
    lines = [at for at, line in enumerate(content.decode().splitlines(), 1) if re.match(r"\s*\[\[\s*limit", line)]
    for at, limit in enumerate(found.limits):
        line = f"line {lines[at]}, " if at < len(lines) else ""
        place = f"{where}: {line}$.limit[{at}] ({limit.metric})"
        _check_limit(limit, found, place)
        if (first := next((i for i in range(at) if found.limits[i].meets(limit)), None)) is not None:
            raise BadInput(
                f"{place}: $.limit[{first}] limits the same; keep one, or tell them apart by their parameters"
            )


def told_parameter(value: Parameter) -> str:
    """A parameter as it is written.

    Examples
    --------
    >>> told_parameter(100), told_parameter(0.5), told_parameter("X"), told_parameter(True)
    ('100', '0.5', 'X', 'true')
    """
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else f"{value:g}"


def _check_limit(limit: SpecificationLimit, found: Specification, place: str) -> None:
    check_metrics([limit.metric], place)
    header = metrics()[limit.metric].header
    _check_unit(limit, header.unit, place)
    for name in limit.parameters:
        if name not in header.parameters:
            known = alike(name, header.parameters, "its parameters are")
            raise BadInput(f"{place}: no value of {limit.metric} has a parameter {name!r}; {known}")
    numbers = {"lower": limit.lower, "upper": limit.upper}
    if limit.lower is None and limit.upper is None:
        raise BadInput(f"{place}: it has neither lower nor upper")
    for key, number in numbers.items():
        if number is not None and not math.isfinite(number):
            raise BadInput(f"{place}: {key} is {number}; leave it out where there is no such limit")
    if limit.lower is not None and limit.upper is not None and limit.lower > limit.upper:
        raise BadInput(f"{place}: lower {limit.lower:g} lies above upper {limit.upper:g}")
    if limit.standard is not None:
        of_metric = list(dict.fromkeys(source.standard for source in header.sources))
        if limit.standard not in of_metric:
            raise BadInput(f"{place}: standard {limit.standard!r} is not one of the metric's: {', '.join(of_metric)}")
    if limit.product is not None and found.products and limit.product not in found.products:
        raise BadInput(
            f"{place}: product {limit.product!r} has no [product.NAME] in this file; "
            f"{alike(limit.product, found.products, 'those that have are')}"
        )


def _check_unit(limit: SpecificationLimit, unit: str, place: str) -> None:
    try:
        check_result_unit(limit.unit_of_measure)
    except UnknownUnit as error:
        raise BadInput(f"{place}: unit_of_measure: {error}") from error
    # what a metric's header names may depend on the output, as "output/(deg/s)": then it is known with the value
    with suppress(UnknownUnit):
        check_result_unit(unit)
        try:
            result_factor(unit, limit.unit_of_measure)
        except UnknownUnit as error:
            raise BadInput(f"{place}: unit_of_measure: {error}; {limit.metric} is in {unit}") from error
