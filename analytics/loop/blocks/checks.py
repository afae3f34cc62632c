"""What looks wrong with the channels of a record: constant, copied, missing, or on another clock."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks, stands_still
from storage.sql.catalog import Catalog
from stream.batch import FloatArray

_COPY = 1.0 - 1e-9
_BY_NATURE = frozenset({"day", "time_since_power_on", "input_rate", "table_rate", "position"})
_DERIVED = frozenset({"table_acceleration", "position", "gravity_i", "day"})
_FEWEST_FOR_COPY = 10
_CLOCK_APART_S = 1.0


@dataclass(frozen=True)
class Note:
    """Something that was left out, supposed or looks wrong.

    Parameters
    ----------
    what: In one word, such as ``constant`` or ``copy``.
    text: As a sentence.
    channel: Which channel.
    runs: In which runs.
    is_limit: Whether it limits what can be concluded from the record.
    """

    what: str
    text: str
    channel: str | None = None
    runs: tuple[str, ...] = ()
    is_limit: bool = False


def in_runs(found: Sequence[str], of: int) -> str:
    """Say in which runs.

    Examples
    --------
    >>> in_runs(["r1"], 1), in_runs(["r1", "r2"], 9), in_runs(["r1", "r2"], 2)
    ('in run r1', 'in 2 of 9 runs (r1, r2)', 'in all 2 runs')
    """
    if len(found) == of:
        return f"in run {found[0]}" if of == 1 else f"in all {of} runs"
    listed = ", ".join(found[:3]) + (", ..." if len(found) > 3 else "")
    return f"in {len(found)} of {of} runs ({listed})"


def check_runs(runs: Sequence[RunBlocks]) -> list[Note]:
    """Notes on runs in which the signal stands still, and on runs that are copies of others."""
    notes = []
    still = [run.run for run in runs if len(run) > 1 and stands_still(run.value)]
    if still:
        text = (
            f"signal {runs[0].signal} never changes {in_runs(still, len(runs))}, as of an output that is dead or "
            "stuck: leave such runs out with --run"
        )
        notes.append(Note("still", text, runs=tuple(still), is_limit=True))
    first: dict[bytes, str] = {}
    same = [
        (earlier, run.run)
        for run in runs
        if len(run) >= _FEWEST_FOR_COPY and run.run not in still
        if (earlier := first.setdefault(run.value.tobytes(), run.run)) != run.run
    ]
    if same:
        listed = ", ".join(f"{one} and {other}" for one, other in same[:3]) + (", ..." if len(same) > 3 else "")
        text = (
            f"runs hold the same samples ({listed}): the one confirms nothing that the other says; leave one of each "
            "out with --run"
        )
        notes.append(Note("same_samples", text, is_limit=True))
    return notes


def check_channels(runs: Sequence[RunBlocks]) -> list[Note]:
    """Notes on channels that are constant, copies of each other, in counts, or missing at times.

    What that means for a verdict is said with the verdict.
    """
    names = sorted({name for run in runs for name in run.channels})
    return [
        *(note for name in names for note in _check_one(runs, name)),
        *_check_copies(runs, [name for name in names if name not in _constant(runs, names)]),
    ]


def _check_one(runs: Sequence[RunBlocks], name: str) -> list[Note]:
    having = [run for run in runs if name in run.channels]
    notes = []
    if len(having) < len(runs):
        missing = [run.run for run in runs if name not in run.channels]
        text = f"channel {name} is missing {in_runs(missing, len(runs))}: effects that need it are looked for nowhere"
        notes.append(Note("missing_channel", text, name, tuple(missing)))
    gaps = {run.run: int(np.isnan(run.mean(name)).sum()) for run in having}
    if gone := [run for run, blocks in gaps.items() if blocks]:
        blocks = sum(gaps.values())
        total = sum(len(run) for run in having)
        text = f"channel {name} has no reading near {blocks:,} of {total:,} blocks, {in_runs(gone, len(having))}"
        notes.append(Note("channel_gap", text, name, tuple(gone)))
    if name in _constant(having, [name]) and name not in _DERIVED:
        text = f"channel {name} never changes: what depends on it cannot be seen, nor told from the bias"
        notes.append(Note("constant", text, name, tuple(run.run for run in having)))
    units = sorted({run.channels[name].unit_of_measure for run in having})
    if len(units) > 1:
        text = f"channel {name} is in {' and '.join(units)}, depending on the run: import it in one unit of measure"
        notes.append(Note("mixed_units", text, name, is_limit=True))
    elif units[0] in {"count", "LSB"}:
        notes.append(Note("counts", f"channel {name} is in {units[0]}: coefficients are per {units[0]}", name))
    return notes


def _constant(runs: Sequence[RunBlocks], names: Sequence[str]) -> set[str]:
    found = set()
    for name in names:
        values = np.concatenate([run.mean(name) for run in runs if name in run.channels])
        values = values[np.isfinite(values)]
        if len(values) == 0 or float(np.ptp(values)) <= 1e-12 * float(np.abs(values).max()):
            found.add(name)
    return found


def _check_copies(runs: Sequence[RunBlocks], names: Sequence[str]) -> list[Note]:
    everywhere = [name for name in names if all(name in run.channels for run in runs)]
    values = {name: np.concatenate([run.mean(name) for run in runs]) for name in everywhere}
    notes = []
    for one, other in itertools.combinations(everywhere, 2):
        if _BY_NATURE.issuperset((one, other)):
            continue
        if _is_copy(values[one], values[other]):
            text = (
                f"channels {one} and {other} are copies of each other: an effect of one cannot be told from the other"
            )
            notes.append(Note("copy", text, other))
    return notes


def _is_copy(one: FloatArray, other: FloatArray) -> bool:
    both = np.isfinite(one) & np.isfinite(other)
    if both.sum() < _FEWEST_FOR_COPY or np.ptp(one[both]) == 0 or np.ptp(other[both]) == 0:
        return False
    with np.errstate(over="ignore", invalid="ignore"):  # numbers whose squares are none are refused later
        return abs(float(np.corrcoef(one[both], other[both])[0, 1])) > _COPY


def clock_offsets(catalog: Catalog) -> dict[tuple[str, str], dict[str, float]]:
    """Least delay of the messages of each unit in each run, seconds, by signal.

    Of what was imported, replayed or simulated faster than real time nothing can be told; it is not there.
    """
    found: dict[tuple[str, str], dict[str, float]] = {}
    sql = "select run, unit, signal, offset_least_ns / 1e9 from clocks where reason is null"
    for run, unit, signal, seconds in catalog.rows(sql):
        found.setdefault((str(run), str(unit)), {})[str(signal)] = float(seconds)
    return found


def check_clocks(
    offsets: Mapping[tuple[str, str], Mapping[str, float]],
    unit: str,
    signal: str,
    instruments: Sequence[tuple[str, str]],
) -> list[Note]:
    """Notes on runs in which the clock of a unit and that of an instrument are more than a second apart.

    Parameters
    ----------
    offsets: See `clock_offsets`.
    unit, signal: Whose clock is compared.
    instruments: With which.
    """
    apart: dict[str, dict[str, float]] = {}
    for run, instrument in instruments:
        own, other = offsets.get((run, unit), {}).get(signal), offsets.get((run, instrument))
        if own is None or not other:
            continue
        seconds = own - min(other.values())
        if abs(seconds) > _CLOCK_APART_S:
            apart.setdefault(instrument, {})[run] = seconds
    return [
        Note(
            "clock_offset",
            f"the clock of {instrument} is {_signed(list(by_run.values()))} s off that of {unit} in run "
            f"{', '.join(by_run)}: its channels are joined where their own clock puts them",
            runs=tuple(by_run),
            is_limit=True,
        )
        for instrument, by_run in sorted(apart.items())
    ]


def _signed(seconds: Sequence[float]) -> str:
    lo, hi = min(seconds), max(seconds)
    return f"{lo:+.1f}" if hi - lo < 0.1 else f"{lo:+.1f} to {hi:+.1f}"
