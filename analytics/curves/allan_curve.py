"""The Allan curve of a recorded signal."""

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from storage.sql.catalog import Catalog
from storage.sql.reading import SignalRecord, find_signal, read_signal
from stream.errors import BadInput, NotFound
from stream.estimators.allan_variance import AllanDeviation
from stream.estimators.base import NoEstimate
from stream.estimators.block_means import BlockMeans
from stream.estimators.full_overlap.deviation_forms import FORMS, Deviation
from stream.estimators.full_overlap.full_overlap import FullOverlap
from stream.events import EstimatePoint

Overlap = Literal["full", "strided"]

FULL_AT_MOST = 1_000_000


@dataclass(frozen=True)
class AllanCurve:
    """Allan deviation of one signal over averaging time, or another deviation in its place.

    Parameters
    ----------
    unit, signal, run: Whose curve it is.
    unit_of_measure: Of `adev`, `lo` and `hi`.
    sample_interval_s: Sample interval of the record, seconds.
    samples, missing: Samples in the record, and missing from it.
    tau_s: Averaging times, seconds, rising.
    adev, lo, hi: Deviation and its confidence limits (95 %).
    edf: Equivalent degrees of freedom.
    deviation: Which deviation `adev` holds.
    plausible: Exponents of the noises that are plausible at each averaging time, see `EstimatePoint`; empty where
        unknown.
    windows: Differences that each deviation rests on; empty where unknown.
    overlap: Windows at every sample, or at every 1/16 of the averaging time or closer.

    Raises
    ------
    BadInput: If the columns differ in length.
    """

    unit: str
    signal: str
    run: str
    unit_of_measure: str
    sample_interval_s: float
    samples: int
    missing: int
    tau_s: tuple[float, ...]
    adev: tuple[float, ...]
    lo: tuple[float, ...]
    hi: tuple[float, ...]
    edf: tuple[float, ...]
    deviation: Deviation = Deviation.OVERLAPPING_ALLAN
    overlap: Overlap = "strided"
    plausible: tuple[tuple[int, ...], ...] = ()
    windows: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Check that the columns fit together."""
        if len({len(column) for column in (self.tau_s, self.adev, self.lo, self.hi, self.edf)}) != 1:
            raise BadInput(f"Allan curve of unit {self.unit}, run {self.run}: its columns differ in length")

    @property
    def end(self) -> tuple[float, float]:
        """Longest averaging time (seconds) and the deviation there."""
        return self.tau_s[-1], self.adev[-1]

    def drawable(self) -> "AllanCurve":
        """Return the curve without the points that a logarithmic axis cannot show."""
        rows = [
            row
            for row in zip(self.tau_s, self.adev, self.lo, self.hi, self.edf, strict=True)
            if all(math.isfinite(x) and x > 0 for x in row[:4])
        ]
        columns = zip(*rows, strict=True) if rows else ((),) * 5
        tau_s, adev, lo, hi, edf = (tuple(column) for column in columns)
        return replace(self, tau_s=tau_s, adev=adev, lo=lo, hi=hi, edf=edf, plausible=(), windows=())

    @property
    def bare_names(self) -> tuple[str, str]:
        """English and Chinese name of the deviation, without its overlap."""
        form = FORMS[self.deviation]
        return form.name[0].upper() + form.name[1:], form.chinese

    @property
    def names(self) -> tuple[str, str]:
        """English and Chinese name of the deviation, as a title."""
        if not self.deviation.startswith("o"):
            return self.bare_names
        return f"Overlapping {FORMS[self.deviation].name}", f"重叠 {FORMS[self.deviation].chinese}"

    def document(self) -> dict[str, Any]:
        """Return the curve as it stands in JSON: the column of deviations is named after what it holds."""
        column = self.deviation.value.removeprefix("o")
        return {column if key == "adev" else key: value for key, value in asdict(self).items() if key != "windows"}


def allan_curve(
    catalog: Catalog,
    unit: str,
    signal: str,
    run: str | None = None,
    *,
    points_per_octave: int = 1,
    resample_s: float | None = None,
    deviation: Deviation = Deviation.OVERLAPPING_ALLAN,
    overlap: Overlap | None = None,
    scratch: Path | None = None,
) -> AllanCurve:
    """Allan deviation of a signal in the store, or another deviation.

    Parameters
    ----------
    catalog: The store.
    unit, signal: Which signal.
    run: Of which run; the one measured last where none is named.
    points_per_octave: 1, 2, 4 or 8 averaging times an octave.
    resample_s: Take means of blocks this long (seconds) first: the way to a curve from irregular samples.
    deviation: Which; all but the overlapping Allan deviation need the full overlap.
    overlap: "full" takes every window there is. "strided" is the estimator that runs while data flow, in small and
        constant memory; its limits are as wide to 0.5 %. By default full up to a million samples.
    scratch: Where the sums of a long record lie while it is evaluated with full overlap, 8 bytes a sample.

    Raises
    ------
    NotFound: If the store does not hold the signal, or holds too little of it.
    BadInput: If another deviation than the overlapping Allan deviation is wanted with strides.
    """
    record = find_signal(catalog, unit, signal, run)
    if overlap is None:
        is_full = deviation is not Deviation.OVERLAPPING_ALLAN or record.samples <= FULL_AT_MOST
        overlap = "full" if is_full else "strided"
    if overlap == "strided":
        if deviation is not Deviation.OVERLAPPING_ALLAN:
            raise BadInput(f"{deviation} has no strided form: leave --overlap out, or say --overlap full")
        strided = AllanDeviation(points_per_octave=points_per_octave)
        _feed(strided, catalog, record, resample_s)
        return _curve(record, strided, strided.estimate(), deviation, overlap)
    with FullOverlap(scratch) as full:
        _feed(full, catalog, record, resample_s)
        return _curve(record, full, full.evaluate(deviation, points_per_octave), deviation, overlap)


def _feed(
    estimator: AllanDeviation | FullOverlap, catalog: Catalog, record: SignalRecord, resample_s: float | None
) -> None:
    means = None if resample_s is None else BlockMeans(resample_s)
    for batch in read_signal(catalog, record):
        block_means = batch if means is None else means.push(batch)
        if block_means is not None:
            estimator.update(block_means)


def _curve(
    record: SignalRecord,
    estimator: AllanDeviation | FullOverlap,
    points: tuple[EstimatePoint, ...] | NoEstimate,
    deviation: Deviation,
    overlap: Overlap,
) -> AllanCurve:
    if isinstance(points, NoEstimate):
        reason = points.reason.removeprefix(f"unit {record.unit}, signal {record.signal}: ")
        raise NotFound(
            f"unit {record.unit}, signal {record.signal}, run {record.run}: no {FORMS[deviation].name}: {reason}"
        )
    return AllanCurve(
        unit=record.unit,
        signal=record.signal,
        run=record.run,
        unit_of_measure=estimator.unit_of_measure,
        sample_interval_s=estimator.sample_interval_s,
        samples=estimator.samples,
        missing=estimator.missing,
        tau_s=tuple(point.tau_s for point in points),
        adev=tuple(point.value for point in points),
        lo=tuple(point.lo for point in points),
        hi=tuple(point.hi for point in points),
        edf=tuple(point.edf for point in points),
        deviation=deviation,
        overlap=overlap,
        plausible=tuple(point.plausible for point in points),
        windows=tuple(point.n for point in points),
    )


def stored_curves(catalog: Catalog, run: str, signal: str) -> list[AllanCurve]:
    """The final Allan curves of a run as they were estimated while it ran, one for each unit.

    Raises
    ------
    NotFound: If there are none.
    """
    rows = catalog.rows(
        "select unit, unit_of_measure, sample_interval_s, samples, missing, "
        "list(tau_s order by tau_s), list(value order by tau_s), list(lo order by tau_s), list(hi order by tau_s), "
        "list(edf order by tau_s) "
        "from estimates "
        "where run = $run and signal = $signal and estimator = $estimator and final and tau_s is not null "
        "group by all order by unit",
        {"run": run, "signal": signal, "estimator": AllanDeviation.key},
    )
    if not rows:
        raise NotFound(f"run {run}, signal {signal}: no final Allan deviation is stored; has the run ended?")
    return [
        AllanCurve(
            unit,
            signal,
            run,
            unit_of_measure,
            interval_s,
            samples,
            missing,
            tau_s=tuple(taus_s),
            adev=tuple(adev),
            lo=tuple(lo),
            hi=tuple(hi),
            edf=tuple(edf),
        )
        for unit, unit_of_measure, interval_s, samples, missing, taus_s, adev, lo, hi, edf in rows
    ]
