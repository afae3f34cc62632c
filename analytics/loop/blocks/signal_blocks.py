"""Blocks of a stored signal, computed in SQL from the rollups, or from the samples where rollups do not fit."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from analytics.loop.blocks.run_blocks import SECOND_NS
from storage.sql.catalog import Catalog
from stream.batch import BoolArray, FloatArray, IntArray

LEAST_PAIRS = 8
FAR = 100.0  # an outlier leaves the readings of the seconds beside it by more than this many times their usual range
CALM = 0.1  # an outlier is not motion if the three readings on either side differ by less than this part of it
FEW, ALONE = 3.0, 0.6  # outliers of a second, at most, and the part by which one leaves the mean: motion has more
_PLAIN = ("mean", "spread", "centre_s", "first_s", "last_s", "far_reading")
_MEDIAN_OF_SQUARE = 0.4549364231195728  # of a standard normal


@dataclass(frozen=True)
class SignalBlocks:
    """A signal of one run in blocks, in its own unit; each shape (blocks,).

    Times are seconds from the start of slot 0; from rollups as of samples spread evenly from a whole second on.
    """

    slot: IntArray  # increasing numbers of the blocks
    n: IntArray  # samples in each
    mean: FloatArray
    spread: FloatArray  # standard deviation of the samples in each
    centre_s: FloatArray  # mean time of the samples
    first_s: FloatArray
    last_s: FloatArray
    white_variance: FloatArray  # of each mean, from the scatter within the block; NaN where unknown
    is_far: BoolArray  # whether the block contains an outlier, so that its mean is wrong
    far_reading: FloatArray  # that outlier, else NaN
    farthest: float = 0.0  # outlier of the run; 0 where there is none


@dataclass(frozen=True)
class Grid:
    """Blocks of a run: block b begins at t0_ns + b*block_ns; samples from first_ns to last_ns count."""

    t0_ns: int
    first_ns: int
    last_ns: int


_PIECES = {
    True: """
      select r.run, r.t_ns + 500000000 as t_ns, r.t_ns as start_ns, r.t_ns + 1000000000 * (r.n - 1) // r.n as end_ns,
        r.n, r.mean, r.m2, r.lo, r.hi, g.t0_ns
      from rollup_1s r join (select unnest($runs) as run, unnest($t0) as t0_ns, unnest($first) as first_ns,
        unnest($last) as last_ns) g on r.run = g.run
      where r.unit = $unit and r.signal = $signal and list_contains($runs, r.run)
        and r.t_ns + 1000000000 > g.first_ns and r.t_ns <= g.last_ns and $piece_ns > 0""",
    False: """
      select s.run, avg(s.t_ns - g.t0_ns)::bigint + any_value(g.t0_ns) as t_ns, min(s.t_ns) as start_ns,
        max(s.t_ns) as end_ns, count(*) as n, avg(s.value) as mean, var_pop(s.value) * count(*) as m2,
        min(s.value) as lo, max(s.value) as hi, any_value(g.t0_ns) as t0_ns
      from samples s join (select unnest($runs) as run, unnest($t0) as t0_ns, unnest($first) as first_ns,
        unnest($last) as last_ns) g on s.run = g.run
      where s.unit = $unit and s.signal = $signal and list_contains($runs, s.run)
        and s.t_ns between g.first_ns and g.last_ns and isfinite(s.value)
      group by s.run, (s.t_ns - g.t0_ns) // $piece_ns""",
}

# The white part from successive differences of the pieces: a drift within the block does not count.
_BLOCKS = """
with read as (
  {pieces}
), neighbours as (
  select *, mean - lag(mean) over own as move,
    hi - greatest(lag(hi) over own, lead(hi) over own) as above,
    least(lag(lo) over own, lead(lo) over own) - lo as below,
    greatest(max(hi) over before, max(hi) over after) - least(min(lo) over before, min(lo) over after) as unrest
  from read window own as (partition by run order by start_ns),
    before as (own rows between 3 preceding and 1 preceding),
    after as (own rows between 1 following and 3 following)
), beside as (
  select *, greatest(above, below) as beyond, case when above >= below then hi else lo end as extreme from neighbours
), usual as (
  select run, median(hi - lo) + median(abs(move)) as width, median(abs(move)) filter (move <> 0) as step
  from beside group by run
), piece as (
  select b.*, coalesce(
      beyond > $far * case when width > 0 then width else step end
      and case when n < 4 then coalesce(unrest, 0.0) <= $calm * beyond else abs(extreme - mean) >= $alone * beyond end
      and (n < 16 or m2 <= $few * (extreme - mean) ** 2),
      false) as is_far
  from beside b join usual u using (run)
), gone as (
  select run, arg_max(extreme, beyond) as farthest from piece where is_far group by run
), stepped as (
  select *, (start_ns - t0_ns) // $block_ns as slot,
    mean - lag(mean) over own as step, 1.0 / n + 1.0 / lag(n) over own as pair
  from piece window own as (partition by run, (start_ns - t0_ns) // $block_ns order by start_ns)
), block as (
  select run, slot, sum(n)::bigint as n, sum(n * mean) / sum(n) as mean,
    sqrt(sum(m2) / sum(n) + var_pop(mean)) as spread,
    sum(n * ((t_ns - t0_ns) / 1e9)) / sum(n) as centre_s,
    min(start_ns - t0_ns) / 1e9 as first_s, max(end_ns - t0_ns) / 1e9 as last_s,
    avg(step * step / pair) as sample_variance, count(step) as pairs, bool_or(is_far) as is_far,
    arg_max(extreme, beyond) filter (is_far) as far_reading
  from stepped group by run, slot
), typical as (
  select run, median(step * step / pair) as middle, avg(step * step / pair) as average from stepped group by run
)
select run, slot, n, mean, spread, centre_s, first_s, last_s, sample_variance, pairs, middle, average,
  is_far, far_reading, coalesce(farthest, 0.0) as farthest
from block join typical using (run) left join gone using (run) order by run, slot
"""


def block_means(
    catalog: Catalog, unit: str, signal: str, grids: Mapping[str, Grid], block_s: float, *, rolled_up: bool = True
) -> dict[str, SignalBlocks]:
    """Block means of a signal in several runs, by run; runs without any are not in the result.

    From the rollups where blocks are whole seconds, unless `rolled_up` is false: their times have an uncertainty of
    half a second, which is negligible only for a signal of several samples a second.

    A block consists of pieces: the rollup's seconds, or thirty-two parts of a block that is not in whole seconds.
    With pieces i of n_i samples and mean m_i, the variance of a sample is the mean over neighbours within the block of
    (m_i - m_j)**2/(1/n_i + 1/n_j), that of the block's mean is this divided by the samples in it. Noise that is white
    between pieces counts in full, slow change hardly at all. A block of fewer than 8 such pairs takes the median over
    its run (divided by 0.455, the median of the square of a normal deviate).

    A block is marked where a single reading of a piece leaves the pieces before and after it by more than a hundred
    times their usual range: a fill value, a transmission error, a shock. Longer events and motion have more readings in
    between; with one reading a piece, the pieces beside it move, too.
    """
    if not grids:
        return {}
    block_ns = round(block_s * SECOND_NS)
    runs = list(grids)
    whole = rolled_up and block_ns % SECOND_NS == 0 and all(grid.t0_ns % SECOND_NS == 0 for grid in grids.values())
    table = catalog.reader(
        _BLOCKS.format(pieces=_PIECES[whole]),
        {
            "unit": unit,
            "signal": signal,
            "runs": runs,
            "t0": [grids[run].t0_ns for run in runs],
            "first": [grids[run].first_ns for run in runs],
            "last": [grids[run].last_ns for run in runs],
            "block_ns": block_ns,
            "piece_ns": max(1, block_ns // 32),
            "far": FAR,
            "calm": CALM,
            "few": FEW,
            "alone": ALONE,
        },
    ).read_all()
    names = np.array(table.column("run").to_pylist(), dtype=object)
    columns = {name: table.column(name).to_numpy() for name in table.column_names if name != "run"}
    found = {}
    for run in runs:
        rows = names == run
        if rows.any():
            found[run] = _blocks({name: column[rows] for name, column in columns.items()})
    return found


def _blocks(columns: Mapping[str, FloatArray]) -> SignalBlocks:
    n = columns["n"].astype(np.int64)
    middle, average = float(columns["middle"][0] or 0.0), float(columns["average"][0] or 0.0)
    typical = middle / _MEDIAN_OF_SQUARE if middle > 0 else average
    pairs, own = columns["pairs"], columns["sample_variance"].astype(np.float64)
    variance = np.where(pairs >= LEAST_PAIRS, own, typical if typical > 0 else np.nan)
    return SignalBlocks(
        slot=columns["slot"].astype(np.int64),
        n=n,
        white_variance=variance / n,
        is_far=columns["is_far"].astype(np.bool_),
        farthest=float(columns["farthest"][0]),
        **{name: columns[name].astype(np.float64) for name in _PLAIN},
    )
