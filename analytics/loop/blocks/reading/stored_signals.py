"""What a store has for a reduction: the runs of a signal, and the stored signals that are its channels."""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.notes.reduction_notes import OUTPUT, Note
from analytics.loop.blocks.pieces import Grid, SignalKey
from analytics.loop.blocks.reading.channels import standard_unit
from analytics.loop.blocks.run_blocks import SECOND_NS
from storage.sql.catalog import Catalog
from storage.sql.reading import excluded_runs, find_signal, format_excluded
from stream.channel_names import STANDARD_CHANNELS
from stream.errors import BadInput, NotFound, UnknownUnit
from stream.quantities import conversion, is_angular_rate, report_unit

FAR_NS = 2**62
REFERENCE_RATES = ("input_rate", "table_rate")
_FAST_S = 0.5
_SAME = 1.05
_SAME_INTERVAL, _SAME_MOMENT = 1e-3, 0.02
_SPAN = """
select max(hi) - min(lo) from internal.rollup_10s_in($paths) where unit = $unit and signal = $signal and run = $run
"""
_REFERENCE = re.compile(r"table|stage|fixture|reference|command|set_?point|input|(?:^|_)ref(?:_|$)")


class RecordedSignal(NamedTuple):
    """The reduced signal in one run; `run_first_ns` is its first sample of any unit in the run."""

    first_ns: int
    last_ns: int
    samples: int
    kept_raw: int
    interval_s: float
    unit_of_measure: str
    is_date_known: bool
    irregular: bool
    run_first_ns: int

    @property
    def is_rolled_up(self) -> bool:
        """Whether it is read from rollups: several samples a second, or raw samples were dropped."""
        return is_rolled_up(self.interval_s, self.samples, self.kept_raw)

    @property
    def rows(self) -> float:
        """Rows that are read of it: seconds of a rollup, or samples."""
        return (self.last_ns - self.first_ns) / SECOND_NS if self.is_rolled_up else self.samples

    def grid(self, since_ns: int | None, until_ns: int | None) -> Grid:
        """Blocks from a whole second on, the same for all units of the run."""
        return Grid(
            self.run_first_ns // SECOND_NS * SECOND_NS,
            -FAR_NS if since_ns is None else since_ns,
            FAR_NS if until_ns is None else until_ns,
        )


class ChannelSource(NamedTuple):
    """A stored signal of one run that is the channel `name`; `kept_raw` readings are still stored one by one."""

    name: str
    unit: str
    signal: str
    run: str
    unit_of_measure: str
    interval_s: float
    samples: int
    kept_raw: int
    first_ns: int

    @property
    def key(self) -> SignalKey:
        """Its unit, signal and run."""
        return SignalKey(self.unit, self.signal, self.run)

    def is_in_step(self, interval_s: float, first_ns: int) -> bool:
        """Whether its readings are taken at the times of a signal of this interval and first sample."""
        if not abs(self.interval_s - interval_s) <= _SAME_INTERVAL * interval_s or interval_s <= 0.0:
            return False
        apart = (self.first_ns - first_ns) / 1e9 / interval_s
        return abs(apart - round(apart)) <= _SAME_MOMENT

    @property
    def is_angle(self) -> bool:
        """Whether it is an angle, which may wrap."""
        return self.name.endswith("angle") and standard_unit(self.name, self.unit_of_measure)[0] == "deg"

    @property
    def is_rolled_up(self) -> bool:
        """Whether it is read from rollups, see `RecordedSignal`."""
        return is_rolled_up(self.interval_s, self.samples, self.kept_raw)

    @property
    def rows(self) -> float:
        """Rows that are read of it: seconds of a rollup, or samples."""
        return self.samples * min(self.interval_s, 1.0) if self.is_rolled_up else self.samples


def is_rolled_up(interval_s: float, samples: int, kept_raw: int) -> bool:
    """Whether to read rollups: several samples a second, or raw samples were dropped.

    >>> is_rolled_up(0.01, 100, 100), is_rolled_up(60.0, 10, 10), is_rolled_up(60.0, 10, 0)
    (True, False, True)
    """
    return interval_s <= _FAST_S or kept_raw < samples


def records_of(catalog: Catalog, unit: str, signal: str, runs: Iterable[str] | None) -> dict[str, RecordedSignal]:
    """Records of a signal by run, in the order of time."""
    rows = catalog.rows(
        "select s.run, s.t_first_ns, s.t_last_ns, s.samples, s.kept_raw, coalesce(s.sample_interval_s, 0), "
        "s.unit_of_measure, coalesce(r.date_known, true), s.irregular, "
        "(select min(o.t_first_ns) from signals o where o.run = s.run and o.signal = s.signal) "
        "from signals s left join runs r using (run) where s.unit = $unit and s.signal = $signal "
        "order by s.t_first_ns, s.run",
        {"unit": unit, "signal": signal},
    )
    if not rows:
        find_signal(catalog, unit, signal)  # raises with what there is
    records = {str(run): RecordedSignal(*each) for run, *each in rows}
    excluded = excluded_runs(catalog, unit) if runs is None else {}
    wanted = records.keys() - excluded.keys() if runs is None else set(runs)
    if not wanted:
        raise NotFound(
            f"unit {unit}, signal {signal}: every run is excluded from evaluation: {format_excluded(excluded)}; name "
            "runs, or include one again with `gyrofleet runs include`"
        )
    if strangers := sorted(wanted - set(records)):
        raise NotFound(
            f"unit {unit}, signal {signal}: no run {', '.join(strangers)}; it has {', '.join(sorted(records))}"
        )
    records = {run: each for run, each in records.items() if run in wanted}
    units = sorted({report_unit(each.unit_of_measure)[0] for each in records.values()})
    if len(units) > 1:
        raise BadInput(
            f"unit {unit}, signal {signal}: runs are in {' and '.join(units)}, which cannot be brought together; name "
            "runs of one unit of measure"
        )
    return records


def usual_block_s(
    catalog: Catalog, units: Sequence[str], signal: str, runs: Collection[str] | None, least_s: float
) -> float:
    """Default length of a block: the least, or the median interval between samples if that is longer."""
    rows = catalog.rows(
        "select median(sample_interval_s) from signals s left join exclusions x using (unit, run) "
        "where list_contains($units, unit) and signal = $signal "
        "and case when $runs is null then x.run is null else list_contains($runs, run) end",
        {"units": list(units), "signal": signal, "runs": None if runs is None else list(runs)},
    )
    interval_s = float(rows[0][0] or 0.0)
    return interval_s if interval_s > _SAME * least_s else least_s


def reach(records: Mapping[str, RecordedSignal]) -> str:
    """Time range of the samples, as text."""
    times_ns = min(each.first_ns for each in records.values()), max(each.last_ns for each in records.values())
    return "from {}Z to {}Z".format(*(np.datetime64(t_ns, "ns").astype("datetime64[s]") for t_ns in times_ns))


def is_output(signal: str, unit_of_measure: str) -> bool:
    """Whether a signal of a unit under test is an inertial output of it, not a reference.

    Angular rates of one device are the axes of one triad, whatever their names; so are its accelerations. A rate named
    after a table, a reference, a command or an input is not an output.

    >>> is_output("angularratey", "deg/s"), is_output("acc_x", "m/s^2"), is_output("table_speed", "deg/s")
    (True, True, False)
    """
    if is_angular_rate(unit_of_measure):
        return _REFERENCE.search(signal.lower()) is None
    try:
        conversion(unit_of_measure, "m/s^2")
    except UnknownUnit:
        return False
    return True


_CANDIDATES = """
select c.run, c.unit, c.signal, c.unit_of_measure, coalesce(c.sample_interval_s, 0), c.samples, c.kept_raw, c.t_first_ns
from signals c
where list_contains($runs, c.run) and not (c.unit = $unit and c.signal = $signal)
  and (c.unit = $unit or not exists (
    select 1 from signals t where t.run = c.run and t.unit = c.unit and t.signal = $signal))
  and (c.unit = $unit or not exists (select 1 from units u where u.run = c.run and u.unit = c.unit))
order by c.run, c.unit <> $unit, c.unit, c.signal
"""


def sources_of(
    catalog: Catalog, unit: str, signal: str, runs: Sequence[str], wanted: Collection[str] = ()
) -> tuple[dict[str, list[ChannelSource]], list[Note]]:
    """Channels of each run, and notes on them.

    Own signals come first. Every other unit of the run that neither has the signal nor was mounted as a unit under
    test is an instrument. Outputs of the unit beside the signal, see `is_output`, share its temperature and electronics
    and are not channels unless they have a standard name or are among those `wanted`. Where several instruments give
    the same signal, the one that changes most has the name; the others that change are ``INSTRUMENT.SIGNAL``.
    """
    found: dict[str, dict[str, list[ChannelSource]]] = {run: {} for run in runs}
    outputs: set[str] = set()
    for run, owner, name, unit_of_measure, interval_s, samples, kept_raw, first_ns in catalog.rows(
        _CANDIDATES, {"unit": unit, "signal": signal, "runs": list(runs)}
    ):
        if owner == unit and name not in (*STANDARD_CHANNELS, *wanted) and is_output(name, unit_of_measure):
            outputs.add(name)
            continue
        counts = int(samples), int(kept_raw), int(first_ns)
        source = ChannelSource(name, owner, name, run, unit_of_measure, float(interval_s), *counts)
        found[run].setdefault(name, []).append(source)
    notes = []
    if outputs:
        names = ", ".join(sorted(outputs))
        text = Bilingual(
            f"{names} of {unit} are outputs like {signal} and not channels; import a reference under a standard name, "
            "such as gravity_i",
            f"{unit}的{names}与{signal}同为产品输出，不作为通道；参考量请以标准名导入，如gravity_i",
        )
        notes.append(Note(OUTPUT, text))
    chosen: dict[str, list[ChannelSource]] = {}
    several: dict[tuple[str, str], set[str]] = {}
    for run, by_name in found.items():
        chosen[run] = []
        for name, sources in by_name.items():
            own, others = _ordered(catalog, unit, sources)
            chosen[run] += [own, *(other._replace(name=f"{other.unit}.{name}") for other in others)]
            if len(sources) > 1:
                several.setdefault((name, own.unit), set()).update(each.unit for each in sources if each is not own)
    for (name, of), others_of in sorted(several.items()):
        others_text = ", ".join(sorted(others_of))
        text = Bilingual(
            f"channel {name} is taken from {of}; {others_text} have a channel of that name as well",
            f"通道{name}取自{of}；{others_text}也有同名通道",
        )
        notes.append(Note("several", text, name))
    return chosen, notes


def _ordered(
    catalog: Catalog, unit: str, sources: Sequence[ChannelSource]
) -> tuple[ChannelSource, list[ChannelSource]]:
    """The source that has the name, and others that change."""
    if len(sources) == 1:
        return sources[0], []
    spans = {each: _span(catalog, each) for each in sources}
    ordered = sorted(sources, key=lambda each: (each.unit != unit, -spans[each], each.unit))
    return ordered[0], [each for each in ordered[1:] if spans[each] > 0.0]


def _span(catalog: Catalog, source: ChannelSource) -> float:
    given = {"unit": source.unit, "signal": source.signal, "run": source.run}
    rows = catalog.rows(_SPAN, {"paths": catalog.checked_paths_of([source.run], _SPAN), **given})
    return float(rows[0][0] or 0.0)
