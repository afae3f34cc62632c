"""The floor when somebody begins to look: open runs, and the last run of each station, from the lake."""

import time
from contextlib import suppress

import msgspec

from analytics.floor import Floor
from storage.sql.catalog import Catalog
from stream.decoding import converted, decode_json
from stream.events import AnyDocument, EstimatePoint, EstimatePublished
from stream.identity import Place
from stream.worker.limit_checks import estimator_key

_OPEN_DAYS = 7
_RUNS = """
select run from (
  select run, outcome, epoch_ns(recorded) as recorded_ns, row_number() over
    (partition by site, station
     order by if(source like 'file %' and date_known, started, recorded) desc nulls last, run) as rank
  from runs where site is not null
) where rank = 1 or outcome = 'open' and recorded_ns > $since order by recorded_ns limit 200
"""
_DOCUMENTS = """
select site, station, document, arrival_ns from internal.lake_documents
where list_contains($runs, run) and kind in ('RunStarted', 'RunResumed', 'RunEnded', 'LimitsApplied', 'UnitMounted',
  'PowerOn', 'PowerOff', 'UnitReleased',
  'StepStarted', 'StepEnded', 'EarlyDecision', 'VerdictGiven')
order by arrival_ns, t_ns
"""
_SAMPLES = """
select site, station, run, unit, max(t_last_ns) as t_ns, max(arrival_last_ns) as arrival_ns from internal.lake_channels
where list_contains($runs, run) group by all order by arrival_ns
"""
_ESTIMATES = """
select run, unit, signal, estimator, t_ns, unit_of_measure, confidence, final, samples, missing, sample_interval_s,
  list({tau_s: tau_s, value: value, lo: lo, hi: hi, edf: edf, n: n} order by tau_s) as points
from estimates
where run = $run and list_contains($keys, estimator) and tau_s is not null
group by all
qualify t_ns = max(t_ns) over (partition by unit, signal, estimator)
"""


def fill_floor(floor: Floor, catalog: Catalog) -> None:
    """Put the runs of the lake on a floor."""
    since_ns = time.time_ns() - _OPEN_DAYS * 86_400 * 10**9
    runs = [run for (run,) in catalog.rows(_RUNS, {"since": since_ns})]
    for site, station, text, arrival_ns in catalog.rows(_DOCUMENTS, {"runs": runs}):
        with suppress(msgspec.MsgspecError):  # `gyrofleet verify` reports it
            floor.take(Place(site, station), decode_json(text, AnyDocument), arrival_ns)
    for site, station, run, unit, t_ns, arrival_ns in catalog.rows(_SAMPLES, {"runs": runs}):
        floor.sampled(Place(site, station), unit, run, t_ns, arrival_ns)
    for now in [each for each in floor.runs.values() if each.outcome == "open"]:
        keys = sorted({estimator_key(limit) for limits in now.limits.values() for limit in limits})
        for row in catalog.rows(_ESTIMATES, {"run": now.run, "keys": keys}) if keys else []:
            run, unit, signal, estimator, t_ns, per, confidence, final, samples, missing, interval_s, points = row
            estimate = EstimatePublished(
                run=run, t_ns=t_ns, unit=unit, signal=signal, estimator=estimator, unit_of_measure=per,
                confidence=confidence, final=final, samples=samples, missing=missing, sample_interval_s=interval_s,
                points=tuple(converted(each, EstimatePoint) for each in points),
            )  # fmt: skip
            floor.take(now.place, estimate, now.arrival_ns)
    floor.forget_changes()
