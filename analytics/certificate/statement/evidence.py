"""What the store knows of a calibration: its runs, the device, the environment that was recorded."""

import datetime as dt
from collections.abc import Collection
from zoneinfo import ZoneInfo

import msgspec

from analytics.certificate.statement.references import Reference, stated_references
from storage.sql.catalog import Catalog

_RUNS = """
select run, site, station, coalesce(operator, ''), coalesce(time_zone, 'UTC'), simulated,
  case when date_known then epoch_ns(started) end, case when date_known then epoch_ns(ended) end
from runs where list_contains($runs, run) order by started, run
"""
# the product and firmware as last mounted
_DEVICE = """
select arg_max(product, t_ns) as product, arg_max(firmware, t_ns) as firmware, arg_max(lot, t_ns) as lot
from units where unit = $unit and list_contains($runs, run)
"""
_AIR = """
select min(lo), max(hi) from rollup_10s
where list_contains($runs, run) and list_contains($signals, signal) and unit_of_measure = $unit_of_measure
"""
# a chamber is the environment where no temperature was commanded, and in steps at room temperature
_CHAMBER = """
select min(temperature), max(temperature) from step_means
where unit = $unit and list_contains($runs, run) and temperature_source = 'chamber'
  and (temperature_command is null or room)
"""
_AIR_TEMPERATURES = ["ambient_temperature", "room_temperature"]
_HUMIDITIES = ["ambient_humidity", "relative_humidity"]

Span = tuple[float, float]


class CalibrationRun(msgspec.Struct, frozen=True, kw_only=True):
    """A run that results rest on."""

    run: str
    site: str
    station: str
    operator: str
    time_zone: str
    simulated: bool
    start_ns: int | None
    end_ns: int | None

    @property
    def days(self) -> tuple[dt.date, dt.date] | None:
        """First and last day at the station; None where the date is not known."""
        if self.start_ns is None or self.end_ns is None:
            return None
        first, last = (
            dt.datetime.fromtimestamp(t_ns / 1e9, ZoneInfo(self.time_zone)).date()
            for t_ns in (self.start_ns, self.end_ns)
        )
        return first, last


class Evidence(msgspec.Struct, frozen=True, kw_only=True):
    """What is recorded of the runs of a certificate."""

    unit: str
    runs: tuple[CalibrationRun, ...]
    product: str | None
    firmware: str | None
    lot: str | None
    temperature_deg_c: Span | None
    relative_humidity_percent: Span | None
    references: tuple[Reference, ...]

    @property
    def days(self) -> tuple[dt.date, dt.date] | None:
        """First and last day of the calibration; None where the date of a run is not known."""
        days = [run.days for run in self.runs]
        known = [each for each in days if each is not None]
        if not known or len(known) < len(days):
            return None
        return min(first for first, _ in known), max(last for _, last in known)


def read_evidence(catalog: Catalog, unit: str, runs: Collection[str]) -> Evidence:
    """What the store knows of a unit's runs."""
    names = sorted(runs)
    given = {"runs": names}
    found = catalog.rows(_RUNS, given)
    ((product, firmware, lot),) = catalog.rows(_DEVICE, given | {"unit": unit})
    return Evidence(
        unit=unit,
        runs=tuple(CalibrationRun(**dict(zip(CalibrationRun.__struct_fields__, row, strict=True))) for row in found),
        product=product,
        firmware=firmware,
        lot=lot,
        temperature_deg_c=_span(catalog, _AIR, {**given, "signals": _AIR_TEMPERATURES, "unit_of_measure": "degC"})
        or _span(catalog, _CHAMBER, given | {"unit": unit}),
        relative_humidity_percent=_span(catalog, _AIR, {**given, "signals": _HUMIDITIES, "unit_of_measure": "%"}),
        references=tuple(stated_references(catalog, names)),
    )


def _span(catalog: Catalog, sql: str, given: dict[str, object]) -> Span | None:
    ((least, most),) = catalog.rows(sql, given)
    return None if least is None else (float(least), float(most))
