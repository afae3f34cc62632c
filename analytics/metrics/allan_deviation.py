"""Allan deviation at the averaging times that specifications limit."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pyarrow as pa

from analytics.metric_registry.registry import parameters_text
from storage.sql.catalog import Catalog
from storage.sql.reading import find_signal, read_signal
from stream.batch import SampleBatch
from stream.errors import GyrofleetError
from stream.estimators.base import NoEstimate
from stream.estimators.block_means import BlockMeans
from stream.estimators.full_overlap.deviation_forms import Deviation
from stream.estimators.full_overlap.full_overlap import FullOverlap
from stream.quantities import report_unit

HEADER = """\
-- id:        allan_deviation
-- en:        Allan deviation
-- zh:        Allan 标准差
-- unit:      deg/h
-- better:    lower
-- grain:     unit, signal, run, step, averaging time
-- parameters: tau_s, position, repeat, scale_factor, remark
-- source:    GJB 2426A-2004 5.12.5.4.2 (25)(26); JJF 2014-2022 7.2.20 (34)(35)
-- needs:     a static step (procedure static_bias or allan_variance), and a limit that names the averaging time
-- limits:    given
-- equation:  sigma^2(tau) = mean((F_(i+1) - F_i)^2)/2, F_i means over tau that overlap
"""

_ASKED = """
select s.*, t.tau_s from internal.bias_steps s,
  (select distinct replace(key, 'number ', '')::double as tau_s from internal.specification_parameters
    where metric = 'allan_deviation' and path = '$."tau_s"' and starts_with(key, 'number ')) t
where t.tau_s > 0
order by s.unit, s.signal, s.run, s."index", t.tau_s
"""
_BLOCKS = 16
_LEAST_BLOCK = 6  # samples; means of fewer, now one more and now one less, have another deviation
_SAME_TAU = 0.01
_COLUMNS = pa.schema(
    [(name, pa.string()) for name in ("unit", "signal", "run", "parameters", "reason")]
    + [(name, pa.float64()) for name in ("value", "lo", "hi", "standard_uncertainty", "freedom")]
    + [("n", pa.int64()), ("runs", pa.list_(pa.string())), ("steps", pa.list_(pa.int64()))]
)


def compute(catalog: Catalog) -> pa.Table:
    """Rows of the metric: the samples of a step are read where a limit names an averaging time."""
    rows = catalog.reader(_ASKED).read_all().to_pylist()
    return pa.Table.from_pylist([_row(row) | _deviation(catalog, row) for row in rows], schema=_COLUMNS)


def _row(row: Mapping[str, Any]) -> dict[str, Any]:
    parameters = {name: row[name] for name in ("tau_s", "position", "repeat")}
    parameters |= {"scale_factor": row["scale_source"], "remark": row["remark"]}
    head = {name: row[name] for name in ("unit", "signal", "run", "n")}
    return head | {"runs": [row["run"]], "steps": [row["index"]], "parameters": parameters_text(parameters)}


def _deviation(catalog: Catalog, row: Mapping[str, Any]) -> dict[str, Any]:
    if row["lack"] is not None:
        return {"reason": row["lack"]}
    tau_s = row["tau_s"]
    factor = abs(row["deg_per_h"]) / report_unit(row["unit_of_measure"])[1]
    try:
        with FullOverlap() as record:
            for batch in _blocks(_samples(catalog, row), tau_s):
                record.update(batch)
            interval_s = record.sample_interval_s
            most = max(1, round(tau_s / interval_s)) if interval_s else 1
            factors = [most, *(2**k for k in range(most.bit_length()) if 2**k < most)]
            points = record.evaluate(Deviation.OVERLAPPING_ALLAN, factors=factors)
    except GyrofleetError as error:
        return {"reason": str(error)}
    if isinstance(points, NoEstimate):
        return {"reason": points.reason}
    point = points[-1]
    if abs(point.tau_s - tau_s) > _SAME_TAU * tau_s:
        return {"reason": f"the record of {row['duration_s']:.0f} s has no Allan deviation at {tau_s:g} s"}
    if point.value == 0:
        return {"reason": "all samples are alike: the output is frozen, or its resolution too coarse to show noise"}
    found = {name: getattr(point, name) * factor for name in ("value", "lo", "hi")}
    return found | {"freedom": point.edf, "standard_uncertainty": found["value"] / (2 * point.edf) ** 0.5}


def _samples(catalog: Catalog, row: Mapping[str, Any]) -> Iterator[SampleBatch]:
    """The samples of the evaluated part of a step."""
    for batch in read_signal(catalog, find_signal(catalog, row["unit"], row["signal"], row["run"])):
        times_ns = batch.time_array
        inside = np.flatnonzero((times_ns >= row["t_from_ns"]) & (times_ns <= row["t_to_ns"]))
        if len(inside):
            yield batch.part(int(inside[0]), int(inside[-1]) + 1)


def _blocks(samples: Iterator[SampleBatch], tau_s: float) -> Iterator[SampleBatch]:
    """Means over a sixteenth of the averaging time, or the samples where that is too short for means."""
    means = BlockMeans(tau_s / _BLOCKS)
    for batch in samples:
        is_long = tau_s * 1e9 / _BLOCKS >= _LEAST_BLOCK * batch.dt_ns
        found = means.push(batch) if is_long else batch
        if found is not None:
            yield found
