"""The header of a metric: what it is called, in which unit, by which clause, and how its limits are had."""

import re
from enum import StrEnum
from typing import NamedTuple

from stream.errors import GyrofleetError

_LINE = re.compile(r"--\s*([a-z]+):\s*(.*\S)\s*")
_SOURCE = re.compile(r"\s*(?P<standard>[A-Za-z]+ ?[0-9]+[A-Z]?|[A-Z]+)(?:-[0-9]{4})?\s+(?P<clause>.+?)\s*")


class MetricError(GyrofleetError):
    """A metric is not written as one must be."""


class Limits(StrEnum):
    """Where the limits of a metric's values come from."""

    T = "t"
    """value +- t(freedom) * standard_uncertainty."""
    CHI_SQUARE = "chi_square"
    """A deviation whose square follows chi-square with `freedom`."""
    GIVEN = "given"
    """Columns lo and hi of the statement."""


class Source(NamedTuple):
    """A clause of a standard, such as ``GJB2426A`` and ``5.12.1 (19)``."""

    standard: str
    clause: str


class MetricHeader(NamedTuple):
    """What is known of a metric before it is computed.

    Parameters
    ----------
    id: The field's standard term.
    en, zh: Its name.
    unit: Unit of measure of its values.
    better: ``lower``, ``higher`` or ``neither``.
    grain: What one value is of, such as ``unit, signal, run``.
    parameters: Names in the values' parameters, by which limits tell values apart; may be written in several lines.
    sources: Clauses.
    needs: What must have been measured.
    limits: Where its limits come from.
    equation: In words of the clause.
    """

    id: str
    en: str
    zh: str
    unit: str
    better: str
    grain: str
    parameters: tuple[str, ...]
    sources: tuple[Source, ...]
    needs: str
    limits: Limits
    equation: str

    @property
    def standard(self) -> str:
        """Its standards, such as ``GJB2426A, JJF2014``."""
        return ", ".join(dict.fromkeys(each.standard for each in self.sources))

    @property
    def clause(self) -> str:
        """Its clauses, in the order of the standards."""
        return "; ".join(each.clause for each in self.sources)


def parse_header(text: str, where: str) -> MetricHeader:
    """Read the comment lines ``-- key: value`` at the head of a metric.

    Raises
    ------
    MetricError: If a line is missing or says what cannot be.

    Examples
    --------
    >>> header = parse_header('''-- id: bias
    ... -- en: Bias
    ... -- zh: 零偏
    ... -- unit: deg/h
    ... -- better: neither
    ... -- grain: unit, signal, run
    ... -- parameters: earth_rate, position
    ... -- source: GJB 2426A-2004 5.12.1 (19); JJF 2014-2022 7.2.13 (27)(28)
    ... -- needs: a static step
    ... -- limits: t
    ... -- equation: B0 = mean(F)/K
    ... select 1''', "bias.sql")
    >>> header.standard, header.sources[1], header.parameters
    ('GJB2426A, JJF2014', Source(standard='JJF2014', clause='7.2.13 (27)(28)'), ('earth_rate', 'position'))
    """
    said: dict[str, str] = {}
    parameters: list[str] = []
    for line in text.splitlines():
        if not line.startswith("--"):
            break
        match = _LINE.fullmatch(line)
        if match is not None and match[1] == "parameters":
            parameters += [name.strip() for name in match[2].split(",")]
        elif match is not None:
            said.setdefault(match[1], match[2])
    missing = [name for name in MetricHeader._fields if name not in said and name not in {"sources", "parameters"}]
    if missing or "source" not in said:
        raise MetricError(f"metric {where}: its header lacks {', '.join(missing or ['source'])}")
    if said["better"] not in {"lower", "higher", "neither"} or said["limits"] not in set(Limits):
        raise MetricError(f"metric {where}: better is lower, higher or neither; limits are {', '.join(Limits)}")
    return MetricHeader(
        **{name: said[name] for name in ("id", "en", "zh", "unit", "better", "grain", "needs", "equation")},
        sources=tuple(_source(each, where) for each in said["source"].split(";")),
        limits=Limits(said["limits"]),
        parameters=tuple(parameters),
    )


def _source(text: str, where: str) -> Source:
    match = _SOURCE.fullmatch(text)
    if match is None:
        raise MetricError(f"metric {where}: source {text!r} is not like 'GJB 2426A-2004 5.12.1 (19)'")
    return Source(match["standard"].replace(" ", ""), match["clause"])
