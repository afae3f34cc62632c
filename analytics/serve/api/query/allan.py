"""Allan deviation of a recorded signal, with its noise coefficients."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import msgspec

from analytics.serve.api.operation import Call, get
from analytics.serve.api.query.recorded_signals import recorded_signal
from analytics.serve.api.rows import dictionaries, iso
from storage.sql.reading import find_signal
from stream.decoding import decode_json
from stream.errors import NotEnoughData, NotFound
from stream.events import EstimatePublished

if TYPE_CHECKING:
    from analytics.curves.allan_curve import AllanCurve

_QUICK_SAMPLES = 1_000_000
_LIVE = """
select tau_s, value, lo, hi, edf, n, unit_of_measure, t_ns, final, samples, missing, sample_interval_s from estimates
where unit = $unit and signal = $signal and run = $run and estimator = 'allan_deviation' and tau_s is not null
qualify t_ns = max(t_ns) over () order by tau_s
"""
# planning a statement takes longer than looking whether it can find anything
_RUNS_ESTIMATED = "select distinct run from internal.lake_estimates where estimator = 'allan_deviation'"
_RUNS_FITTED = "select distinct run from internal.lake_documents where kind = 'NoiseFitted'"
_FITTED = """
select document from internal.lake_documents
where kind = 'NoiseFitted' and run = $run and unit = $unit and document->>'$.signal' = $signal
order by t_ns desc limit 1
"""


class AllanAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which curve: the last live estimate if there is one (`stored`), or computed from all samples (`samples`)."""

    source: Literal["stored", "samples"] = "stored"


class Allan(msgspec.Struct, frozen=True, kw_only=True):
    """A curve: deviation at each averaging time with its 95 % bounds, in `unit_of_measure`.

    `source` is ``live`` for estimates of the run, ``samples`` for those computed from all samples; `final` says whether
    a live estimate is of the whole run. `noise` has the coefficients of IEEE 952 that were fitted when the run ended.
    Without a curve, `reason` says why.
    """

    unit: str
    run: str
    signal: str
    unit_of_measure: str
    source: str
    final: bool
    t_ns: int | None
    time: str | None
    samples: int
    missing: int
    sample_interval_s: float
    tau_s: list[float]
    adev: list[float]
    lo: list[float]
    hi: list[float]
    edf: list[float]
    noise: dict[str, Any] | None
    reason: str | None = None

    def columns(self) -> Mapping[str, Sequence[Any]]:
        """Its table, for Arrow and CSV."""
        return {name: getattr(self, name) for name in self.column_types()}

    def column_types(self) -> Mapping[str, type]:
        """What the values of its table are."""
        return dict.fromkeys(("tau_s", "adev", "lo", "hi", "edf"), float)


@get("/api/allan/{unit}/{run}/{signal}", table="", is_slow=True, is_live=True)
def allan(call: Call, asked: AllanAsked) -> Allan:
    """Overlapping Allan deviation of a signal over averaging time, with 95 % confidence bounds."""
    of = _names(call)
    if asked.source == "stored" and (known := known_allan(call)) is not None:
        return known
    # the lake's, so that it is not computed again for every message that the log gets
    key = ("allan of samples", *of.values(), call.state.tag)
    found: Allan = call.service.memo.result(key, lambda: _of_lake(call, of))
    return found


def _of_lake(call: Call, of: dict[str, str]) -> Allan:
    """The curve of all samples in the lake."""
    from analytics.curves.allan_curve import allan_curve

    noise = _noise(call, of)
    try:
        curve = allan_curve(call.views, of["unit"], of["signal"], of["run"])
    except (NotEnoughData, NotFound) as error:  # too few samples, or dropped ones
        record = find_signal(call.views, of["unit"], of["signal"], of["run"])
        return Allan(
            **of, unit_of_measure=record.unit_of_measure, source="samples", final=True, t_ns=None, time=None,
            samples=record.samples, missing=0, sample_interval_s=0.0, tau_s=[], adev=[], lo=[], hi=[], edf=[],
            noise=noise, reason=str(error),
        )  # fmt: skip
    return _of_samples(curve, of, noise)


def known_allan(call: Call) -> Allan | None:
    """The last estimate of the run; None if there is none, so that it is to be computed from the samples."""
    of = _names(call)
    name = (of["unit"], of["run"], of["signal"])
    newest = call.service.live.tail.curve(name)
    if newest is not None and not newest.final:
        return _newest(newest, of)
    recorded = recorded_signal(call, of["unit"], of["signal"], of["run"])
    if recorded.about is None and call.service.live.tail.version(name):
        return _not_yet(of)
    rows = dictionaries(call.views, _LIVE, of) if of["run"] in _runs(call, "allan_deviation", _RUNS_ESTIMATED) else []
    return _stored(rows, of, _noise(call, of)) if rows else None


def is_long(call: Call) -> bool:
    """Whether a signal has so many samples that its curve takes seconds."""
    of = _names(call)
    about = recorded_signal(call, of["unit"], of["signal"], of["run"]).about
    return about is not None and about["samples"] > _QUICK_SAMPLES


def _runs(call: Call, what: str, sql: str) -> frozenset[str]:
    """Runs in the lake that have something."""
    found: frozenset[str] = call.service.memo.newest(
        f"runs with {what}", call.state.tag, lambda: frozenset(run for (run,) in call.views.rows(sql))
    )
    return found


def _names(call: Call) -> dict[str, str]:
    return {name: call.path[name] for name in ("unit", "run", "signal")}


def _noise(call: Call, of: dict[str, str]) -> dict[str, Any] | None:
    if of["run"] not in _runs(call, "NoiseFitted", _RUNS_FITTED):
        return None
    fitted = call.views.rows(_FITTED, of)
    return decode_json(fitted[0][0]) if fitted else None


def _newest(of_run: EstimatePublished, of: dict[str, str]) -> Allan:
    """A live estimate that may not be in the lake yet."""
    points = of_run.points
    return Allan(
        **of, unit_of_measure=of_run.unit_of_measure, source="live", final=False, t_ns=of_run.t_ns,
        time=iso(of_run.t_ns), samples=of_run.samples, missing=of_run.missing,
        sample_interval_s=of_run.sample_interval_s, tau_s=[each.tau_s for each in points],
        adev=[each.value for each in points], lo=[each.lo for each in points], hi=[each.hi for each in points],
        edf=[each.edf for each in points], noise=None,
    )  # fmt: skip


def _not_yet(of: dict[str, str]) -> Allan:
    return Allan(
        **of, unit_of_measure="", source="live", final=False, t_ns=None, time=None, samples=0, missing=0,
        sample_interval_s=0.0, tau_s=[], adev=[], lo=[], hi=[], edf=[], noise=None,
        reason="no estimate has been published yet: the run has just begun, or no `gyrofleet estimate` is at work",
    )  # fmt: skip


def _stored(rows: list[dict[str, Any]], of: dict[str, str], noise: dict[str, Any] | None) -> Allan:
    last = rows[0]
    columns: dict[str, Any] = {name: [row[name] for row in rows] for name in ("tau_s", "lo", "hi", "edf")}
    about = {
        name: last[name] for name in ("unit_of_measure", "samples", "missing", "sample_interval_s", "t_ns", "final")
    }
    adev = [row["value"] for row in rows]
    return Allan(**(of | about | columns), adev=adev, source="live", time=iso(last["t_ns"]), noise=noise)


def _of_samples(curve: "AllanCurve", of: dict[str, str], noise: dict[str, Any] | None) -> Allan:
    return Allan(
        **of, unit_of_measure=curve.unit_of_measure, source="samples", final=True, t_ns=None, time=None,
        samples=curve.samples, missing=curve.missing, sample_interval_s=curve.sample_interval_s,
        tau_s=list(curve.tau_s), adev=list(curve.adev), lo=list(curve.lo), hi=list(curve.hi), edf=list(curve.edf),
        noise=noise,
    )  # fmt: skip
