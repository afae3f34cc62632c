"""Bias repeatability over power-ons: all together, from run to run, from day to day, and its components of variance."""

from collections.abc import Iterator, Mapping
from typing import Any

from analytics.methods.repeatability import KINDS, ValuesNoise, deviation_of, means_noise, pooled, scatter, scatters
from storage.sql.catalog import Catalog

LEAST_GJB = 6
LEAST_S = 3590.0
_LIKE = 1.1
_NOT_KNOWN: Mapping[str, float | None] = {"scatter": None, "uncertainty_of_means": None}


def compute(catalog: Catalog, sql: str) -> Iterator[dict[str, Any]]:
    """Rows of the metric.

    The uncertainty of the biases, a component of the variance of their scatter, is subtracted; in the parameters
    ``scatter`` is that of the clause's equation, ``uncertainty_of_means`` the part subtracted. In records of a minute
    noise is most of the scatter, in those of an hour hardly any of it.

    ``run_to_run`` is the deviation within a day, pooled over days; ``day_to_day`` that of the means of days, in which
    the scatter within the days is also. ``between_day_component`` is what is left of it without that, and
    ``within_day_component`` is the run-to-run deviation again, as the other part of the analysis of variance. ``all``,
    the deviation of all power-ons, has a value where these are of one day, or each of another: power-ons of one day
    share its effect, and among several days they are not independent. A day is one of the station's time zone. GJB
    2426A asks for 6 power-ons (days), JJF 2014 names no number.
    """
    for row in catalog.table(sql).to_pylist():
        if row["lack"] is not None:
            for kind in KINDS:
                yield from _standards(row, kind, len(row["biases"]), {"reason": row["lack"]})
            continue
        found = scatter(row["biases"], row["days"])
        noise = _noise(row)
        repeated = sum(1 for day in row["days"] if row["days"].count(day) > 1)
        compared = {"run_to_run": repeated, "within_day_component": repeated, "all": found.values}
        for kind in KINDS:
            n = compared.get(kind, found.groups)
            value: dict[str, Any] = {"reason": f"1 power-on measured, at least 2 are needed, {LEAST_GJB} by GJB 2426A"}
            if found.values > 1:
                value = deviation_of(found, kind, "power-ons", noise, is_dated=row["is_dated"])
            yield from _standards(row, kind, n, value, scatters(found, noise, kind))


def _noise(row: Mapping[str, Any]) -> ValuesNoise:
    """What the records' own noise adds to their scatter; records of one length count as equivalent."""
    uncertainties, freedoms, durations = row["uncertainties"], row["freedoms"], row["durations"]
    if max(durations) <= _LIKE * min(durations):
        uncertainties = pooled(uncertainties, freedoms)
    days = row["days"]
    return ValuesNoise(means_noise(uncertainties, freedoms, days), means_noise(row["of_white_noise"], freedoms, days))


def _remark(row: Mapping[str, Any]) -> str | None:
    """Remark on short records and on power-ons that were not recorded."""
    remarks = []
    if short := [each for each in row["durations"] if each < LEAST_S]:
        lengths = " to ".join(dict.fromkeys(f"{each:.0f}" for each in (min(short), max(short))))
        some = f"{len(short)} of {len(row['durations'])} records are of {lengths} s"
        remarks.append(f"{some}: the clauses ask for an hour as a rule")
    if assumed := [each for each in row["counted_by"] if each != "power-on"]:
        kinds = " or ".join(sorted(set(assumed)))
        remarks.append(f"{len(assumed)} power-ons are not recorded: each {kinds} is taken for one")
    return "; ".join(remarks) or None


def _standards(
    row: Mapping[str, Any], kind: str, n: int, value: dict[str, Any], made_of: Mapping[str, float | None] = _NOT_KNOWN
) -> Iterator[dict[str, Any]]:
    """The row, or one for each standard where the number of power-ons satisfies only one of them."""
    parameters = {"kind": kind, "position": row["position"], "earth_rate": row["earth_rate"]}
    parameters |= {"power_ons": len(row["biases"]), "power_ons_recorded": row["counted_by"].count("power-on")}
    parameters |= {"days": len(set(row["days"])) if row["is_dated"] else None, "remark": _remark(row)}
    parameters |= made_of
    common = {**row, "n": n, "parameters": parameters}
    if "component" in kind or n >= LEAST_GJB or "reason" in value:
        yield common | value
        return
    what = "days" if kind == "day_to_day" else "power-ons"
    few = f"{n} {what} measured, the clause asks for {LEAST_GJB} or more"
    yield common | {"reason": few, "standard": "GJB2426A", "clause": "5.12.3 (21)"}
    yield common | value | {"standard": "JJF2014", "clause": "7.2.15 (30)"}
