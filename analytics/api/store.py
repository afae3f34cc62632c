"""A store opened for Python: runs, samples, curves, metrics and diagnoses as Polars frames and typed results."""

import operator
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from datetime import datetime
from os import PathLike
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from analytics.api.arrays import DeviationCurve, check_octave, deviation_curve, deviation_named
from ingest.moment import moment_ns
from storage.sql.door import QueryLimits
from storage.sql.opened import Answer, OpenedStore, opened_at
from stream.arguments import optional_text, text_of, texts_of
from stream.errors import BadInput, StoreError

if TYPE_CHECKING:
    import polars as pl

    from analytics.loop.unit_diagnosis import UnitDiagnosis
    from storage.sql.catalog import Catalog

_FIRST, _LAST = np.datetime64("1678-01-01"), np.datetime64("2262-01-01")  # of 64-bit nanoseconds
_UNITS = """
select s.unit, s.run, u.product, u.lot, u.slot, u.fixture, s.signals
from (select unit, run, count(*) as signals from signals group by all) s left join units u using (unit, run)
order by s.unit, s.run
"""
_SAMPLES = """
select t_ns, make_timestamp_ns(t_ns) as time, value, unit_of_measure, run
from samples
where unit = $unit and signal = $signal and run = $run
  and ($start is null or t_ns >= $start) and ($stop is null or t_ns < $stop)
order by t_ns
"""


class FleetStore:
    """A store as it is when it is opened; use it in a ``with``, or close it.

    Parameters
    ----------
    folder: Of the store; or the address of its published lake, ``s3://BUCKET/PREFIX``.
    endpoint_url: Of the object store; by default AWS_ENDPOINT_URL, else Amazon's.
    limits: Time, memory and rows that one SQL statement may take.

    Raises
    ------
    StoreError: If the folder is no store.

    Examples
    --------
    >>> import gyrofleet as gf
    >>> with gf.open_store("gyrofleet-data") as store:  # doctest: +SKIP
    ...     print(store.metrics(unit="FOG-0231", metric="bias"))
    ...     store.allan("FOG-0231", "rate").plot("allan.png")
    """

    def __init__(
        self, folder: str | PathLike[str], limits: QueryLimits | None = None, *, endpoint_url: str | None = None
    ) -> None:
        self._store = opened_at(folder, endpoint_url)
        self._sql = OpenedStore(self._store, limits)
        self._stack = ExitStack()
        self._stack.callback(self._sql.close)
        self._opened: Catalog | None = None
        self._is_open = True

    def sql(self, statement: str, parameters: object = None) -> Answer:
        """Answer one statement that reads; `parameters` fill its ``$name`` or ``?``.

        Raises
        ------
        QueryError: If it would do more than read the store, fails, or takes more than the limits allow.
        """
        self._check_open()
        return self._sql.sql(statement, parameters)

    def runs(self) -> "pl.DataFrame":
        """All runs: when, how long, how they ended, which units."""
        return self.sql("from runs order by started, run").polars()

    def units(self) -> "pl.DataFrame":
        """All units of each run, with product, lot, slot and fixture where they are known."""
        return self.sql(_UNITS).polars()

    def signals(self) -> "pl.DataFrame":
        """All recorded signals, with their unit of measure and number of samples."""
        return self.sql("from signals order by unit, signal, run").polars()

    def samples(
        self,
        unit: str,
        signal: str,
        run: str | None = None,
        start: str | datetime | np.datetime64 | int | None = None,
        stop: str | datetime | np.datetime64 | int | None = None,
    ) -> "pl.DataFrame":
        """Samples of one signal in the order of their time.

        Parameters
        ----------
        unit, signal: Which signal.
        run: The longest record if omitted; the column `run` has its name.
        start, stop: From when, and until before when: a moment with a time zone, or nanoseconds UTC (as `t_ns`).

        Returns
        -------
        DataFrame
            ``t_ns``, ``time`` (UTC), ``value``, ``unit_of_measure`` and ``run``.

        Raises
        ------
        NotFound: If the store does not hold it.
        BadInput: If a moment has no time zone, or `start` is not before `stop`.
        """
        from storage.sql.reading import find_signal

        self._check_open()
        record = find_signal(self._sql, *_names(unit, signal, run))
        given = {"unit": unit, "signal": signal, "run": record.run}
        from_ns, to_ns = _moment_ns(start, "start"), _moment_ns(stop, "stop")
        if from_ns is not None and to_ns is not None and from_ns >= to_ns:
            raise BadInput(f"start ({start}) is not before stop ({stop}): there is no time between them")
        bounds = {"start": from_ns, "stop": to_ns}
        import polars as pl

        return self.sql(_SAMPLES, given | bounds).polars().with_columns(pl.col("time").dt.replace_time_zone("UTC"))

    def allan(
        self, unit: str, signal: str, run: str | None = None, *, deviation: str = "oadev", points_per_octave: int = 1
    ) -> DeviationCurve:
        """Allan deviation of a recorded signal, or another deviation; see `gyrofleet.allan_deviation`.

        Without a run it is that of the longest record; `curve.run` of the result is its name.

        Raises
        ------
        NotFound: If the store does not hold the signal, or holds too little of it.
        """
        from analytics.curves.allan_curve import allan_curve
        from analytics.curves.isolated_outliers import isolated_outliers
        from storage.sql.reading import find_signal

        kind = deviation_named(deviation)
        check_octave(points_per_octave)
        names = _names(unit, signal, run)
        curve = allan_curve(self._catalog, *names, points_per_octave=points_per_octave, deviation=kind)
        outliers = isolated_outliers(self._catalog, find_signal(self._catalog, unit, signal, curve.run))
        return deviation_curve(replace(curve, outliers=outliers))

    def metrics(
        self,
        *,
        unit: str | Sequence[str] = (),
        metric: str | Sequence[str] = (),
        lot: str | Sequence[str] = (),
        run: str | Sequence[str] = (),
        standard: str | Sequence[str] = (),
    ) -> "pl.DataFrame":
        """Characteristics of the standards: value, 95 % interval and clause, or the reason why there is none.

        Parameters
        ----------
        unit, metric, lot, run, standard: Only these; all if left out.

        Raises
        ------
        NotFound: If a unit, lot or run is not in the store.
        BadInput: If there is no such metric or standard.
        """
        import polars as pl

        from analytics.evaluation.selection import Selection, selected_table
        from analytics.evaluation.type_b import COVERAGE

        asked = Selection(
            units=texts_of(unit, "unit"),
            lots=texts_of(lot, "lot"),
            runs=texts_of(run, "run"),
            metrics=texts_of(metric, "metric"),
            standards=texts_of(standard, "standard"),
        )
        found = pl.DataFrame(selected_table(self._catalog, asked).drop_columns(["freedom"]))
        p = pl.when(pl.col("U").is_not_null()).then(COVERAGE).alias("p")
        return found.with_columns(pl.col("parameters").fill_null("{}"), p)

    def diagnose(
        self,
        unit: str,
        model: str,
        *,
        signal: str | None = None,
        runs: str | Sequence[str] | None = None,
        holdout: str | Sequence[str] | None = None,
        progress: Callable[[str], None] = lambda _: None,
    ) -> "UnitDiagnosis":
        """Find what a declared error model lacks; `gyrofleet diagnose` says the same in words.

        Parameters
        ----------
        unit: Which unit.
        model: Declared, such as ``"rate = bias + scale_factor*input_rate"``.
        signal: Which signal; the one that the model names if left out.
        runs: Only these.
        holdout: Runs that the fit does not see; the last third if left out.
        progress: Called with a sentence on each stage.

        Returns
        -------
        UnitDiagnosis
            Its ``diagnosis`` has the verdict, the effects with their coefficients, and the error before and after.

        Raises
        ------
        GyrofleetError: If the unit cannot be diagnosed; the message says why.
        """
        from analytics.loop.unit_diagnosis import diagnose_units
        from analytics.loop.unit_reduction import Question

        if not callable(progress):
            raise BadInput(f"progress is {progress!r}: a function of one text is expected")
        question = Question(
            model=text_of(model, "model"),
            signal=optional_text(signal, "signal"),
            holdout=None if holdout is None else texts_of(holdout, "holdout"),
            runs=None if runs is None else texts_of(runs, "runs"),
        )
        return diagnose_units(self._catalog, [text_of(unit, "unit")], question, on_progress=progress).units[unit]

    @property
    def _catalog(self) -> "Catalog":
        self._check_open()
        if self._opened is None:
            from storage.sql.catalog import Catalog

            self._opened = self._stack.enter_context(Catalog(self._store))
        return self._opened

    def close(self) -> None:
        """Close it; nothing can be asked any more."""
        self._is_open = False
        self._stack.close()

    def _check_open(self) -> None:
        if not self._is_open:
            raise StoreError(f"the store {self._store.label} is closed: open it again with gyrofleet.open_store")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def open_store(
    folder: str | PathLike[str], limits: QueryLimits | None = None, *, endpoint_url: str | None = None
) -> FleetStore:
    """Open a store for Python, or the published lake of one; see `FleetStore`.

    Raises
    ------
    StoreError: If the folder is no store.
    """
    return FleetStore(folder, limits, endpoint_url=endpoint_url)


def _names(unit: object, signal: object, run: object) -> tuple[str, str, str | None]:
    return text_of(unit, "unit"), text_of(signal, "signal"), optional_text(run, "run")


def _moment_ns(moment: str | datetime | np.datetime64 | int | np.integer[Any] | None, name: str) -> int | None:
    if moment is None:
        return None
    if isinstance(moment, np.datetime64):  # numpy's are UTC
        if np.isnat(moment) or not _FIRST <= moment <= _LAST:  # beyond, its nanoseconds have no number
            raise BadInput(f"{name} is {moment}: a moment from {_FIRST} to {_LAST} is expected")
        return int(moment.astype("datetime64[ns]").astype(np.int64))
    if isinstance(moment, bool):
        raise BadInput(f"{name} is {moment}: a moment is expected")
    if isinstance(moment, str | datetime):
        return moment_ns(moment if isinstance(moment, str) else moment.isoformat(), name)
    try:
        return operator.index(moment)
    except TypeError:
        asked = "a moment with a time zone, or whole nanoseconds UTC, are expected"
        raise BadInput(f"{name} is {moment!r}: {asked}") from None
