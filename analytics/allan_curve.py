"""The Allan curve of a recorded signal."""

import math
from dataclasses import dataclass

from analytics.block_means import BlockMeans
from storage.catalog import Catalog
from storage.reading import find_signal, read_signal
from stream.errors import BadInput, NotFound
from stream.estimators.allan_variance import AllanDeviation
from stream.estimators.base import NoEstimate


@dataclass(frozen=True)
class AllanCurve:
    """Allan deviation of one signal over averaging time.

    Parameters
    ----------
    unit, signal, run : str
        Whose curve it is.
    unit_of_measure : str
        Of `adev`, `lo` and `hi`.
    sample_interval_s : float
        Sample interval of the record, seconds.
    samples, missing : int
        Samples in the record, and missing from it.
    tau_s : tuple of float
        Averaging times, seconds, rising.
    adev, lo, hi : tuple of float
        Deviation and its confidence limits (95 %).
    edf : tuple of float
        Equivalent degrees of freedom.

    Raises
    ------
    BadInput
        If the columns differ in length.
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
        head = (self.unit, self.signal, self.run, self.unit_of_measure, self.sample_interval_s)
        return AllanCurve(*head, self.samples, self.missing, tau_s, adev, lo, hi, edf)


def allan_curve(
    catalog: Catalog,
    unit: str,
    signal: str,
    run: str | None = None,
    *,
    points_per_octave: int = 1,
    resample_s: float | None = None,
) -> AllanCurve:
    """Overlapping Allan deviation of a signal in the store, by the estimator that runs while data flow.

    Parameters
    ----------
    catalog : Catalog
        The store.
    unit, signal : str
        Which signal.
    run : str, optional
        Of which run; the one recorded last where none is named.
    points_per_octave : int
        1, 2, 4 or 8 averaging times an octave.
    resample_s : float, optional
        Take means of blocks this long (seconds) first: the way to a curve from irregular samples.

    Raises
    ------
    NotFound
        If the store does not hold the signal, or holds too little of it.
    """
    record = find_signal(catalog, unit, signal, run)
    estimator = AllanDeviation(points_per_octave=points_per_octave)
    means = None if resample_s is None else BlockMeans(resample_s)
    for batch in read_signal(catalog, record):
        block_means = batch if means is None else means.push(batch)
        if block_means is not None:
            estimator.update(block_means)
    points = estimator.estimate()
    if isinstance(points, NoEstimate):
        reason = points.reason.removeprefix(f"unit {unit}, signal {signal}: ")
        raise NotFound(f"unit {unit}, signal {signal}, run {record.run}: no Allan deviation: {reason}")
    return AllanCurve(
        unit=unit,
        signal=signal,
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
    )


def stored_curves(catalog: Catalog, run: str, signal: str) -> list[AllanCurve]:
    """The final Allan curves of a run as they were estimated while it ran, one for each unit.

    Raises
    ------
    NotFound
        If there are none.
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
        AllanCurve(unit, signal, run, unit_of_measure, interval_s, samples, missing, *(tuple(each) for each in columns))
        for unit, unit_of_measure, interval_s, samples, missing, *columns in rows
    ]
