"""Scale-factor repeatability: all together, from run to run, from day to day, and its components of variance."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from analytics.methods.repeatability import (
    KINDS,
    Layout,
    ValuesNoise,
    deviations_of,
    means_noise,
    pooled,
    scatter,
    scatters,
)
from storage.sql.catalog import Catalog

# GJB asks for 6 measurements, JJF 2014 leaves Q open
_LEAST = {"GJB2426A": 6, "JJF2014": 2}


def compute(catalog: Catalog, sql: str) -> Iterator[dict[str, Any]]:
    """Rows of the metric: a row for each kind and standard.

    The kinds are those of the bias repeatability, of the relative scale factors K_i/mean(K). ``run_to_run`` is the
    deviation within a day, pooled over days; ``day_to_day`` that of the means of days. What the noise of the means at
    the rates adds is in the parameter ``uncertainty_of_means``, and subtracted in ``beyond_uncertainty`` and in the
    components. The misfit of the line is not in it: it is nonlinearity, which is the same in all. The upper bounds of
    components subtract nothing, since the least that the noise can be is not known.
    """
    rows = catalog.reader(sql).read_all().to_pylist()
    means = [sum(row["scales"]) / len(row["scales"]) if row["scales"] else None for row in rows]
    relative = [
        [each / mean * 1e6 for each in row["scales"]] if mean else [] for row, mean in zip(rows, means, strict=True)
    ]
    days = [day for row, scales in zip(rows, relative, strict=True) if scales for day in row["days"]]
    layout = Layout.of_names([len(scales) for scales in relative], days)
    found = scatter(np.array([each for scales in relative for each in scales], np.float64), layout)
    noise = _noise(rows, means, layout)
    is_dated = np.array([bool(row["is_dated"]) for row in rows], dtype=bool)
    of_kinds = {
        kind: deviations_of(found, kind, "scale factors", is_dated, noise if kind.endswith("component") else None)
        for kind in KINDS
    }
    parts = {kind: scatters(found, noise, kind) for kind in KINDS}
    for at, (row, mean) in enumerate(zip(rows, means, strict=True)):
        parameters = {"scale_factors": len(row["scales"] or []), "mean": mean}
        parameters["days"] = len(set(row["days"] or [])) if row["is_dated"] else None
        parameters["remark"] = row["remark"]
        for kind, (estimates, reasons) in of_kinds.items():
            reason = _lack(row, int(found.values[at]), kind) or reasons[at]
            value = {name: float(each[at]) for name, each in estimates._asdict().items()} if reason is None else {}
            shares = {name: float(each[at]) if np.isfinite(each[at]) else None for name, each in parts[kind].items()}
            named = {"kind": kind} | parameters | shares
            common = {"n": parameters["scale_factors"], "parameters": named, "reason": reason}
            yield row | common | value


def _noise(rows: Sequence[Mapping[str, Any]], means: Sequence[float | None], layout: Layout) -> ValuesNoise:
    """What the noise of the means at the rates adds to the scatter of relative scale factors, in ppm."""
    with_scales = [(row, mean) for row, mean in zip(rows, means, strict=True) if mean]
    uncertainties = np.array(
        [np.nan if u is None else abs(u / mean) * 1e6 for row, mean in with_scales for u in row["uncertainties"]]
    )
    freedoms = np.array([np.nan if of is None else of for row, _ in with_scales for of in row["freedoms"]], np.float64)
    likely = means_noise(pooled(uncertainties, freedoms, layout), freedoms, layout)
    return ValuesNoise(likely, means_noise(np.zeros(len(freedoms)), freedoms, layout))


def _lack(row: Mapping[str, Any], values: int, kind: str) -> str | None:
    """Why there is no value, but for what `deviations_of` finds."""
    least = _LEAST[row["standard"]]
    if row["scales"] and not values:
        return "the mean of the scale factors is 0: the output does not answer to the rate"
    if values < least:
        short = f"{values} scale factors measured, {least} or more are asked for"
        return short if row["lack"] is None else f"{short}; {row['lack']}"
    return _lack_of_repeats(row["days"] or [], kind, least, is_dated=row["is_dated"])


def _lack_of_repeats(days: Sequence[str], kind: str, least: int, *, is_dated: bool) -> str | None:
    """Why there are too few measurements of this kind: from day to day days count, from run to run those of one day."""
    if not is_dated or least <= 2:
        return None
    if kind == "day_to_day" and 1 < len(set(days)) < least:
        return f"scale factors of {len(set(days))} days, {least} or more are asked for"
    repeated = sum(1 for day in days if days.count(day) > 1)
    if kind == "run_to_run" and 0 < repeated < least:
        return f"{repeated} scale factors on days with more than one, {least} or more are asked for"
    return None
