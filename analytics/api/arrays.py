"""Estimates of plain arrays, without a store: Allan deviation and noise coefficients."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING
from uuid import UUID

import msgspec
import numpy as np
import numpy.typing as npt

from analytics.api.values import check_index, rate_of, row_of
from analytics.curves.allan_curve import AllanCurve, curve_of_points
from ingest.tables.units import known_unit
from stream.arguments import path_of, text_of
from stream.batch import FloatArray, SampleBatch
from stream.defects.longest_gap import LongestGap
from stream.defects.outliers import count_outliers
from stream.defects.stillness import Stillness
from stream.errors import BadInput, EstimatorError, NotEnoughData
from stream.estimators.base import NoEstimate, held_share
from stream.estimators.full_overlap.deviation_forms import Deviation
from stream.estimators.full_overlap.full_overlap import FullOverlap
from stream.estimators.noise.noise_fit import NoiseCoefficient, NoiseFit, fit_noise
from stream.events import EstimatePoint

if TYPE_CHECKING:
    import polars as pl

_PIECE_SAMPLES = 1_000_000
_OCTAVES = (1, 2, 4, 8)


@dataclass(frozen=True, eq=False)
class DeviationCurve:
    """A deviation over averaging time, with 95 % confidence bounds.

    Parameters
    ----------
    tau_s: shape (n,); averaging times, seconds, rising.
    deviation, lo, hi: shape (n,); deviation and its bounds.
    edf: shape (n,); equivalent degrees of freedom.
    n: shape (n,); differences that each deviation rests on.
    kind: Which deviation.
    unit_of_measure: Of the deviation: deg/h for angular rates, else that of the values.
    curve: The same for plots and reports.
    """

    tau_s: FloatArray
    deviation: FloatArray
    lo: FloatArray
    hi: FloatArray
    edf: FloatArray
    n: npt.NDArray[np.int64]
    kind: Deviation
    unit_of_measure: str
    curve: AllanCurve

    @property
    def remark(self) -> str:
        """What a reader must know of the record: a frozen output, outliers, missing samples; empty for nothing."""
        return "" if self.curve.remark is None else self.curve.remark[0]

    def polars(self) -> "pl.DataFrame":
        """As a Polars frame, one row an averaging time."""
        import polars as pl

        names = ("tau_s", "deviation", "lo", "hi", "edf", "n")
        return pl.DataFrame({name: getattr(self, name) for name in names})

    def plot(self, path: str | Path) -> Path:
        """Draw it into a ``.png`` or ``.svg`` file; returns its path."""
        from analytics.plots.allan_plot import plot_allan

        place = Path(path_of(path, "path"))
        plot_allan([self.curve], place)
        return place


def allan_deviation(
    values: npt.ArrayLike,
    rate_hz: float,
    *,
    unit_of_measure: str = "1",
    deviation: str = "oadev",
    points_per_octave: int = 1,
) -> DeviationCurve:
    """Allan deviation of an array, or another deviation, with every window there is and its confidence bounds.

    Parameters
    ----------
    values: shape (n,); samples at equal intervals; NaN where one is missing.
    rate_hz: Samples a second.
    unit_of_measure: Of the values, as `import` reads it. Angular rates such as deg/s give deviations in deg/h.
    deviation: ``oadev``, ``adev``, ``mdev``, ``ohdev`` or ``hdev``.
    points_per_octave: 1, 2, 4 or 8 averaging times an octave.

    Raises
    ------
    BadInput: If the values are no row of numbers, or `rate_hz` or `deviation` is none that can be.
    NotEnoughData: If there are too few values.

    Notes
    -----
    NIST SP 1065 5.2, IEEE 952-2020 annex C; bounds by chi-square with the least equivalent degrees of freedom of the
    noises that the curve leaves plausible.

    Examples
    --------
    >>> found = allan_deviation([1.0, 3.0, 2.0, 6.0, 4.0], rate_hz=1.0)
    >>> found.tau_s.tolist(), found.deviation.round(6).tolist()
    ([1.0, 2.0], [1.767767, 1.600781])
    >>> bool((found.lo < found.deviation).all() and (found.deviation < found.hi).all())
    True
    """
    row = row_of(values)
    rate_hz = rate_of(rate_hz)
    interval_ns = round(1e9 / rate_hz)
    check_index(values, rate_hz)
    unit_of_measure = known_unit(text_of(unit_of_measure, "unit_of_measure", "a text such as deg/s is expected"))
    check_octave(points_per_octave)
    kind = deviation_named(deviation)
    with FullOverlap() as record:
        still, gap = Stillness(), LongestGap()
        pieces = [row[begin : begin + _PIECE_SAMPLES] for begin in range(0, row.size, _PIECE_SAMPLES)]
        for begin, piece in zip(range(0, row.size, _PIECE_SAMPLES), pieces, strict=True):
            batch = SampleBatch(
                "array", "values", "r1", UUID(int=0), begin, begin * interval_ns, interval_ns, unit_of_measure,
                values=piece,
            )  # fmt: skip
            still.follow(piece)
            gap.follow(batch)
            record.update(batch)
        try:
            points = record.evaluate(kind, points_per_octave)
        except EstimatorError as error:
            raise BadInput(str(error)) from None
        if isinstance(points, NoEstimate):
            raise NotEnoughData(points.reason.removeprefix("unit array, signal values: "))
        exact = 1e9 / (rate_hz * interval_ns)  # intervals count in whole nanoseconds
        points = tuple(msgspec.structs.replace(each, tau_s=each.tau_s * exact) for each in points)
        curve = curve_of_points(("array", "values", ""), record, points, kind, "full", still, gap.samples)
        return deviation_curve(replace(curve, outliers=count_outliers(pieces)))


def noise_fit(curve: DeviationCurve) -> NoiseFit:
    """Noise coefficients Q, N, B, K, R of IEEE 952 from an overlapping Allan deviation, with their bounds.

    The `value` of a term that is not `observable` is NaN: the record gives its upper bound `hi` only.

    Parameters
    ----------
    curve: Of an angular rate, by `allan_deviation`.

    Raises
    ------
    BadInput: If it is of another deviation or of no angular rate.
    NotEnoughData: If it has too few averaging times.

    Examples
    --------
    >>> rate_deg_per_h = np.random.default_rng(2).normal(0.0, 6.0, 100_000)  # N = 6/60/sqrt(100) deg/sqrt(h)
    >>> found = noise_fit(allan_deviation(rate_deg_per_h, rate_hz=100.0, unit_of_measure="deg/h"))
    >>> found.angle_random_walk.lo < 0.01 < found.angle_random_walk.hi
    True
    """
    if not isinstance(curve, DeviationCurve):
        raise BadInput("noise_fit takes what allan_deviation gives: noise_fit(allan_deviation(values, rate_hz, ...))")
    if curve.kind is not Deviation.OVERLAPPING_ALLAN:
        raise BadInput(f"noise coefficients are fitted to the overlapping Allan deviation, not to {curve.kind}")
    if curve.unit_of_measure != "deg/h":
        raise BadInput(
            f"noise coefficients are those of an angular rate, and these values are in {curve.unit_of_measure}: give "
            "allan_deviation their unit_of_measure, as deg/s or rad/s"
        )
    columns = zip(curve.tau_s, curve.deviation, curve.lo, curve.hi, curve.edf, curve.n, strict=True)
    noises = curve.curve.plausible
    points = [
        EstimatePoint(tau_s=tau_s, value=value, lo=lo, hi=hi, edf=edf, n=int(n), plausible=plausible)
        for (tau_s, value, lo, hi, edf, n), plausible in zip(columns, noises, strict=True)
    ]
    found = fit_noise(points, held=held_share(curve.curve.samples, curve.curve.missing))
    if isinstance(found, NoEstimate):
        raise NotEnoughData(found.reason)
    terms = {name: getattr(found, name) for name in found.__struct_fields__}
    bounds = {
        name: msgspec.structs.replace(each, value=math.nan)
        for name, each in terms.items()
        if isinstance(each, NoiseCoefficient) and not each.observable
    }
    return msgspec.structs.replace(found, **bounds)


def check_octave(points_per_octave: object) -> None:
    """Refuse what is no number of averaging times in an octave, such as 3 or True."""
    is_number = isinstance(points_per_octave, int | np.integer) and not isinstance(points_per_octave, bool)
    if not is_number or points_per_octave not in _OCTAVES:
        raise BadInput(f"points_per_octave is {points_per_octave!r}, expected 1, 2, 4 or 8")


def deviation_named(name: object) -> Deviation:
    """The deviation of a name; BadInput if there is none."""
    try:
        return Deviation(str(name))
    except ValueError:
        raise BadInput(f"no deviation {name!r}: choose one of {', '.join(Deviation)}") from None


def deviation_curve(curve: AllanCurve) -> DeviationCurve:
    """The columns of a curve as arrays."""
    columns = {name: np.array(getattr(curve, name)) for name in ("tau_s", "lo", "hi", "edf")}
    return DeviationCurve(
        deviation=np.array(curve.adev),
        n=np.array(curve.windows, np.int64),
        kind=curve.deviation,
        unit_of_measure=curve.unit_of_measure,
        curve=curve,
        **columns,
    )
