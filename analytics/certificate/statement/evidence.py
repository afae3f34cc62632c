"""What the store knows of a calibration: its runs, the device, the environment that was recorded."""

import datetime as dt
from collections.abc import Collection
from zoneinfo import ZoneInfo

import msgspec

from analytics.certificate.statement.references import Reference, stated_references
from storage.sql.catalog import Catalog
from stream.events import CertificateIssued

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
_EXCLUDED = """
select x.run, x.reason, x.by_whom, coalesce(r.time_zone, 'UTC'), case when r.date_known then epoch_ns(r.started) end
from exclusions x join runs r using (run) where x.unit = $unit order by r.started, x.run
"""
_AIR = """
select min(lo), max(hi), count(distinct run) from rollup_10s
where list_contains($runs, run) and list_contains($signals, signal) and unit_of_measure = $unit_of_measure
"""
# a chamber is the environment where no temperature was commanded, and in steps at room temperature
_CHAMBER = """
select min(temperature), max(temperature), count(distinct run) from step_means
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
        return _day(self.start_ns, self.time_zone), _day(self.end_ns, self.time_zone)


class ExcludedRun(msgspec.Struct, frozen=True, kw_only=True):
    """A run of the unit that somebody has excluded from evaluation."""

    run: str
    reason: str
    by: str
    time_zone: str
    start_ns: int | None

    @property
    def day(self) -> dt.date | None:
        """First day at the station; None where the date is not known."""
        return None if self.start_ns is None else _day(self.start_ns, self.time_zone)


class Recorded(msgspec.Struct, frozen=True, kw_only=True):
    """Least and greatest value that are recorded, and in how many runs."""

    span: Span | None = None
    runs: int = 0

    def is_whole(self, runs: int) -> bool:
        """Whether it is recorded in all of so many runs."""
        return self.runs >= runs

    def beside(self, stated: Span | None) -> Span | None:
        """The span of what is recorded and of what somebody states."""
        if self.span is None or stated is None:
            return self.span or stated
        return min(self.span[0], stated[0]), max(self.span[1], stated[1])


class Evidence(msgspec.Struct, frozen=True, kw_only=True):
    """What is recorded of the runs of a certificate."""

    unit: str
    runs: tuple[CalibrationRun, ...]
    product: str | None
    firmware: str | None
    lot: str | None
    temperature: Recorded  # degC
    relative_humidity: Recorded  # %
    references: tuple[Reference, ...]
    excluded: tuple[ExcludedRun, ...] = ()

    @property
    def time_zone(self) -> str:
        """Of the station of the last run."""
        known = [run for run in self.runs if run.end_ns is not None]
        return max(known, key=lambda run: run.end_ns or 0).time_zone if known else "UTC"

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
    given: dict[str, object] = {"runs": sorted(runs)}
    runs_found = tuple(
        CalibrationRun(**dict(zip(CalibrationRun.__struct_fields__, row, strict=True)))
        for row in catalog.rows(_RUNS, given)
    )
    ((product, firmware, lot),) = catalog.rows(_DEVICE, given | {"unit": unit})
    air = _recorded(catalog, _AIR, {**given, "signals": _AIR_TEMPERATURES, "unit_of_measure": "degC"})
    last_days = {run.run: None if run.days is None else run.days[1] for run in runs_found}
    return Evidence(
        unit=unit,
        runs=runs_found,
        product=product,
        firmware=firmware,
        lot=lot,
        temperature=air if air.span is not None else _recorded(catalog, _CHAMBER, given | {"unit": unit}),
        relative_humidity=_recorded(catalog, _AIR, {**given, "signals": _HUMIDITIES, "unit_of_measure": "%"}),
        references=tuple(stated_references(catalog, last_days)),
        excluded=tuple(
            ExcludedRun(**dict(zip(ExcludedRun.__struct_fields__, row, strict=True)))
            for row in catalog.rows(_EXCLUDED, {"unit": unit})
        ),
    )


def _day(t_ns: int, time_zone: str) -> dt.date:
    return dt.datetime.fromtimestamp(t_ns / 1e9, ZoneInfo(time_zone)).date()


def _recorded(catalog: Catalog, sql: str, given: dict[str, object]) -> Recorded:
    ((least, most, runs),) = catalog.rows(sql, given)
    return Recorded() if least is None else Recorded(span=(float(least), float(most)), runs=runs)


def zone_of(catalog: Catalog, document: CertificateIssued) -> dt.tzinfo:
    """Time zone of the station of the last run of a certificate."""
    rows = catalog.rows(
        "select coalesce(arg_max(time_zone, ended), 'UTC') from runs where list_contains($runs, run)",
        {"runs": list(document.runs)},
    )
    return ZoneInfo(rows[0][0])
