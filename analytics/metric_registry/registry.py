"""The registry of metrics: each SQL file in `analytics/metrics` is one, found automatically by its header."""

import json
import re
from collections.abc import Collection, Iterable, Mapping
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from ingest.measurement_standards import QUANTITIES
from stream.errors import BadInput, GyrofleetError
from stream.files.own_files import files_of, is_own
from stream.mistakes import similar_names

_PACKAGE = "analytics.metrics"
_LINE = re.compile(r"--\s*([a-z]+):\s*(.*\S)\s*")
_SOURCE = re.compile(r"\s*(?P<standard>[A-Za-z]+ ?[0-9]+[A-Z]?|[A-Z]+)(?:-(?P<year>[0-9]{4}))?\s+(?P<clause>.+?)\s*")

# which values are the better: `nearer_zero` are those with a sign whose magnitude counts
BETTER = ("lower", "higher", "nearer_zero", "neither")


class MetricError(GyrofleetError):
    """The file of a metric is malformed."""


class BoundsSource(StrEnum):
    """Where the confidence bounds of a metric's values come from (header line `limits`)."""

    T = "t"  # value +- t(freedom) * standard_uncertainty
    CHI_SQUARE = "chi_square"  # a deviation whose square follows chi-square with `freedom`
    GIVEN = "given"  # columns lo and hi of the statement


class Clause(NamedTuple):
    """A clause of a standard, such as ``GJB2426A`` and ``5.12.1 (19)``."""

    standard: str
    clause: str
    year: str = ""  # of the edition, where the standard has one


class Influence(NamedTuple):
    """How an error of the station's measurement standards enters a metric (header line `influence`).

    `sensitivity` is an SQL expression of the columns of the metric's rows and of `latitude_deg`, `output_unit` and
    `volt` (the output's unit in V, null if it is no voltage): unit of the value per unit of the quantity; 0 where it
    does not enter, null where that cannot be known.
    """

    quantity: str  # as in the station's file
    sensitivity: str


class MetricHeader(NamedTuple):
    """The header of a metric."""

    id: str  # the field's standard term
    en: str
    zh: str
    unit: str  # unit of measure of the values
    better: str  # one of `BETTER`
    grain: str  # what one value belongs to, such as ``unit, signal, run``
    parameters: tuple[str, ...]  # names of the values' parameters, which specification limits can select by
    sources: tuple[Clause, ...]  # clauses
    needs: str  # what must have been measured
    limits: BoundsSource  # where the confidence bounds come from
    equation: str  # as in the clause
    # `module:function` that makes the rows where SQL cannot say all of it; it takes the catalogue and the statement
    python: str = ""
    influences: tuple[Influence, ...] = ()  # uncertainty of type B
    no_influence: str = ""  # why there is none
    of: str = ""  # what its statement reads, as a table with a condition: without rows there, it is not run

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

    >>> header = parse_header(metrics()["bias"].sql, "bias.sql")
    >>> header.standard, header.sources[1], header.parameters[:1]
    ('GJB2426A, JJF2014', Clause(standard='JJF2014', clause='7.2.13 (27)(28)', year='2022'), ('earth_rate',))
    """
    lines: dict[str, str] = {}
    parameters: list[str] = []
    influences: list[str] = []
    for line in text.splitlines():
        if not line.startswith("--"):
            break
        match = _LINE.fullmatch(line)
        if match is not None and match[1] == "parameters":
            parameters += [name.strip() for name in match[2].split(",")]
        elif match is not None and match[1] == "influence":
            influences.append(match[2])
        elif match is not None:
            lines.setdefault(match[1], match[2])
    texts = ("id", "en", "zh", "unit", "better", "grain", "needs", "equation")
    if missing := [name for name in (*texts, "limits", "source") if name not in lines]:
        raise MetricError(f"metric {where}: its header lacks {', '.join(missing)}")
    if lines["better"] not in BETTER or lines["limits"] not in set(BoundsSource):
        raise MetricError(f"metric {where}: better is {', '.join(BETTER)}; limits are {', '.join(BoundsSource)}")
    sources = []
    for each in lines["source"].split(";"):
        if (match := _SOURCE.fullmatch(each)) is None:
            raise MetricError(
                f"metric {where}: source {each!r} is not like 'GJB 2426A-2004 5.12.1 (19)', or for a document "
                "of your own house 'ACME QP-07 4.2'"
            )
        sources.append(Clause(match["standard"].replace(" ", ""), match["clause"], match["year"] or ""))
    found, none = _influences(influences, where)
    return MetricHeader(
        **{name: lines[name] for name in texts},
        python=lines.get("python", ""),
        of=lines.get("of", ""),
        influences=found,
        no_influence=none,
        sources=tuple(sources),
        limits=BoundsSource(lines["limits"]),
        parameters=tuple(parameters),
    )


def _influences(lines: Iterable[str], where: str) -> tuple[tuple[Influence, ...], str]:
    """The influences of a header, or why there is none: ``none: REASON``."""
    found = []
    for line in lines:
        quantity, _, sensitivity = line.partition(": ")
        if quantity == "none":
            return (), sensitivity
        if quantity not in QUANTITIES:
            raise MetricError(f"metric {where}: influence {quantity!r}; {alike(quantity, QUANTITIES, 'known are')}")
        found.append(Influence(quantity, sensitivity))
    return tuple(found), ""


class Metric(NamedTuple):
    """A metric: an SQL statement over the step records, and the Python function that its header may name.

    Either gives rows with ``unit, signal, run, value, standard_uncertainty, freedom, n, parameters, runs, steps,
    reason``; with given bounds also ``lo, hi``; where two standards differ also ``standard, clause``. `value` is null
    exactly where `reason` says why. A function may omit `runs` (the run), and its rows may have further keys.
    """

    header: MetricHeader
    sql: str
    own_file: str = ""  # of a metric of the site's own; see `GYROFLEET_OWN`

    @property
    def place(self) -> str:
        """The file of its definition, for messages."""
        return self.own_file or f"analytics/metrics/{self.header.id}.sql"


@cache
def metrics() -> Mapping[str, Metric]:
    """All metrics by id, in alphabetical order.

    Raises MetricError if a file of the program is malformed; such files of the site's own are in `unreadable_metrics`.

    >>> metrics()["bias"].header.unit
    'deg/h'
    """
    found, _ = _registered()
    return found


def unreadable_metrics() -> Mapping[str, str]:
    """What is wrong with files of the site's own metrics whose header is malformed, by file.

    >>> unreadable_metrics()  # without GYROFLEET_OWN
    {}
    """
    _, wrong = _registered()
    return wrong


@cache
def _registered() -> tuple[Mapping[str, Metric], Mapping[str, str]]:
    found: dict[str, Metric] = {}
    wrong: dict[str, str] = {}
    for file in files_of(_PACKAGE):
        if file.suffix != ".sql":
            continue
        own_file = str(file) if is_own(_PACKAGE, file) else ""
        try:
            metric = _read(file, own_file)
        except (MetricError, UnicodeDecodeError, OSError) as error:
            if not own_file:
                raise
            wrong[own_file] = str(error)
        else:
            found[metric.header.id] = metric
    return dict(sorted(found.items())), wrong


def _read(file: Path, own_file: str) -> Metric:
    text = file.read_text(encoding="utf-8")
    header = parse_header(text, own_file or file.name)
    if file.name != f"{header.id}.sql":
        raise MetricError(f"metric {own_file or file.name}: its header calls it {header.id}")
    return Metric(header, text, own_file)


def parameters_text(parameters: Mapping[str, Any]) -> str:
    """Parameters as the JSON text of their column.

    >>> parameters_text({"kind": "all", "power_ons": 6})
    '{"kind":"all","power_ons":6}'
    """
    return json.dumps(parameters, ensure_ascii=False, separators=(",", ":"))


def check_metrics(names: Iterable[str], where: str = "") -> None:
    """Refuse names of unknown metrics.

    Raises BadInput the message names similar metrics.

    >>> check_metrics(["biass"], "spec.toml: $.limit[0]")
    Traceback (most recent call last):
    stream.errors.BadInput: spec.toml: $.limit[0]: there is no metric 'biass'; did you mean bias?
    """
    for name in names:
        if name not in metrics():
            place = f"{where}: " if where else ""
            for file, error in unreadable_metrics().items():
                if Path(file).stem == name:
                    raise BadInput(f"{place}metric {name!r} cannot be read: {error}")
            raise BadInput(f"{place}there is no metric {name!r}; {alike(name, metrics(), 'metrics are')}")


def alike(name: str, known: Collection[str], else_: str) -> str:
    """Suggest a similar name; where there is none, list some known ones after the words `else_`.

    >>> alike("FOG-O231", ["FOG-0230", "FOG-0231"], "there are")
    'did you mean FOG-0231?'
    """
    if near := similar_names(name, known):
        return f"did you mean {near[0]}?"
    names = sorted(known)
    return f"{else_} {', '.join(names[:20])}{', ...' if len(names) > 20 else ''}" if names else "there is none"
