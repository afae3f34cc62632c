"""Scale-factor repeatability: all together, from run to run, from day to day, and its components of variance."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from analytics.methods.repeatability import KINDS, Scatter, deviation_of, scatter
from storage.sql.catalog import Catalog

# GJB asks for 6 measurements, JJF 2014 leaves Q open
_LEAST = {"GJB2426A": 6, "JJF2014": 2}


def compute(catalog: Catalog, sql: str) -> Iterator[dict[str, Any]]:
    """Rows of the metric: a row for each kind and standard.

    The kinds are those of the bias repeatability, of the relative scale factors K_i/mean(K). ``run_to_run`` is the
    deviation within a day, pooled over days; ``day_to_day`` that of the means of days. The uncertainty of the K_i is
    not subtracted: most of it is nonlinearity, which is the same in all.
    """
    for row in catalog.reader(sql).read_all().to_pylist():
        scales, days = row["scales"] or [], row["days"] or []
        mean = sum(scales) / len(scales) if scales else 1.0
        found = scatter([each / mean * 1e6 for each in scales] if mean else [], days if mean else [])
        parameters = {"scale_factors": len(scales), "mean": mean if scales else None}
        parameters["days"] = len(set(days)) if row["is_dated"] else None
        for kind in KINDS:
            yield row | {"n": len(scales), "parameters": {"kind": kind} | parameters} | _value(row, found, kind)


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


def _value(row: Mapping[str, Any], found: Scatter, kind: str) -> dict[str, Any]:
    """Value with its limits, or the reason why there is none."""
    least = _LEAST[row["standard"]]
    if row["scales"] and not found.values:
        return {"reason": "the mean of the scale factors is 0: the output does not answer to the rate"}
    if found.values < least:
        short = f"{found.values} scale factors measured, {least} or more are asked for"
        return {"reason": short if row["lack"] is None else f"{short}; {row['lack']}"}
    if (lack := _lack_of_repeats(row["days"] or [], kind, least, is_dated=row["is_dated"])) is not None:
        return {"reason": lack}
    return deviation_of(found, kind, "scale factors", is_dated=row["is_dated"])
