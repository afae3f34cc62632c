"""A product specification: limits on metrics and numbers of products under one revision, as TOML."""

import math
import re
from collections.abc import Mapping
from datetime import UTC, date, datetime, timedelta
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec

from storage.specifications.screening_file import converted_limits
from stream.decoding import converted
from stream.errors import BadInput
from stream.files.toml_text import decode_toml

Parameter = float | int | str | bool
Positive = Annotated[float, msgspec.Meta(gt=0)]

_NAME = re.compile(r"[^\W_][\w.+-]{0,63}")
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_DAY = timedelta(days=1)


class Product(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One product of a specification, `[product."FOG-70"]`.

    `scale_factor` is nominal, in `scale_factor_unit` (of the output) per deg/s; `max_rate_deg_per_s` is the largest
    input rate, `nonlinearity_ppm` the limit of the scale factor's nonlinearity, which bounds the input range.
    `startup_band_deg_per_h` is the error band of the output that ends the start-up, `expected_threshold_deg_per_h` the
    threshold from which the rates of the resolution test follow, `average_s` the averaging time of the product's bias
    stability besides 1, 10 and 100 s.
    """

    scale_factor: float | None = None
    scale_factor_unit: str = "deg/s"
    max_rate_deg_per_s: Positive | None = None
    nonlinearity_ppm: Positive | None = None
    startup_band_deg_per_h: Positive | None = None
    expected_threshold_deg_per_h: Positive | None = None
    average_s: Annotated[float, msgspec.Meta(ge=1e-3)] | None = None

    def __post_init__(self) -> None:
        numbers = {name: each for name, each in msgspec.structs.asdict(self).items() if isinstance(each, float)}
        for name, each in numbers.items():
            if not math.isfinite(each) or each == 0:
                raise ValueError(f"{name} is {each:g}, expected a finite number other than 0; leave it out if unknown")


class DecisionRule(StrEnum):
    """How a value is compared with a limit (JCGM 106:2012 clause 8)."""

    INTERVAL = "interval"  # PASS or FAIL where the 95 % interval lies on one side, else MARGINAL
    SIMPLE_ACCEPTANCE = "simple_acceptance"  # by the value alone (8.2.1)
    SHARED_RISK = "shared_risk"  # the same, where U is at most `largest_U` (8.2.2)
    GUARDED_ACCEPTANCE = "guarded_acceptance"  # PASS only beyond a guard band guard_factor * U inside the limit (8.3.2)
    GUARDED_REJECTION = "guarded_rejection"  # FAIL only beyond a guard band outside the limit (8.3.3)


class SpecificationLimit(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One `[[limit]]`: `lower` and `upper` are the least and greatest value of `metric` that pass.

    `parameters` select among the metric's values, such as ``{average_s = 100}``; omitted parameters match all values.
    So do product, signal and standard where they are left out. `decision_rule` says how U counts; the guard band is
    `guard_factor` times U, and `largest_U` the U up to which risks are shared, in `unit_of_measure`. A value from a
    record shorter than `record_s` does not pass.
    """

    metric: str
    unit_of_measure: str
    lower: float | None = None
    upper: float | None = None
    parameters: dict[str, Parameter] = {}
    product: str | None = None
    signal: str | None = None
    standard: str | None = None
    decision_rule: DecisionRule = DecisionRule.INTERVAL
    guard_factor: Annotated[float, msgspec.Meta(ge=0, le=10)] | None = None
    largest_U: Positive | None = None  # noqa: N815  U as in JCGM 100
    record_s: Positive | None = None

    def __post_init__(self) -> None:
        is_guarded = self.decision_rule in {DecisionRule.GUARDED_ACCEPTANCE, DecisionRule.GUARDED_REJECTION}
        if self.guard_factor is not None and not is_guarded:
            raise ValueError("guard_factor is of guarded_acceptance and guarded_rejection; give that decision_rule")
        if (self.largest_U is not None) != (self.decision_rule is DecisionRule.SHARED_RISK):
            raise ValueError("largest_U and decision_rule = 'shared_risk' need each other")

    @property
    def subject(self) -> str:
        """What is limited, in one line; two limits of one subject contradict or repeat each other."""
        asked = [f"{name} = {format_parameter(each)}" for name, each in sorted(self.parameters.items())]
        of = [each for each in (self.standard, self.signal, *asked) if each]
        return f"{self.metric} ({', '.join(of)})" if of else self.metric

    def meets(self, other: "SpecificationLimit") -> bool:
        """Whether one value could be subject to both limits."""
        return (self.metric, self.parameters) == (other.metric, other.parameters) and all(
            None in pair or pair[0] == pair[1]
            for pair in ((self.product, other.product), (self.signal, other.signal), (self.standard, other.standard))
        )


class Specification(NamedTuple):
    """A revision, valid until its end or the next revision begins; `limits` are in the file's order."""

    name: str
    revision: str
    from_ns: int | None
    until_ns: int | None
    products: Mapping[str, Product]
    limits: tuple[SpecificationLimit, ...]

    @property
    def label(self) -> str:
        """Name and revision."""
        return f"{self.name}-{self.revision}"


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    revision: str
    name: str | None = None
    note: str = ""
    valid_from: Any = None
    valid_until: Any = None
    product: dict[str, Product] = {}
    limit: tuple[SpecificationLimit, ...] = ()


def read_specification(path: Path) -> bytes:
    """Content of a specification file; BadInput if it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise BadInput(f"specification {path}: cannot be read ({error.strerror or error})") from error


def parse_specification(content: str | bytes, source: str) -> Specification:
    r"""Read a specification; whether its metrics exist and its units fit is not checked.

    A file of screening limits (`storage.specifications.screening_file`) is converted. `source` is the file, for
    messages and for the name of a specification that gives none. Raises a BadInput that names the file and the key.

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
        screening = converted_limits(content, where)
        if screening is not None:
            revision, entries = screening
            limits = converted(entries, tuple[SpecificationLimit, ...])
            return Specification(Path(source).stem, revision, None, None, {}, limits)
        file = decode_toml(content, _File)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise BadInput(f"{where}: {error}") from error
    found = Specification(
        file.name or Path(source).stem.removesuffix(f"-{file.revision}"), file.revision,
        _moment_ns(file.valid_from, f"{where}: valid_from"),
        _moment_ns(file.valid_until, f"{where}: valid_until", is_end=True), file.product, file.limit,
    )  # fmt: skip
    check_names(found, where)
    if found.from_ns is not None and found.until_ns is not None and found.from_ns >= found.until_ns:
        raise BadInput(f"{where}: valid_until {file.valid_until} lies before valid_from {file.valid_from}")
    if not found.limits and not found.products:
        raise BadInput(f"{where}: it has neither a [[limit]] nor a [product.NAME]; see `gyrofleet limits --help`")
    return found


def check_names(specification: Specification, where: str) -> None:
    """Raise BadInput where name or revision cannot be part of a file's name."""
    for key, text in (("name", specification.name), ("revision", specification.revision)):
        if _NAME.fullmatch(text) is None:
            raise BadInput(
                f"{where}: {key} {text!r} stands in a file's name: 1 to 64 letters, digits or . _ + -, as in 'B'"
            )


def format_parameter(value: object) -> str:
    """A parameter as text.

    >>> format_parameter(100), format_parameter(0.5), format_parameter("X"), format_parameter(True)
    ('100', '0.5', 'X', 'true')
    """
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, int | float) else str(value)


def _moment_ns(value: object, where: str, *, is_end: bool = False) -> int | None:
    """First moment of a date, or with `is_end` the moment after it; a moment with a time zone; ns UTC.

    >>> _moment_ns(date(1970, 1, 2), "valid_from"), _moment_ns(date(1970, 1, 1), "valid_until", is_end=True)
    (86400000000000, 86400000000000)
    """
    if value is None:
        return None
    if isinstance(value, datetime):
        if value.tzinfo is None:
            raise BadInput(f"{where}: {value.isoformat()} has no time zone; add one, or give the date alone")
        since = value - _EPOCH
    elif isinstance(value, date):
        since = datetime(value.year, value.month, value.day, tzinfo=UTC) - _EPOCH + (_DAY if is_end else timedelta())
    else:
        raise BadInput(f"{where}: {value!r} is no date; write it as 2026-01-01, without quotes (it counts in UTC)")
    return (since.days * 86_400 + since.seconds) * 10**9 + since.microseconds * 1000
