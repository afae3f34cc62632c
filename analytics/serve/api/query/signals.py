"""Samples of a signal for a picture: minimum, maximum and mean of buckets, from the rollups or the samples."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from analytics.serve.api.operation import Call, get
from analytics.serve.api.query.buckets import NO_BUCKETS, Buckets, samples_in_order
from analytics.serve.api.query.recorded_signals import recorded_signal
from analytics.serve.api.query.signal_gaps import exact_gaps
from analytics.serve.api.rows import iso, moment
from analytics.serve.live.tail import LiveSamples
from storage.lake.tables import SAMPLES_FILE
from storage.sql.lake_source import LakeSource
from storage.sql.reading import find_signal, rows_between
from stream.batch import FloatArray, IntArray
from stream.errors import BadInput
from stream.events import RunStarted

_NS = 10**9
_MOST_RAW = 6_000_000
_QUICK_RAW = 250_000  # read in less than 50 ms
_GAP_INTERVALS = 1.5
_ROLLUP = ("bucket", "n", "mean", "lo", "hi")


class SignalAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which stretch: moments as ns or ISO 8601 with a zone, the whole record by default; and how many points."""

    from_: str | None = msgspec.field(default=None, name="from")
    to: str | None = None
    points: Annotated[int, msgspec.Meta(ge=2, le=10_000, description="Buckets, at most.")] = 1000


class SignalBuckets(msgspec.Struct, frozen=True, kw_only=True):
    """A stretch of a signal.

    Bucket i begins at ``t_ns[i]`` and is `bucket_ns` long; buckets without samples are left out. `source` says what
    they are made of: ``rollup_10s``, ``rollup_1s``, ``raw`` (all samples), or ``samples``: then each is one sample and
    `bucket_ns` is 0. Buckets of rollups are whole: the first may begin before the stretch and the last end after it;
    all of them together, and `samples`, are of `covers_from_ns` to `covers_to_ns`. Others have samples of the stretch
    only. Every sample is in its bucket's min and max. `gaps` are stretches within the record and what was asked that
    have no samples for longer than 1.5 intervals and leave a whole bucket empty, also where the stretch begins or ends
    in one; the first 50 are from the last sample before to the first after it. Fewer points hide shorter ones.
    Values are in `unit_of_measure`. `is_live`: some samples have not come to the lake yet, so that the record probably
    goes on.
    """

    unit: str
    run: str
    signal: str
    unit_of_measure: str
    source: str
    bucket_ns: int
    from_ns: int
    to_ns: int
    covers_from_ns: int
    covers_to_ns: int
    t_ns: list[int]
    min: list[float]
    max: list[float]
    mean: list[float]
    n: list[int]
    gaps: list[tuple[int, int]]
    samples: int
    sample_interval_s: float
    date_known: bool
    first_ns: int
    last_ns: int
    first: str | None
    last: str | None
    note: str | None = None
    is_live: bool = False

    def columns(self) -> Mapping[str, Sequence[Any]]:
        """Its table, for Arrow and CSV."""
        columns = {name: getattr(self, name) for name in ("t_ns", "min", "max", "mean", "n")}
        return {"time": [iso(each) for each in self.t_ns], **columns}

    def column_types(self) -> Mapping[str, type]:
        """What the values of its table are."""
        return {"time": str, "t_ns": int, "min": float, "max": float, "mean": float, "n": int}


@dataclass(frozen=True)
class _Stretch:
    """What is asked of a record, and the parts of the lake that have it."""

    first_ns: int
    stop_ns: int
    points: int
    all_parts: list[dict[str, Any]]
    live: LiveSamples | None = None

    def parts_between(self, first_ns: int, stop_ns: int) -> list[dict[str, Any]]:
        """Those with samples in a stretch."""
        return [part for part in self.all_parts if part["t_last_ns"] >= first_ns and part["t_first_ns"] < stop_ns]

    @cached_property
    def parts(self) -> list[dict[str, Any]]:
        """Those with samples of what is asked."""
        return self.parts_between(self.first_ns, self.stop_ns)

    @property
    def live_times(self) -> IntArray:
        """Times of the samples that the lake does not have yet, shape (n,)."""
        return np.empty(0, np.int64) if self.live is None else self.live.t_ns

    @property
    def live_values(self) -> FloatArray:
        """Their values, shape (n,)."""
        return np.empty(0) if self.live is None else self.live.values

    @property
    def width_ns(self) -> int:
        """Length of a bucket so that no more than `points` touch the stretch."""
        return max(-(-(self.stop_ns - self.first_ns) // (self.points - 1)), 1)

    @property
    def channels(self) -> str:
        """Channels as a list in SQL."""
        return ", ".join(str(each) for each in sorted({part["channel"] for part in self.parts}))

    def files(self, table: str) -> str:
        """Files of a table that have its rows, as a list in SQL."""
        paths = {str(Path(part["filename"]).with_name(table)) for part in self.parts}
        return ", ".join("'" + path.replace("'", "''") + "'" for path in sorted(paths))

    @property
    def raw_samples(self) -> float:
        """About how many samples it has."""
        return self.live_times.size + sum(int(part["samples"]) * self._share(part) for part in self.parts)

    @property
    def is_raw(self) -> bool:
        """Whether its raw rows are all there."""
        return all(part["is_kept"] for part in self.parts)

    def _share(self, part: Mapping[str, Any]) -> float:
        first, last = int(part["t_first_ns"]), int(part["t_last_ns"])
        inside = min(last, self.stop_ns) - max(first, self.first_ns)
        return max(inside, 0) / max(last - first, 1)


@get("/api/signals/{unit}/{run}/{signal}", table="", is_live=True)
def signal(call: Call, asked: SignalAsked) -> SignalBuckets:
    """A stretch of a signal in buckets with least, greatest and mean value; a single outlier is in it at any width."""
    views, path = call.views, call.path
    of = {name: path[name] for name in ("unit", "signal", "run")}
    name = (of["unit"], of["run"], of["signal"])
    live = call.service.live.tail.samples(name, call.state.segments)
    recorded = recorded_signal(call, of["unit"], of["signal"], of["run"])
    if recorded.about is None and live is None:
        find_signal(views, of["unit"], of["signal"], of["run"])  # NotFound lists what there is
    about = recorded.about or {"date_known": _is_dated(call, of["run"])}
    about = _with_live(about, live)
    first_ns = moment(asked.from_, "from")
    stop_ns = moment(asked.to, "to")
    first_ns = about["t_first_ns"] if first_ns is None else first_ns
    stop_ns = about["t_last_ns"] + 1 if stop_ns is None else stop_ns
    if stop_ns <= first_ns:
        begin, end = asked.from_ or f"the first sample, {iso(first_ns)}", asked.to or f"the last, {iso(stop_ns - 1)}"
        raise BadInput(f"the stretch ends ({end}) before it begins ({begin})")
    interval_s = float(about["sample_interval_s"])
    stretch = _Stretch(first_ns, stop_ns, asked.points, recorded.parts, live)
    source, bucket_ns, buckets, note = _buckets(views.source, stretch)
    t_ns = buckets.slot.tolist()
    ends = (t_ns[0], t_ns[-1] + bucket_ns) if source.startswith("rollup") and t_ns else (first_ns, stop_ns)
    within = max(first_ns, about["t_first_ns"]), min(stop_ns, about["t_last_ns"] + 1)
    longest_ns = max(bucket_ns, 0 if about["irregular"] else _GAP_INTERVALS * interval_s * _NS)
    gaps = [] if about["irregular"] and not bucket_ns else _gaps(t_ns, bucket_ns, longest_ns, within)
    if gaps and bucket_ns:
        gaps = exact_gaps(
            views, gaps, bucket_ns, files=stretch.files, channels=stretch.channels, live_ns=stretch.live_times,
            is_raw=stretch.is_raw,
        )  # fmt: skip
        gaps = [(max(first, within[0]), min(last, within[1])) for first, last in gaps]
    return SignalBuckets(
        **of, unit_of_measure=about["unit_of_measure"], source=source, bucket_ns=bucket_ns, from_ns=first_ns,
        to_ns=stop_ns, covers_from_ns=min(first_ns, ends[0]), covers_to_ns=max(stop_ns, ends[1]), t_ns=t_ns,
        min=buckets.lo.tolist(), max=buckets.hi.tolist(), mean=buckets.mean.tolist(), n=buckets.n.tolist(), gaps=gaps,
        samples=int(buckets.n.sum()), sample_interval_s=interval_s, date_known=about["date_known"],
        first_ns=about["t_first_ns"], last_ns=about["t_last_ns"], first=iso(about["t_first_ns"]),
        last=iso(about["t_last_ns"]), note=note, is_live=live is not None,
    )  # fmt: skip


def _is_dated(call: Call, run: str) -> bool:
    """Whether the times of a run are dates, by its documents that the lake does not have yet."""
    received = call.service.live.course.received(run, call.state.segments)
    return all(each.document.date_known for each in received if isinstance(each.document, RunStarted))


def _with_live(about: Mapping[str, Any], live: LiveSamples | None) -> Mapping[str, Any]:
    """What is known of the signal, with the samples that the lake does not have yet."""
    if live is None:
        return about
    of_live = {
        "unit_of_measure": live.unit_of_measure, "irregular": live.irregular,
        "sample_interval_s": live.sample_interval_s,
    }  # fmt: skip
    return of_live | {
        **about,
        "t_first_ns": min(about.get("t_first_ns", live.first_ns), live.first_ns),
        "t_last_ns": max(about.get("t_last_ns", live.last_ns), live.last_ns),
    }


def _buckets(source: LakeSource, of: _Stretch) -> tuple[str, int, Buckets, str | None]:
    """Source, length and the buckets, and a note where raw samples are missing."""
    if not of.parts and not of.live_times.size:
        return "samples", 0, NO_BUCKETS, None
    note = None
    # buckets of 1 s in place of 0.5 to 1 s, where that many samples would be read for them
    if of.width_ns < _NS and of.raw_samples <= (_MOST_RAW if of.width_ns < _NS / 2 else _QUICK_RAW):
        if of.is_raw:
            return *_of_samples(source, of), None
        note = "raw samples of this stretch were dropped to make room: buckets of 1 s are the finest that is kept"
    seconds = 10 if of.width_ns >= 10 * _NS else 1
    k = max(-(-of.width_ns // (seconds * _NS)), 1)
    width = k * seconds * _NS
    # whole buckets, also where the stretch begins or ends in one
    first, stop = of.first_ns // width * width, -(-of.stop_ns // width) * width
    name = f"rollup_{seconds}s"
    slots = first // (seconds * _NS), stop // (seconds * _NS)
    found = []
    for part in of.parts_between(first, stop):
        path = str(Path(part["filename"]).with_name(f"{name}.parquet"))
        bucket, *columns = rows_between(source, path, part["channel"], "bucket", slots, _ROLLUP)
        found.append(Buckets.of_rows(bucket // k * width, *columns))
    live = Buckets.of_samples(of.live_times, of.live_values, width).between(first, stop)
    return name, width, Buckets.together([*found, live]), note


def _of_samples(source: LakeSource, of: _Stretch) -> tuple[str, int, Buckets]:
    found = [(of.live_times, of.live_values)]
    for part in of.parts:
        path = str(Path(part["filename"]).with_name(SAMPLES_FILE))
        columns = ("t_ns", "base", "above") if part["is_counts"] else ("t_ns", "value")
        t_ns, *data = rows_between(source, path, part["channel"], "t_ns", (of.first_ns, of.stop_ns), columns)
        value = (data[0] + data[1]) * part["scale"] + part["offset"] if part["is_counts"] else data[0]
        found.append((t_ns, value))
    t_ns, values = samples_in_order(found)
    inside = (t_ns >= of.first_ns) & (t_ns < of.stop_ns)
    t_ns, values = t_ns[inside], values[inside]
    if t_ns.size > of.points:
        return "raw", of.width_ns, Buckets.of_samples(t_ns, values, of.width_ns)
    return "samples", 0, Buckets(t_ns, np.ones(t_ns.size, np.int64), values, values, values)


def _gaps(t_ns: Sequence[int], bucket_ns: int, longest_ns: float, within: tuple[int, int]) -> list[tuple[int, int]]:
    """Stretches without samples, from the end of a bucket to the begin of the next, and at the ends of what is asked.

    >>> _gaps([0, 10, 50], 10, 10.0, (0, 90)), _gaps([], 10, 10.0, (20, 50)), _gaps([20], 0, 15.0, (0, 30))
    ([(20, 50), (60, 90)], [(20, 50)], [(0, 20)])
    """
    first_ns, stop_ns = within
    if not t_ns:
        return [within] if stop_ns - first_ns > longest_ns - bucket_ns else []
    gaps = [(before + bucket_ns, after) for before, after in itertools.pairwise(t_ns) if after - before > longest_ns]
    if t_ns[0] - first_ns > longest_ns:
        gaps.insert(0, (first_ns, t_ns[0]))
    if stop_ns - (t_ns[-1] + bucket_ns) > longest_ns:
        gaps.append((t_ns[-1] + bucket_ns, stop_ns))
    return gaps
