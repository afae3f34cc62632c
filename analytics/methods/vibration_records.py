"""Steps of angular vibration: the sines of a gyro and of its reference, record by record, from a store."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import groupby
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np

from analytics.methods.frequency_response import LEAST_PER_PERIOD, Response, SineFit, SineRatio, fit_sine, response_of
from storage.sql.catalog import Catalog
from stream.batch import FloatArray, IntArray
from stream.errors import BadInput, UnknownUnit
from stream.quantities import conversion, is_angular_rate

LEAST_FREQUENCIES = 10
LEAST_RECORDS = 10
LOWEST_HZ = 10.0
# Tests are planned by the expected bandwidth: the measured one may be larger by this factor.
_ALLOWANCE = 0.8
# a signal that sees less of the vibration than this share of another of its unit stands across it
_ACROSS = 0.2

_REFERENCES = """
select unit, signal, unit_of_measure, sample_interval_s from signals
where run = $run and kept_raw > 0 and regexp_matches(signal, '^(table|input|reference|vibration)_(rate|angle)(_|$)')
order by unit <> $unit, sample_interval_s, signal desc, unit
"""
_SAMPLES = """
select t_ns, value from internal.samples_in($paths)
where run = $run and unit = $unit and signal = $signal and t_ns between $first and $last order by t_ns, seq
"""


class Vibration(NamedTuple):
    """A gyro's test on an angular-vibration table."""

    words: Mapping[str, Any]  # ``run``, ``unit``, ``signal``, ``procedure``, ``position``, ``axis``
    steps: list[int]  # steps that were evaluated, or all where none could be
    response: Response | None  # gain per deg/s; of an output that is a rate, in deg/s
    reference: str  # signal that measured the vibration
    sample_rate_hz: float
    scale_factor: float | None  # the one last measured before, output per deg/s, in the run `scale_run`
    scale_run: str | None
    reason: str | None  # why records, some or all, could not be evaluated


class _Series(NamedTuple):
    t_ns: IntArray
    values: FloatArray

    def within(self, step: Mapping[str, Any]) -> tuple[FloatArray, FloatArray]:
        """Samples of a step; their times count from its middle, seconds."""
        first, last = step["t_from_ns"], step["t_to_ns"]
        part = slice(np.searchsorted(self.t_ns, first), np.searchsorted(self.t_ns, last, side="right"))
        return (self.t_ns[part] - (first + last) // 2) / 1e9, self.values[part]


@dataclass
class _Reference:
    """The vibration of the table: a rate in deg/s, or an angle in deg; without a series, the commanded one."""

    name: str
    series: _Series | None = None
    is_angle: bool = False
    _sines: dict[tuple[int, int, float], SineFit] = field(default_factory=dict)

    def sine(self, step: Mapping[str, Any]) -> SineFit:
        """Its sine in a step; all units on the table share it."""
        assert self.series is not None
        of = (step["t_from_ns"], step["t_to_ns"], step["frequency"])
        if of not in self._sines:
            self._sines[of] = fit_sine(*self.series.within(step), step["frequency"], refine=True)
        return self._sines[of]


def vibrations(catalog: Catalog, sql: str) -> Iterator[Vibration]:
    """Tests on angular-vibration tables of the units whose ``step_means`` are in the catalogue.

    One for each signal, run, procedure, position and axis with steps that have a `frequency`. The reference is the
    signal ``table_rate`` or ``table_angle`` (also ``input_``, ``reference_``, ``vibration_``) of the unit or else of an
    instrument of the run, that with the shortest sample interval; where none is fast enough the commanded amplitude,
    deg/s of the rate. A signal that sees less than a fifth of what another of the unit sees stands across and is left
    out.
    """
    rows: list[dict[str, Any]] = catalog.reader(sql).read_all().to_pylist()
    test = itemgetter("signal", "procedure", "position", "axis")
    for run, of_run in groupby(rows, itemgetter("run")):
        known: dict[tuple[str, str], _Reference] = {}
        steps_of_run = list(of_run)
        for unit, of_unit in groupby(steps_of_run, itemgetter("unit")):
            steps = list(of_unit)
            reference = _reference(catalog, run, unit, steps_of_run, known)
            found = [_vibration(catalog, list(group), reference) for _, group in groupby(steps, test)]
            largest = max((_lowest_gain(each) for each in found), default=0.0)
            yield from (each for each in found if each.response is None or _lowest_gain(each) >= _ACROSS * largest)


def unmet(vibration: Vibration, least_records: int) -> str | None:
    """What the clauses ask of the frequencies and records and the test lacks; None if nothing."""
    response, reason = vibration.response, vibration.reason
    count = 0 if response is None else len(response.frequency_hz)
    if response is None or count < LEAST_FREQUENCIES:
        asked = f"{count} frequencies could be evaluated, the clauses ask for at least {LEAST_FREQUENCIES}"
        return f"{asked}: {reason}" if reason else asked
    f = response.frequency_hz
    if f[0] > 1.01 * LOWEST_HZ:
        return f"the lowest frequency is {f[0]:g} Hz, the clauses ask for {LOWEST_HZ:g} Hz"
    widest, mean = float((f[1:] / f[:-1]).max()), float((f[-1] / f[0]) ** (1 / (count - 1)))
    if math.log(widest) > 2 * math.log(mean):
        return f"a frequency is {widest:.3g} times the one before, the clauses ask for equal ratios, of {mean:.3g} here"
    if response.records.min() < least_records:
        worst = int(response.records.argmin())
        return f"{response.records[worst]:.0f} records at {f[worst]:g} Hz, the clause asks for at least {least_records}"
    return None


def too_little_for(bandwidth_hz: float, vibration: Vibration) -> str | None:
    """What the clauses ask of a test for the measured bandwidth and it lacks; None if nothing."""
    assert vibration.response is not None
    highest_hz = float(vibration.response.frequency_hz[-1])
    asked = None
    if highest_hz < _ALLOWANCE * 2 * bandwidth_hz:
        asked = f"the highest frequency is {highest_hz:g} Hz, the clauses ask for twice the bandwidth"
    elif vibration.sample_rate_hz < _ALLOWANCE * 20 * bandwidth_hz:
        rate = f"{vibration.sample_rate_hz:.6g} Hz"
        asked = f"sampled at {rate}, the clauses ask for above 20 times the bandwidth"
    return None if asked is None else f"{asked}, which comes out as {bandwidth_hz:.4g} Hz"


def _lowest_gain(vibration: Vibration) -> float:
    return 0.0 if vibration.response is None else float(vibration.response.gain[0])


def _reference(
    catalog: Catalog, run: str, unit: str, steps: Sequence[Mapping[str, Any]], known: dict[tuple[str, str], _Reference]
) -> _Reference:
    highest_hz = max(step["frequency"] for step in steps)
    for owner, signal, measure, interval_s in catalog.rows(_REFERENCES, {"run": run, "unit": unit}):
        if not interval_s or interval_s * highest_hz > 1 / LEAST_PER_PERIOD:
            continue
        is_angle = not is_angular_rate(measure)
        with suppress(UnknownUnit):
            factor, offset = conversion(measure, "deg" if is_angle else "deg/s")
            if (owner, signal) not in known:
                series = _fetched(catalog, run, owner, signal, steps)
                series = series._replace(values=series.values * factor + offset)
                name = f"{signal} of {owner}" if owner != unit else signal
                known[owner, signal] = _Reference(name, series, is_angle=is_angle)
            return known[owner, signal]
    return _Reference("commanded amplitude")


def _fetched(catalog: Catalog, run: str, unit: str, signal: str, steps: Iterable[Mapping[str, Any]]) -> _Series:
    spans = [(step["t_from_ns"], step["t_to_ns"]) for step in steps]
    asked = {"run": run, "unit": unit, "signal": signal, "first": min(spans)[0], "last": max(end for _, end in spans)}
    table = catalog.reader(_SAMPLES, {"paths": catalog.checked_paths_of([run], _SAMPLES), **asked}).read_all()
    return _Series(table["t_ns"].to_numpy(), table["value"].to_numpy())


def _vibration(catalog: Catalog, steps: list[dict[str, Any]], reference: _Reference) -> Vibration:
    words = steps[0]
    series = _fetched(catalog, words["run"], words["unit"], words["signal"], steps)
    factor = (words["rate_factor"] or 3600.0) / 3600.0
    series = series._replace(values=series.values * factor)
    records, used, reasons = [], [], []
    for step in steps:
        try:
            records.append(_record(step, series, reference))
            used.append(step["index"])
        except BadInput as error:
            reasons.append(str(error))
    if not len(series.t_ns):
        reasons = ["no raw sample of the steps is in the store, and means of seconds hold no sine"]
    gaps = np.diff(series.t_ns)
    return Vibration(
        words=words, steps=used or [step["index"] for step in steps],
        response=response_of(records) if records else None, reference=reference.name,
        sample_rate_hz=_rate_hz(gaps), scale_factor=words["scale_factor"],
        scale_run=words["scale_run"], reason=reasons[0] if reasons else None,
    )  # fmt: skip


def _record(step: Mapping[str, Any], series: _Series, reference: _Reference) -> SineRatio:
    if reference.series is None:
        if not step["amplitude"]:
            raise BadInput(
                f"step {step['index']}: neither the table's rate or angle was recorded, fast enough for "
                f"{step['frequency']:g} Hz, nor its amplitude commanded"
            )
        own = fit_sine(*series.within(step), step["frequency"], refine=True)
        size = abs(float(step["amplitude"]))
        return SineRatio(step["frequency"], own.amplitude / size, own.amplitude_uncertainty / size, math.nan, math.nan)
    given = reference.sine(step)
    own = fit_sine(*series.within(step), given.frequency_hz)
    if not (given.amplitude > 0 and own.amplitude > 0):
        still = "the output" if given.amplitude > 0 else reference.name
        raise BadInput(f"step {step['index']}: {still} stands still; the table was to vibrate")
    omega = 2 * math.pi * given.frequency_hz if reference.is_angle else 1.0
    gain = own.amplitude / (given.amplitude * omega)
    relative = math.hypot(own.amplitude_uncertainty / own.amplitude, given.amplitude_uncertainty / given.amplitude)
    # erratum: the rate leads the angle by pi/2, GJB 2426A-2004 (33) prints -pi/2
    phase_rad = own.phase_rad - given.phase_rad - (math.pi / 2 if reference.is_angle else 0.0)
    phase_u = math.hypot(own.phase_uncertainty_rad, given.phase_uncertainty_rad)
    return SineRatio(step["frequency"], gain, gain * relative, phase_rad, phase_u)


def _rate_hz(gaps_ns: IntArray) -> float:
    """Samples a second, from the gaps between them; rounded times have gaps of two lengths, losses are left out.

    >>> _rate_hz(np.array([310_000, 310_000, 320_000, 310_000, 620_000]))
    3200.0
    """
    if not len(gaps_ns):
        return 0.0
    return 1e9 / float(gaps_ns[gaps_ns <= 1.5 * np.median(gaps_ns)].mean())
