"""Bias repeatability over power-ons: all together, from run to run, from day to day, and its components of variance."""

import json
import math
from collections.abc import Iterator, Sequence

import numpy as np
import pyarrow as pa

from analytics.methods.repeatability import (
    KINDS,
    DeviationEstimate,
    Layout,
    Reasons,
    Scatter,
    ValuesNoise,
    are_none,
    deviations_of,
    means_noise,
    pooled,
    scatter,
    scatters,
)  # fmt: skip
from analytics.metric_registry.registry import parameters_text
from storage.sql.catalog import Catalog
from stream.batch import FloatArray, IntArray

LEAST_GJB = 6
LEAST_S = 3590.0
_LIKE = 1.1
_OF_TEST = ("unit", "signal", "run", "runs", "steps")


def compute(catalog: Catalog, sql: str) -> pa.Table:
    """Rows of the metric.

    The deviations are those of the clauses' equations, in which the uncertainty of the biases scatters as well: in
    records of a minute noise is most of it, in those of an hour hardly any. In the parameters ``uncertainty_of_means``
    is that part, and ``beyond_uncertainty`` what is left with it subtracted in squares.

    ``run_to_run`` is the deviation within a day, pooled over days; ``day_to_day`` that of the means of days, in which
    the scatter within the days is also. ``between_day_component`` is what is left of it without that;
    ``within_day_component`` is the run-to-run deviation without the uncertainty of the biases. ``all``, the deviation
    of all power-ons, has a value where these are of one day, or each of another: power-ons of one day share its effect,
    and among several days they are not independent. A day is one of the station's time zone. GJB 2426A asks for 6
    power-ons (days), JJF 2014 names no number.
    """
    tests = catalog.table(sql).combine_chunks()
    layout = Layout.of_names(
        tests["biases"].combine_chunks().value_lengths().to_numpy(), _values(tests, "days").to_pylist()
    )
    found = scatter(_numbers(tests, "biases"), layout)
    noise = _noise(tests, layout)
    is_dated = tests["is_dated"].to_numpy()
    lacks = np.array(tests["lack"].to_pylist(), dtype=object)
    few = np.full(layout.tests, None, dtype=object)
    few[found.values < 2] = f"1 power-on measured, at least 2 are needed, {LEAST_GJB} by GJB 2426A"
    repeated = layout.total((layout.group_total() > 1).astype(np.float64)[layout.group])
    compared = {"run_to_run": repeated, "within_day_component": repeated, "all": found.values}
    shared = _shared_parameters(tests, layout, found)
    rows = []
    for kind in KINDS:
        is_component = kind.endswith("component")
        estimate, reasons = deviations_of(found, kind, "power-ons", is_dated, noise if is_component else None)
        for earlier in (few, lacks):
            reasons = np.where(are_none(earlier), reasons, earlier)
        n = np.where(are_none(lacks), compared.get(kind, found.groups), found.values).astype(np.int64)
        parts = scatters(found, noise, kind)
        texts = _texts(kind, shared, [np.where(are_none(lacks), each, np.nan) for each in parts.values()])
        rows += list(_standards(kind, n, estimate, reasons, texts))
    table = pa.concat_tables(rows)
    # the kinds of a test one after the other
    table = table.take(pa.array(np.argsort(table["test"].to_numpy(), kind="stable")))
    own = tests.select(_OF_TEST).take(table["test"])
    return pa.table(
        {**{name: own[name] for name in _OF_TEST}, **{name: table[name] for name in table.column_names[1:]}}
    )


def _values(tests: pa.Table, name: str) -> pa.Array:
    """The values of a column of lists, test after test."""
    return tests[name].combine_chunks().flatten()


def _numbers(tests: pa.Table, name: str) -> FloatArray:
    return np.asarray(_values(tests, name).to_numpy(zero_copy_only=False), np.float64)


def _noise(tests: pa.Table, layout: Layout) -> ValuesNoise:
    """What the records' own noise adds to their scatter; records of one length count as equivalent."""
    uncertainties, freedoms, durations = (_numbers(tests, name) for name in ("uncertainties", "freedoms", "durations"))
    shortest, longest = np.full(layout.tests, np.inf), np.full(layout.tests, -np.inf)
    np.minimum.at(shortest, layout.of, durations)
    np.maximum.at(longest, layout.of, durations)
    alike = longest <= _LIKE * shortest
    likely = np.where(alike[layout.of], pooled(uncertainties, freedoms, layout), uncertainties)
    white = _numbers(tests, "of_white_noise")
    return ValuesNoise(means_noise(likely, freedoms, layout), means_noise(white, freedoms, layout))


def _shared_parameters(tests: pa.Table, layout: Layout, found: Scatter) -> list[str]:
    """The parameters that all kinds of a test have in common, as JSON without its braces."""
    durations, counted_by = _numbers(tests, "durations"), _values(tests, "counted_by").to_pylist()
    is_recorded = np.array([each == "power-on" for each in counted_by], dtype=bool)
    recorded = layout.total(is_recorded.astype(np.float64))
    odd = (layout.total((durations < LEAST_S).astype(np.float64)) > 0) | (recorded < found.values)
    ends = np.cumsum(found.values).astype(np.int64)
    texts = []
    for at, (position, earth_rate, is_dated, stations) in enumerate(
        zip(*(tests[name].to_pylist() for name in ("position", "earth_rate", "is_dated", "stations")), strict=True)
    ):
        own = slice(int(ends[at] - found.values[at]), int(ends[at]))
        parameters = {
            "position": position, "earth_rate": earth_rate, "power_ons": int(found.values[at]),
            "power_ons_recorded": int(recorded[at]), "days": int(found.groups[at]) if is_dated else None,
            "remark": _remark(durations[own].tolist(), counted_by[own], stations) if odd[at] or stations else None,
        }  # fmt: skip
        texts.append(parameters_text(parameters)[1:-1])
    return texts


def _remark(durations: Sequence[float], counted_by: Sequence[str], stations: str | None) -> str | None:
    """Remark on several stations, on short records and on power-ons that were not recorded."""
    remarks = [] if stations is None else [stations]
    if short := [each for each in durations if each < LEAST_S]:
        lengths = " to ".join(dict.fromkeys(f"{each:.0f}" for each in (min(short), max(short))))
        some = f"{len(short)} of {len(durations)} records are of {lengths} s"
        remarks.append(f"{some}: the clauses ask for an hour as a rule")
    if assumed := [each for each in counted_by if each != "power-on"]:
        kinds = " or ".join(sorted(set(assumed)))
        counted = "1 power-on is" if len(assumed) == 1 else f"{len(assumed)} power-ons are"
        remarks.append(f"{counted} not recorded: each {kinds} is taken for one")
    return "; ".join(remarks) or None


def _texts(kind: str, shared: Sequence[str], parts: Sequence[FloatArray]) -> list[str]:
    """The parameters of each test as JSON."""
    noise_of, beyond_it = (
        json.dumps([None if math.isnan(each) else each for each in part.tolist()])[1:-1].split(", ") for part in parts
    )
    return [
        f'{{"kind":"{kind}",{own},"uncertainty_of_means":{of_means},"beyond_uncertainty":{beyond}}}'
        for own, of_means, beyond in zip(shared, noise_of, beyond_it, strict=bool(shared))
    ]


def _standards(
    kind: str, n: IntArray, value: DeviationEstimate, reasons: Reasons, texts: Sequence[str]
) -> Iterator[pa.Table]:
    """The rows, and two, one for each standard, where the number of power-ons satisfies only one of them."""
    has_value = are_none(reasons)
    is_few = has_value & (n < LEAST_GJB) & ("component" not in kind)
    what = "days" if kind == "day_to_day" else "power-ons"
    short = np.array(
        [f"{each} {what} measured, the clause asks for {LEAST_GJB} or more" for each in n.tolist()], object
    )
    for rows, why, clause in (
        (np.flatnonzero(~is_few), reasons, (None, None)),
        (np.flatnonzero(is_few), short, ("GJB2426A", "5.12.3 (21)")),
        (np.flatnonzero(is_few), reasons, ("JJF2014", "7.2.15 (30)")),
    ):
        of_rows = why[rows]
        lacks = ~are_none(of_rows)
        columns = {"test": pa.array(rows), "n": pa.array(n[rows])}
        columns["parameters"] = pa.array([texts[at] for at in rows.tolist()], pa.string())
        columns |= {name: pa.array(each[rows], mask=lacks) for name, each in value._asdict().items()}
        columns["reason"] = pa.array(of_rows, pa.string())
        columns |= {
            name: pa.repeat(pa.scalar(text, pa.string()), len(rows))
            for name, text in zip(("standard", "clause"), clause, strict=True)
        }
        yield pa.table(columns)
