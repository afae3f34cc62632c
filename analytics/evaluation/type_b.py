"""Combined and expanded uncertainty of the metrics' rows: type A of the row, type B of the station's standards.

How an error of a standard enters a metric stands in the metric's header (`Influence`). U is k u with the k of
p = 95.45 %, by the effective degrees of freedom of Welch and Satterthwaite: 2 where these are many.
"""

import math
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from analytics.methods.distributions import student_quantile
from analytics.metric_registry.registry import MetricHeader
from analytics.uncertainty.station_standards import StatedQuantity, StationStandards, worst
from ingest.measurement_standards import QUANTITIES
from storage.sql.catalog import Catalog
from storage.sql.deferred import words_of
from stream.batch import FloatArray

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
UNCERTAINTIES = ("u_type_a", "u_type_b", "U", "k", "nu")
OF_SCALE_FACTOR = frozenset({"rate", "rate_nonuniformity"})  # enter a value by its scale factor
SCALE_FROM = "measured in run "
_SCALE_RUN = f'"scale_factor": ?"{SCALE_FROM}(?P<run>[^"\\\\]+)"'
COVERAGE = math.erf(math.sqrt(2.0))  # p of k = 2
NO_SENSITIVITY = "the record does not say how it enters"
NO_INFLUENCE = "type B unknown: the metric does not state how the station's standards enter"
NO_TYPE_A = "type A unknown: the scatter of the value is not determined"
# Latitude of each run, and axis and unit of the output of each signal.
_FACTS = """
create or replace table internal.influence_facts as
select run as of_run, unit as of_unit, signal as of_signal, any_value(latitude_deg) as latitude_deg,
  any_value(body_axis) as body_axis,
  any_value(unit_of_measure) as output_unit, case output_unit when 'V' then 1.0 when 'mV' then 1e-3 when 'uV' then 1e-6
  end as volt
from step_means left join (select distinct run, unit, signal, body_axis from internal.gyro_steps)
  using (run, unit, signal)
group by run, unit, signal
"""
_OF_FACTS = ("latitude_deg", "body_axis", "output_unit", "volt")
_KEYS = ("run", "runs", "unit", "signal")
_SENSITIVITIES = """
select {expressions} from given_rows m
left join internal.influence_facts f
  on f.of_run = coalesce(m.run, m.runs[1]) and f.of_unit = m.unit and f.of_signal is not distinct from m.signal
order by m.row_at
"""


class TypeB:
    """Type B uncertainty of rows of metrics, by what the stations of their runs state."""

    def __init__(self, catalog: Catalog) -> None:
        self._catalog = catalog
        catalog.define(_FACTS)

    @cached_property
    def _standards(self) -> dict[str, StationStandards]:
        found = self._catalog.rows("select run, standards, t_ns, time_zone, recorded_ns from internal.run_standards")
        return {run: StationStandards(*stated) for run, *stated in found}

    def standards(self, runs: list[str]) -> list[StationStandards]:
        """What the stations of some runs state."""
        return [self._standards.get(run) or StationStandards(None, None) for run in runs]

    def sensitivities(self, header: MetricHeader, found: pa.Table, columns: Mapping[str, pa.Array]) -> list[FloatArray]:
        """Of each influence the sensitivity of each row; NaN where it cannot be known."""
        own = {name: found[name] for name in found.column_names if name not in {*columns, *_OF_FACTS}}
        listed = ", ".join(f'({each.sensitivity})::double as "{each.quantity}"' for each in header.influences)
        named = words_of(listed).union(_KEYS)
        rows = {name: column for name, column in {**columns, **own}.items() if name in named}
        rows["row_at"] = pa.array(np.arange(found.num_rows))
        table = self._catalog.table(_SENSITIVITIES.format(expressions=listed), pa.table(rows))
        return [table[each.quantity].to_numpy() for each in header.influences]

    def columns(self, header: MetricHeader, found: pa.Table, columns: Mapping[str, pa.Array]) -> dict[str, pa.Array]:
        """The columns of `UNCERTAINTIES` and `uncertainty_reason` for the rows of a metric."""
        n = found.num_rows
        has_value = np.asarray(pc.is_valid(columns["value"]))
        u_a, freedom = (columns[name].to_numpy(zero_copy_only=False) for name in ("standard_uncertainty", "freedom"))
        if not header.influences or not n:
            unknown = np.full(n, np.nan)
            why = header.no_influence or NO_INFLUENCE
            return _arrays((u_a, unknown, unknown, unknown, unknown), pa.repeat(why, n), has_value)
        runs, of_row = _run_sets(columns, has_scale_factor="scale_factor" in header.parameters)
        known = self._stated(header, runs)
        sensitivities = self.sensitivities(header, found, columns)
        u_b, missing = np.zeros(n), np.zeros(n, np.int64)
        parts = [(u_a, np.nan_to_num(freedom, nan=np.inf))]
        for place, (stated, sensitivity) in enumerate(zip(known, sensitivities, strict=True)):
            u = np.array([each.u for each in stated])[of_row]
            degrees = np.array([each.freedom for each in stated])[of_row]
            part = np.where(sensitivity == 0, 0.0, np.abs(sensitivity) * u)
            missing |= np.isnan(part).astype(np.int64) << place
            parts.append((np.nan_to_num(part), degrees))
            u_b = np.hypot(u_b, parts[-1][0])
        u_b = np.where(missing > 0, np.nan, u_b)
        combined = np.hypot(u_a, u_b)
        with np.errstate(divide="ignore", invalid="ignore"):
            # of ratios: the fourth power of a large or small value has no number
            effective = 1.0 / sum((part / combined) ** 4 / degrees for part, degrees in parts)
        k = student_quantile((1 + COVERAGE) / 2, np.clip(np.nan_to_num(effective, nan=1e9), 1.0, 1e9))
        reasons = self._reasons(header, known, of_row, missing, sensitivities, np.isnan(u_a))
        is_open = np.isnan(combined)
        k, effective = (np.where(is_open, np.nan, each) for each in (k, effective))
        return _arrays((u_a, u_b, k * combined, k, effective), reasons, has_value)

    def stated(self, runs: list[str], scale_run: str, quantity: str) -> StatedQuantity:
        """What the standards state of a quantity: those of the runs, of the rate that of the scale factor's own run."""
        is_of_scale = bool(scale_run) and quantity in OF_SCALE_FACTOR
        return worst(self.standards([scale_run] if is_of_scale else runs), quantity)

    def _stated(self, header: MetricHeader, runs: list[tuple[list[str], str]]) -> list[list[StatedQuantity]]:
        """Of each influence, what the standards of each set of runs state."""
        return [[self.stated(*each, influence.quantity) for each in runs] for influence in header.influences]

    def _reasons(
        self, header: MetricHeader, known: list[list[StatedQuantity]], of_row: IntArray, missing: IntArray,
        sensitivities: list[FloatArray], lacks_a: BoolArray,
    ) -> pa.Array:  # fmt: skip
        """Why a row has no U: one text for each set of runs and of influences that are unknown."""
        is_open = np.zeros(len(missing), np.int64)
        for place, sensitivity in enumerate(sensitivities):
            is_open |= np.isnan(sensitivity).astype(np.int64) << place
        keys = (of_row, missing, is_open, lacks_a.astype(np.int64))
        shape = tuple(int(key.max()) + 1 for key in keys)
        encoded = pa.array(np.ravel_multi_index(keys, shape)).dictionary_encode()
        distinct = np.stack(np.unravel_index(encoded.dictionary.to_numpy(), shape), axis=1)
        texts = []
        for run_set, absent, open_ones, lacks in distinct.tolist():
            by_reason: dict[str, list[str]] = {}
            for place, influence in enumerate(header.influences):
                if absent >> place & 1:
                    is_unclear = open_ones >> place & 1
                    reason = NO_SENSITIVITY if is_unclear else known[place][run_set].reason
                    by_reason.setdefault(reason, []).append(QUANTITIES[influence.quantity].en)
            parts = [f"type B unknown: {', '.join(names)}: {reason}" for reason, names in by_reason.items()]
            texts.append("; ".join([*([NO_TYPE_A] if lacks else []), *parts]) or None)
        return pa.array(texts, pa.string()).take(encoded.indices)


def _run_sets(
    columns: Mapping[str, pa.Array], *, has_scale_factor: bool
) -> tuple[list[tuple[list[str], str]], IntArray]:
    """The distinct sets of runs that rows rest on, each with the run of the scale factor, and which each row has."""
    runs = columns["run"]
    if runs.null_count:
        runs = pc.coalesce(runs, pc.binary_join(columns["runs"], "\n"), pa.scalar(""))
    if has_scale_factor:
        scale_runs = pc.struct_field(pc.extract_regex(columns["parameters"], _SCALE_RUN), "run")
        runs = pc.binary_join_element_wise(runs, pc.fill_null(scale_runs, ""), "\t")
    encoded = runs.dictionary_encode()
    parts = [text.partition("\t") for text in encoded.dictionary.to_pylist()]
    return [(names.split("\n"), scale) for names, _, scale in parts], encoded.indices.to_numpy().astype(np.int64)


def scale_run_of(parameters: Mapping[str, Any]) -> str:
    """The run in which the scale factor of a value was measured; empty where it is none that was measured.

    >>> scale_run_of({"scale_factor": "measured in run K-1"}), scale_run_of({"scale_factor": "output is a rate"})
    ('K-1', '')
    """
    source = parameters.get("scale_factor")
    return source.removeprefix(SCALE_FROM) if isinstance(source, str) and source.startswith(SCALE_FROM) else ""


def _arrays(numbers: tuple[FloatArray, ...], reasons: pa.Array, has_value: BoolArray) -> dict[str, pa.Array]:
    found = {
        name: pa.array(each, pa.float64(), mask=~has_value | ~np.isfinite(each))
        for name, each in zip(UNCERTAINTIES, numbers, strict=True)
    }
    return found | {"uncertainty_reason": pc.if_else(pa.array(has_value), reasons, pa.scalar(None, pa.string()))}
