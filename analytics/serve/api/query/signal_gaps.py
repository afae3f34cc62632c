"""The ends of gaps to the sample, where buckets give them to a bucket: seconds with samples first, then samples."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from analytics.serve.api.rows import dictionaries
from storage.lake.tables import SAMPLES_FILE
from storage.sql.catalog import Catalog
from stream.batch import IntArray

Gap = tuple[int, int]

_NS = 10**9
MOST_EXACT = 50
_SECONDS = """
select bucket * 1000000000 as t_ns from internal.lake_rollup_1s
where filename in ({files}) and channel in ({channels}) and ({ranges})
"""
_SAMPLES = "select t_ns from read_parquet([{files}]) where channel in ({channels}) and ({ranges})"


def exact_gaps(
    views: Catalog, gaps: Sequence[Gap], bucket_ns: int, *, files: Callable[[str], str], channels: str,
    live_ns: IntArray, is_raw: bool,
) -> list[Gap]:  # fmt: skip
    """Gaps from the last sample before to the first after each; the first 50, and to the second where `is_raw` is not.

    Parameters
    ----------
    views : Catalog
        Of the lake.
    gaps : sequence of (int, int)
        In nanoseconds, from the end of a bucket with samples to the begin of the next one.
    bucket_ns : int
        Length of these buckets.
    files : callable
        Gives the files of a table that have the signal's rows, as a list in SQL.
    channels : str
        The signal's channels, as a list in SQL.
    live_ns : array
        Times of samples that the lake does not have yet, shape (n,).
    is_raw : bool
        Whether the lake has all samples.
    """
    chosen = list(gaps[:MOST_EXACT])

    def found(sql: str, table: str, ranges: Iterable[Gap], column: str) -> IntArray:
        texts = [f"({column} >= {first} and {column} < {stop})" for first, stop in sorted(set(ranges))]
        if not texts or not channels:
            return np.empty(0, np.int64)
        statement = sql.format(files=files(table), channels=channels, ranges=" or ".join(texts))
        return np.array([row["t_ns"] for row in dictionaries(views, statement)], np.int64)

    def ended(times_ns: IntArray, length_ns: int) -> list[Gap]:
        """The gaps between stretches with samples, which begin at these times."""
        times_ns = np.unique(np.concatenate([times_ns, live_ns // max(length_ns, 1) * max(length_ns, 1)]))
        result = []
        for first, stop in chosen:
            before = times_ns[(times_ns >= first - bucket_ns) & (times_ns < first)]
            after = times_ns[(times_ns >= stop) & (times_ns < stop + bucket_ns)]
            result.append((
                int(before[-1]) + length_ns if before.size else first, int(after[0]) if after.size else stop
            ))  # fmt: skip
        return result

    edges = [(first - bucket_ns, first) for first, _ in chosen] + [(stop, stop + bucket_ns) for _, stop in chosen]
    if bucket_ns > _NS:
        seconds = [(first // _NS, -(-stop // _NS)) for first, stop in edges]
        chosen = ended(found(_SECONDS, "rollup_1s.parquet", seconds, "bucket"), _NS)
        bucket_ns = _NS
    if is_raw:
        edges = [(first - bucket_ns, first) for first, _ in chosen] + [(stop, stop + bucket_ns) for _, stop in chosen]
        chosen = ended(found(_SAMPLES, SAMPLES_FILE, edges, "t_ns"), 0)
    return [*chosen, *gaps[MOST_EXACT:]]
