"""Which stored signals are the channels of a unit: its own, and those of the instruments that were in the run."""

from collections.abc import Collection, Sequence
from typing import NamedTuple

from analytics.loop.blocks.channels import standard_unit
from analytics.loop.blocks.checks import Note
from analytics.loop.blocks.run_blocks import STANDARD_CHANNELS
from analytics.loop.blocks.signal_axes import is_output
from storage.sql.catalog import Catalog

_SAME_INTERVAL, _SAME_MOMENT = 1e-3, 0.02


class Source(NamedTuple):
    """One stored signal of one run that is a channel.

    Parameters
    ----------
    name: Of the channel.
    unit, signal, run: What is stored.
    unit_of_measure: Of the stored values.
    interval_s: Between readings, seconds.
    samples, kept_raw: Readings, and how many of them are still there one by one.
    first_ns: Moment of the first one.
    """

    name: str
    unit: str
    signal: str
    run: str
    unit_of_measure: str
    interval_s: float
    samples: int
    kept_raw: int
    first_ns: int

    def is_in_step(self, interval_s: float, first_ns: int) -> bool:
        """Whether its readings are taken at the moments of a signal of this interval and first moment."""
        if not abs(self.interval_s - interval_s) <= _SAME_INTERVAL * interval_s or interval_s <= 0.0:
            return False
        apart = (self.first_ns - first_ns) / 1e9 / interval_s
        return abs(apart - round(apart)) <= _SAME_MOMENT

    @property
    def is_angle(self) -> bool:
        """Whether it is an angle, which may wrap."""
        return self.name.endswith("angle") and standard_unit(self.name, self.unit_of_measure)[0] == "deg"


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
) -> tuple[dict[str, list[Source]], list[Note]]:
    """Channels of each run, and what is to be said of them.

    Own signals come first. Every other unit of the run that neither has the signal nor was mounted as a unit under
    test is an instrument. What the unit itself measures beside the signal, its other rates, whatever they are called,
    and its accelerations, are outputs like the signal: they share its temperature and electronics, and are no channels
    unless they have a standard name or are among those `wanted`. Where several instruments give the same signal, the
    one that changes most has the name; of the others those that change are called ``INSTRUMENT.SIGNAL``.
    """
    found: dict[str, dict[str, list[Source]]] = {run: {} for run in runs}
    outputs: set[str] = set()
    for run, owner, name, unit_of_measure, interval_s, samples, kept_raw, first_ns in catalog.rows(
        _CANDIDATES, {"unit": unit, "signal": signal, "runs": list(runs)}
    ):
        if owner == unit and name not in (*STANDARD_CHANNELS, *wanted) and is_output(name, unit_of_measure):
            outputs.add(name)
            continue
        counts = int(samples), int(kept_raw), int(first_ns)
        source = Source(name, owner, name, run, unit_of_measure, float(interval_s), *counts)
        found[run].setdefault(name, []).append(source)
    notes = []
    if outputs:
        text = (
            f"{', '.join(sorted(outputs))} of {unit} are outputs of the unit like {signal}: not taken as channels; a "
            "reference is imported under a standard name, such as gravity_i"
        )
        notes.append(Note("output", text))
    chosen: dict[str, list[Source]] = {}
    several: dict[tuple[str, str], set[str]] = {}
    for run, by_name in found.items():
        chosen[run] = []
        for name, sources in by_name.items():
            own, others = _ordered(catalog, unit, sources)
            chosen[run].append(own)
            chosen[run].extend(other._replace(name=f"{other.unit}.{name}") for other in others)
            if len(sources) > 1:
                several.setdefault((name, own.unit), set()).update(each.unit for each in sources if each is not own)
    notes += [
        Note(
            "several",
            f"channel {name} is that of {of}; {', '.join(sorted(others))} give one of that name as well",
            name,
        )
        for (name, of), others in sorted(several.items())
    ]
    return chosen, notes


def _ordered(catalog: Catalog, unit: str, sources: Sequence[Source]) -> tuple[Source, list[Source]]:
    """The source that has the name, and others that change."""
    if len(sources) == 1:
        return sources[0], []
    spans = {each: _span(catalog, each) for each in sources}
    ordered = sorted(sources, key=lambda each: (each.unit != unit, -spans[each], each.unit))
    return ordered[0], [each for each in ordered[1:] if spans[each] > 0.0]


def _span(catalog: Catalog, source: Source) -> float:
    rows = catalog.rows(
        "select max(hi) - min(lo) from rollup_10s where unit = $unit and signal = $signal and run = $run",
        {"unit": source.unit, "signal": source.signal, "run": source.run},
    )
    return float(rows[0][0] or 0.0)
