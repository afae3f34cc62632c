"""The Allan curve of a recorded signal."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

from analytics.curves.shortfall import shortfall_of
from storage.sql.catalog import Catalog
from storage.sql.reading import SignalRecord, find_signal, read_signal
from stream.defects.longest_gap import LongestGap
from stream.defects.outliers import IsolatedOutliers
from stream.defects.rate_changes import RateChange, RateChanges, remark_on_rate_changes
from stream.defects.stillness import Stillness, remark_on_stillness
from stream.errors import BadInput, NotEnoughData, NotFound
from stream.estimators.allan_variance import AllanDeviation
from stream.estimators.base import NoEstimate
from stream.estimators.block_means import BlockMeans
from stream.estimators.full_overlap.deviation_forms import FORMS, Deviation
from stream.estimators.full_overlap.full_overlap import FullOverlap
from stream.events import EstimatePoint

Overlap = Literal["full", "strided"]
_Estimator = AllanDeviation | FullOverlap

FULL_AT_MOST = 1_000_000
_TAU_TOLERANCE = 1e-3
_SAME_RATE = 0.05
_MANY = 50  # samples a block: one more or less of them changes nothing


@dataclass(frozen=True)
class AllanCurve:
    """Allan deviation of one signal over averaging time, or another deviation."""

    unit: str
    signal: str
    run: str
    unit_of_measure: str  # of `adev`, `lo` and `hi`
    sample_interval_s: float
    samples: int
    missing: int
    tau_s: tuple[float, ...]  # averaging times, increasing
    adev: tuple[float, ...]  # of the kind `deviation`, with its 95 % confidence bounds
    lo: tuple[float, ...]
    hi: tuple[float, ...]
    edf: tuple[float, ...]  # equivalent degrees of freedom
    deviation: Deviation = Deviation.OVERLAPPING_ALLAN
    overlap: Overlap = "strided"  # windows at every sample, or at every 1/16 of the averaging time or closer
    # exponents of the plausible noises at each averaging time, see `EstimatePoint`; empty where unknown
    plausible: tuple[tuple[int, ...], ...] = ()
    windows: tuple[int, ...] = ()  # number of differences of each deviation; empty where unknown
    longest_still: int = 0  # samples of the longest stretch in which all are alike
    left_out_tau_s: tuple[float, ...] = ()  # averaging times that were asked for and the record has no deviation at
    longest_tau_s: float | None = None  # the longest averaging time of the record, where any was left out
    rate_changes: tuple[RateChange, ...] = ()  # places where the sample rate changes; empty where unknown
    outliers: IsolatedOutliers | None = None  # None where they were not sought
    longest_gap: int = 0  # samples that the longest gap lacks; 0 where unknown

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
        columns = zip(self.tau_s, self.adev, self.lo, self.hi, self.edf, strict=True)
        rows = [row for row in columns if all(math.isfinite(x) and x > 0 for x in row[:4])]
        tau_s, adev, lo, hi, edf = zip(*rows, strict=True) if rows else ((),) * 5
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

    @property
    def remark(self) -> tuple[str, str] | None:
        """What a reader must know of the record, in English and Chinese."""
        found = [remark_on_stillness(self.longest_still, self.samples)]
        if (changes := remark_on_rate_changes(self.rate_changes)) is not None:
            en, zh = self._effect_of_rates()
            found.append((f"{changes[0]}: {en}", f"{changes[1]}：{zh}"))
        if self.left_out_tau_s:
            taus = ", ".join(f"{each:g} s" for each in self.left_out_tau_s)
            found.append((
                f"no deviation at {taus}: this record reaches {self.longest_tau_s:g} s, less where samples are missing",
                f"在 {taus} 处没有结果：本记录最长平均时间为 {self.longest_tau_s:g} s，缺采样处更短",
            ))  # fmt: skip
        if (shortfall := shortfall_of(self.samples, self.missing, self.longest_gap)) is not None:
            found.append(shortfall.remark(self.sample_interval_s, self.tau_s[-1] if self.tau_s else 0.0))
        if self.outliers is not None and self.outliers.is_worth_a_word:
            found.append((self.outliers.sentence, self.outliers.chinese))
        remarks = [each for each in found if each is not None]
        return ("; ".join(en for en, _ in remarks), "；".join(zh for _, zh in remarks)) if remarks else None

    def _effect_of_rates(self) -> tuple[str, str]:
        """What changes of the sample rate do to the curve, in English and Chinese."""
        interval = f"{self.sample_interval_s:g} s"
        rates_hz = {each for change in self.rate_changes for each in (change.from_hz, change.to_hz)}
        if any(abs(self.sample_interval_s * rate_hz - 1.0) < _SAME_RATE for rate_hz in rates_hz):
            return (
                f"where no sample is every {interval}, it is taken as missing",
                f"凡间隔 {interval} 处没有采样，均按缺失处理",
            )
        return (
            f"blocks of {interval} are means of other numbers of samples then, with another white noise",
            f"{interval} 的平均块此后所含采样数不同，白噪声也不同",
        )

    def document(self) -> dict[str, Any]:
        """The curve as JSON, with the same keys for every kind of deviation; `curve_document` has the outliers."""
        left_out = ("windows", "outliers", "longest_gap")
        return {"value" if key == "adev" else key: value for key, value in asdict(self).items() if key not in left_out}


def allan_curve(
    catalog: Catalog, unit: str, signal: str, run: str | None = None, *, points_per_octave: int = 1,
    resample_s: float | None = None, deviation: Deviation = Deviation.OVERLAPPING_ALLAN, overlap: Overlap | None = None,
    taus_s: Sequence[float] = (), scratch: Path | None = None,
) -> AllanCurve:  # fmt: skip
    """Allan deviation of a signal in the store, or another deviation.

    Raises NotFound if the store does not hold the signal, NotEnoughData if it holds too little of it; BadInput if
    another deviation than the overlapping Allan deviation, or averaging times, are asked for with strides.

    Parameters
    ----------
    run: Of which run; the longest record if omitted.
    points_per_octave: 1, 2, 4 or 8 averaging times an octave.
    resample_s: Take means of blocks this long first, as for irregular samples.
    overlap: "full" takes every window. "strided" is the estimator of live data, in small and constant memory; its
        bounds are as wide to 0.5 %. By default full up to a million samples; all but the overlapping Allan deviation
        need it.
    taus_s: Averaging times, instead of those of `points_per_octave`; they need the full overlap.
    scratch: Folder of the sums of a long record during its evaluation with full overlap, 8 bytes a sample.
    """
    record = find_signal(catalog, unit, signal, run)
    if overlap is None:
        is_full = bool(taus_s) or deviation is not Deviation.OVERLAPPING_ALLAN or record.samples <= FULL_AT_MOST
        overlap = "full" if is_full else "strided"
    if overlap == "strided":
        if deviation is not Deviation.OVERLAPPING_ALLAN:
            raise BadInput(f"{deviation} has no strided form: leave --overlap out, or say --overlap full")
        if taus_s:
            raise BadInput("given averaging times need every window: leave --overlap out, or say --overlap full")
        strided = AllanDeviation(points_per_octave=points_per_octave)
        fed = _feed(strided, catalog, record, resample_s)
        return _curve(record, strided, strided.estimate(), deviation, overlap, fed)
    with FullOverlap(scratch) as full:
        fed = _feed(full, catalog, record, resample_s)
        factors = [_factor(tau_s, full.sample_interval_s) for tau_s in taus_s] or None
        points = full.evaluate(deviation, points_per_octave, factors)
        curve = _curve(record, full, points, deviation, overlap, fed)
        given = {round(tau_s / full.sample_interval_s) for tau_s in curve.tau_s}
        missing = [tau_s for tau_s, factor in zip(taus_s, factors or (), strict=bool(factors)) if factor not in given]
        if not missing:
            return curve
        return replace(curve, left_out_tau_s=tuple(missing), longest_tau_s=full.longest_tau_s(deviation))


def _factor(tau_s: float, interval_s: float) -> int:
    factor = round(tau_s / interval_s) if interval_s > 0.0 else 1
    if factor < 1 or abs(factor * interval_s / tau_s - 1.0) > _TAU_TOLERANCE:
        whole = f"a whole number of sample intervals, here of {interval_s:g} s"
        raise BadInput(f"--tau {tau_s:g}: an averaging time is {whole}")
    return factor


class _Fed(NamedTuple):
    """What was seen in the samples beside their deviation."""

    still: Stillness
    rate_changes: tuple[RateChange, ...]
    longest_gap: int


def _feed(estimator: _Estimator, catalog: Catalog, record: SignalRecord, resample_s: float | None) -> _Fed:
    still, rates, gap = Stillness(), RateChanges(), LongestGap()
    means = None if resample_s is None else BlockMeans(resample_s)
    for batch in read_signal(catalog, record):
        if resample_s is not None and not record.irregular:
            _check_blocks(resample_s, batch.dt_ns / 1e9)
        rates.follow_batch(batch)
        block_means = batch if means is None else means.push(batch)
        if block_means is not None:
            still.follow(block_means.value_array)  # of what counts as a sample of the curve
            gap.follow(block_means)
            estimator.update(block_means)
    return _Fed(still, tuple(rates.found), gap.samples)


def _check_blocks(block_s: float, interval_s: float) -> None:
    """BadInput if blocks hold now one sample more, now one less, of so few that their means differ in weight."""
    samples = block_s / interval_s
    if 1.0 <= samples < _MANY and abs(samples - round(samples)) > _TAU_TOLERANCE * samples:
        near = sorted({max(1, math.floor(samples)), math.ceil(samples)})
        whole = " or ".join(f"{each * interval_s:g}" for each in near)
        raise BadInput(
            f"--resample {block_s:g}: blocks of a regular signal are a whole number of its sample intervals of "
            f"{interval_s:g} s, here {whole}"
        )


def _curve(
    record: SignalRecord, estimator: _Estimator, points: tuple[EstimatePoint, ...] | NoEstimate, deviation: Deviation,
    overlap: Overlap, fed: _Fed,
) -> AllanCurve:  # fmt: skip
    if isinstance(points, NoEstimate):
        where = f"unit {record.unit}, signal {record.signal}"
        reason = points.reason.removeprefix(f"{where}: ")
        raise NotEnoughData(f"{where}, run {record.run}: no {FORMS[deviation].name}: {reason}")
    of = (record.unit, record.signal, record.run)
    curve = curve_of_points(of, estimator, points, deviation, overlap, fed.still, fed.longest_gap)
    return replace(curve, rate_changes=fed.rate_changes)


def curve_of_points(
    of: tuple[str, str, str], estimator: _Estimator, points: Sequence[EstimatePoint], deviation: Deviation,
    overlap: Overlap, still: Stillness, longest_gap: int = 0,
) -> AllanCurve:  # fmt: skip
    """The curve of a unit, signal and run from the points of an estimator."""
    unit, signal, run = of
    columns: dict[str, Any] = {
        name: tuple(getattr(point, name) for point in points) for name in ("tau_s", "lo", "hi", "edf")
    }
    return AllanCurve(
        unit=unit, signal=signal, run=run, unit_of_measure=estimator.unit_of_measure,
        sample_interval_s=estimator.sample_interval_s, samples=estimator.samples, missing=estimator.missing,
        adev=tuple(point.value for point in points), deviation=deviation, overlap=overlap,
        **columns,
        plausible=tuple(point.plausible for point in points), windows=tuple(point.n for point in points),
        longest_still=still.longest, longest_gap=longest_gap,
    )  # fmt: skip


def stored_curves(catalog: Catalog, run: str, signal: str) -> list[AllanCurve]:
    """The final live Allan curves of a run, one for each unit. Raises NotFound if there are none."""
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
        AllanCurve(unit, signal, run, *about, *(tuple(column) for column in (taus_s, adev, lo, hi, edf)))
        for unit, *about, taus_s, adev, lo, hi, edf in rows
    ]
