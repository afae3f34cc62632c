"""What a store has of a signal, run by run, and the grids that its blocks lie on."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from analytics.loop.blocks.means import SECOND_NS, Grid
from storage.sql.catalog import Catalog
from storage.sql.reading import find_signal
from stream.errors import BadInput, NotFound
from stream.quantities import report_unit

FAR_NS = 2**62
_FAST_S = 0.5
_SAME = 1.05


class Record(NamedTuple):
    """A signal of one run; `run_first_ns` is its first moment of any unit in the run."""

    first_ns: int
    last_ns: int
    samples: int
    kept_raw: int
    interval_s: float
    unit_of_measure: str
    is_date_known: bool
    run_first_ns: int

    def grid(self, since_ns: int | None, until_ns: int | None) -> Grid:
        """Blocks from a whole second on, the same for all units of the run."""
        return Grid(
            self.run_first_ns // SECOND_NS * SECOND_NS,
            -FAR_NS if since_ns is None else since_ns,
            FAR_NS if until_ns is None else until_ns,
        )


def is_rolled_up(interval_s: float, samples: int, kept_raw: int) -> bool:
    """Whether the rollups serve: several samples a second, or nothing else is left.

    Examples
    --------
    >>> is_rolled_up(0.01, 100, 100), is_rolled_up(60.0, 10, 10), is_rolled_up(60.0, 10, 0)
    (True, False, True)
    """
    return interval_s <= _FAST_S or kept_raw < samples


def records_of(catalog: Catalog, unit: str, signal: str, runs: Iterable[str] | None) -> dict[str, Record]:
    """Records of a signal by run, in the order of time.

    Raises
    ------
    NotFound: If the store does not have the signal, or not one of the runs that were named.
    BadInput: If the runs have it in units of measure that cannot be brought together.
    """
    rows = catalog.rows(
        "select s.run, s.t_first_ns, s.t_last_ns, s.samples, s.kept_raw, coalesce(s.sample_interval_s, 0), "
        "s.unit_of_measure, coalesce(r.date_known, true), "
        "(select min(o.t_first_ns) from signals o where o.run = s.run and o.signal = s.signal) "
        "from signals s left join runs r using (run) where s.unit = $unit and s.signal = $signal "
        "order by s.t_first_ns, s.run",
        {"unit": unit, "signal": signal},
    )
    if not rows:
        find_signal(catalog, unit, signal)  # says what there is
    records = {str(run): Record(*each) for run, *each in rows}
    wanted = set(records) if runs is None else set(runs)
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
    """Length of a block that suits units: the least, or the interval of the samples of most runs if that is longer."""
    rows = catalog.rows(
        "select median(sample_interval_s) from signals where list_contains($units, unit) and signal = $signal "
        "and ($runs is null or list_contains($runs, run))",
        {"units": list(units), "signal": signal, "runs": None if runs is None else list(runs)},
    )
    interval_s = float(rows[0][0] or 0.0)
    return interval_s if interval_s > _SAME * least_s else least_s


def reach(records: Mapping[str, Record]) -> str:
    """From when to when there are samples."""
    first_ns, last_ns = min(each.first_ns for each in records.values()), max(each.last_ns for each in records.values())
    return f"from {_moment(first_ns)} to {_moment(last_ns)}"


def _moment(t_ns: int) -> str:
    return f"{np.datetime64(t_ns, 'ns').astype('datetime64[s]')}Z"
