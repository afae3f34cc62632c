"""The header of a metric: its names, unit, clauses, and where its confidence bounds come from."""

import re
from enum import StrEnum
from typing import NamedTuple

from stream.errors import GyrofleetError

_LINE = re.compile(r"--\s*([a-z]+):\s*(.*\S)\s*")
_SOURCE = re.compile(r"\s*(?P<standard>[A-Za-z]+ ?[0-9]+[A-Z]?|[A-Z]+)(?:-[0-9]{4})?\s+(?P<clause>.+?)\s*")


class MetricError(GyrofleetError):
    """The file of a metric is malformed."""


class BoundsSource(StrEnum):
    """Where the confidence bounds of a metric's values come from (header line `limits`)."""

    T = "t"
    """value +- t(freedom) * standard_uncertainty."""
    CHI_SQUARE = "chi_square"
    """A deviation whose square follows chi-square with `freedom`."""
    GIVEN = "given"
    """Columns lo and hi of the statement."""


class Clause(NamedTuple):
    """A clause of a standard, such as ``GJB2426A`` and ``5.12.1 (19)``."""

    standard: str
    clause: str


class MetricHeader(NamedTuple):
    """The header of a metric.

    Parameters
    ----------
    id: The field's standard term.
    en, zh: Names.
    unit: Unit of measure of the values.
    better: ``lower``, ``higher`` or ``neither``.
    grain: What one value belongs to, such as ``unit, signal, run``.
    parameters: Names of the values' parameters, which specification limits can select by.
    sources: Clauses.
    needs: What must have been measured.
    limits: Where the confidence bounds come from.
    equation: As in the clause.
    """

    id: str
    en: str
    zh: str
    unit: str
    better: str
    grain: str
    parameters: tuple[str, ...]
    sources: tuple[Clause, ...]
    needs: str
    limits: BoundsSource
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
    """Read the comment lines ``-- key: value`` at the head of a metric; `parameters` may take several lines.

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
    ('GJB2426A, JJF2014', Clause(standard='JJF2014', clause='7.2.13 (27)(28)'), ('earth_rate', 'position'))
    """
    lines: dict[str, str] = {}
    parameters: list[str] = []
    for line in text.splitlines():
        if not line.startswith("--"):
            break
        match = _LINE.fullmatch(line)
        if match is not None and match[1] == "parameters":
            parameters += [name.strip() for name in match[2].split(",")]
        elif match is not None:
            lines.setdefault(match[1], match[2])
    texts = ("id", "en", "zh", "unit", "better", "grain", "needs", "equation")
    if missing := [name for name in (*texts, "limits", "source") if name not in lines]:
        raise MetricError(f"metric {where}: its header lacks {', '.join(missing)}")
    if lines["better"] not in {"lower", "higher", "neither"} or lines["limits"] not in set(BoundsSource):
        raise MetricError(f"metric {where}: better is lower, higher or neither; limits are {', '.join(BoundsSource)}")
    return MetricHeader(
        **{name: lines[name] for name in texts},
        sources=tuple(_source(each, where) for each in lines["source"].split(";")),
        limits=BoundsSource(lines["limits"]),
        parameters=tuple(parameters),
    )


def _source(text: str, where: str) -> Clause:
    match = _SOURCE.fullmatch(text)
    if match is None:
        raise MetricError(f"metric {where}: source {text!r} is not like 'GJB 2426A-2004 5.12.1 (19)'")
    return Clause(match["standard"].replace(" ", ""), match["clause"])
