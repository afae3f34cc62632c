"""Lakes of large fleets, written part by part in the lake's own format, without a log before them.

Documents, channels, samples and rollups are those that a recorder and the builder of the lake would have left there.
"""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from unittest.mock import patch
from uuid import UUID

import msgspec
import numpy as np
import pyarrow as pa

from analytics.step_records import step_table
from analytics.step_records.reduction import COLUMNS
from analytics.step_records.series_statistics import SeriesStatistics, series_statistics
from storage.lake.buffered_rows import buffered_rows
from storage.lake.builder import builder_lock
from storage.lake.channel_buffer import ChannelBuffer
from storage.lake.drops import Drops
from storage.lake.lake import Lake
from storage.lake.part import BuiltPart
from storage.lake.rollups import rollup_tables
from storage.lake.segment_content import channel_id
from storage.lake.tables import CHANNEL_COLUMNS, EVENT_COLUMNS, part_writers
from storage.manifests.part import Part, PartFile, write_part
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.batch import SampleBatch
from stream.events import AnyDocument, PowerOn, RunStarted, StepEnded, StepStarted, StepWords, UnitMounted
from stream.identity import Place, sample_key
from stream.wire.batches import encode_batch, read_raw_batch

PLACE = Place("plant", "chamber-1")
SECOND_NS = 10**9
DAY_NS = 86_400 * SECOND_NS
START_NS = 1_763_683_200 * SECOND_NS  # 2025-11-21 00:00 UTC
HOUR_S = 3600
TEMPERATURES = (20.0, -40.0, 0.0, 40.0, 70.0)
# hours whose statistics are computed sample by sample; the fleet's hours take turns
_POOL = 200


def unit_names(units: int) -> list[str]:
    return [f"FOG-{number:05d}" for number in range(units)]


def hours_of_noise(rng: np.random.Generator, count: int, noise: float, walk: float) -> list[SeriesStatistics]:
    """Statistics of hours of a signal of mean 0 from its means of 1 s: white noise of 100 Hz and a walk."""
    t_ns = np.arange(HOUR_S) * SECOND_NS
    n = np.full(HOUR_S, 100)
    return [
        series_statistics(
            t_ns,
            n,
            rng.normal(0, noise / 10, HOUR_S) + np.cumsum(rng.normal(0, walk, HOUR_S)),
            noise**2 * rng.chisquare(99, HOUR_S),
            base_ns=SECOND_NS,
            samples_per_block=100.0,
            window_ns=(0, (HOUR_S - 1) * SECOND_NS),
        )
        for _ in range(count)
    ]


class Fleet:
    """Units that are powered on for an hour every day, and once measured at five temperatures.

    Parameters
    ----------
    folder : Path
        Of the store that is made.
    units, days : int
        How many.
    """

    def __init__(self, folder: Path, units: int, days: int) -> None:
        self.store = Store.create(folder)
        self.units = unit_names(units)
        self.days = days
        self._rng = np.random.default_rng(1)
        self._bias = self._rng.normal(0, 1.0, units)
        self._slope = self._rng.normal(0, 0.01, units)
        self._uid = 0

    def write(self) -> None:
        """Write the lake and the records of its steps."""
        rate, temperature = hours_of_noise(self._rng, _POOL, 3.0, 0.0005), hours_of_noise(self._rng, _POOL, 0.05, 1e-4)
        reduced: dict[str, pa.Table] = {}
        for number, (run, procedure, temperatures) in enumerate(self._runs()):
            t0_ns = START_NS + number * DAY_NS
            documents = self._documents(run, procedure, temperatures, t0_ns)
            with builder_lock(self.store):
                put_part(self.store, number + 1, documents, self._channels(run, len(temperatures), t0_ns))
            reduced[run] = self._reduced(run, temperatures, t0_ns, rate, temperature)
        # the records are made by the code that makes them, from numbers that are had without 1e8 rows of seconds
        with (
            patch.object(step_table, "reduce_runs", lambda _, runs: ((1, reduced[run]) for run in runs)),
            Catalog(self.store) as catalog,
        ):
            step_table.step_means(catalog)

    def _runs(self) -> Iterator[tuple[str, str, Sequence[float]]]:
        for day in range(self.days):
            yield f"day-{day:02d}", "static_bias", (20.0,)
        yield "temperatures", "bias_temperature_sensitivity", TEMPERATURES

    def _name(self) -> str:
        self._uid += 1
        return f"{self._uid:012x}"

    def _documents(self, run: str, procedure: str, temperatures: Sequence[float], t0_ns: int) -> Iterator[AnyDocument]:
        details = {"time_zone": "UTC", "latitude_deg": "40.0"}
        yield RunStarted(run=run, t_ns=t0_ns, uid=self._name(), procedure=procedure, details=details)
        for number, unit in enumerate(self.units):
            lot = f"lot-{number // 50:03d}"
            yield UnitMounted(run=run, t_ns=t0_ns, uid=self._name(), unit=unit, product="FOG-70", lot=lot)
            yield PowerOn(run=run, t_ns=t0_ns, uid=self._name(), unit=unit, epoch=str(epoch_of(run, number)))
            for step, degrees in enumerate(temperatures):
                begin_ns = t0_ns + step * HOUR_S * SECOND_NS
                words = StepWords(
                    procedure=procedure, position="IRA_up", temperature_command_deg_c=degrees, room=degrees == 20.0
                )
                begun = StepStarted(run=run, t_ns=begin_ns, uid=self._name(), unit=unit, words=words)
                yield begun
                end_ns = begin_ns + HOUR_S * SECOND_NS - 10**7
                yield StepEnded(run=run, t_ns=end_ns, uid=self._name(), unit=unit, step_uid=begun.uid)

    def _channels(self, run: str, hours: int, t0_ns: int) -> pa.Table:
        rows = []
        for number, unit in enumerate(self.units):
            epoch = epoch_of(run, number)
            for signal, dt_ns, measure in (("rate", 10**7, "deg/h"), ("temperature", SECOND_NS, "degC")):
                samples = hours * HOUR_S * SECOND_NS // dt_ns
                batch = SampleBatch(unit, signal, run, epoch, 0, t0_ns, dt_ns, measure, values=np.zeros(1))
                rows.append(channel_row(batch, samples))
        return pa.Table.from_pylist(rows, schema=CHANNEL_COLUMNS)

    def _reduced(
        self,
        run: str,
        temperatures: Sequence[float],
        t0_ns: int,
        rate: Sequence[SeriesStatistics],
        temperature: Sequence[SeriesStatistics],
    ) -> pa.Table:
        rows = []
        turn_on = self._rng.normal(0, 0.05, len(self.units))
        for number, unit in enumerate(self.units):
            for step, degrees in enumerate(temperatures):
                begin_ns = t0_ns + step * HOUR_S * SECOND_NS
                bias = self._bias[number] + turn_on[number] + self._slope[number] * (degrees - 20.0)
                for signal, measure, mean, pool in (
                    ("rate", "deg/h", bias, rate),
                    ("temperature", "degC", degrees, temperature),
                ):
                    found = pool[int(self._rng.integers(len(pool)))]
                    row = found._replace(mean=found.mean + mean)._asdict()
                    for average, each in zip((1, 10, 100), row.pop("averages"), strict=True):
                        row |= {f"{name}_{average}s": value for name, value in each._asdict().items()}
                    end_ns = begin_ns + HOUR_S * SECOND_NS - 10**7
                    rows.append(
                        {"run": run, "unit": unit, "signal": signal, "t_from_ns": begin_ns, "t_to_ns": end_ns}
                        | {"unit_of_measure": measure}
                        | row
                    )
        return pa.Table.from_pylist(rows, schema=COLUMNS)


def epoch_of(run: str, number: int) -> UUID:
    return UUID(bytes=(run.encode() + b"\0" * 16)[:12] + number.to_bytes(4, "big"))


def channel_row(batch: SampleBatch, samples: int) -> dict[str, object]:
    """A row of the table of channels for a signal that begins with a batch."""
    last_ns = batch.t0_ns + (samples - 1) * batch.dt_ns
    return {
        "channel": channel_id(sample_key(PLACE, batch.unit, batch.signal), batch),
        "site": PLACE.site, "station": PLACE.station, "unit": batch.unit, "signal": batch.signal, "run": batch.run,
        "epoch": str(batch.epoch), "unit_of_measure": batch.unit_of_measure, "is_counts": batch.counts is not None,
        "scale": batch.scale, "offset": batch.offset, "dt_ns": batch.dt_ns, "irregular": False, "samples": samples,
        "seq_first": 0, "seq_next": samples, "t_first_ns": batch.t0_ns, "t_last_ns": last_ns,
        "arrival_first_ns": batch.t0_ns, "arrival_last_ns": last_ns, "overlapping": False,
    }  # fmt: skip


def document_table(documents: Iterable[AnyDocument]) -> pa.Table:
    """Rows of the table of events."""
    rows = [
        (type(each).__name__, each.run, getattr(each, "unit", None), each.uid, each.t_ns, msgspec.json.encode(each))
        for each in documents
    ]
    kind, run, unit, uid, t_ns, text = zip(*rows, strict=True) if rows else ((),) * 6
    columns = {
        "site": [PLACE.site] * len(rows), "station": [PLACE.station] * len(rows), "kind": kind, "run": run,
        "unit": unit, "uid": uid, "t_ns": t_ns, "arrival_ns": t_ns, "document": [each.decode() for each in text],
    }  # fmt: skip
    return pa.table(columns, schema=EVENT_COLUMNS)


def put_part(
    store: Store,
    number: int,
    documents: Iterable[AnyDocument],
    channels: pa.Table | None = None,
    gathered: Sequence[ChannelBuffer] = (),
) -> None:
    """Put a part in force that holds documents, and either channels alone or gathered ones with their samples."""
    name = f"{number:08d}"
    lake = Lake(store)
    fresh = store.tmp / f"lake-{name}"
    fresh.mkdir(parents=True)
    files: dict[str, PartFile] = {}
    rows = [] if channels is None else channels.to_pylist()
    with part_writers(fresh) as writer:
        samples = writer("samples")
        rollups = [rollup_tables(())]
        for channel in sorted(gathered, key=lambda each: each.identity):
            rollups.append(rollup_tables([buffered_rows([channel], samples.write).seconds]))
            rows.append(channel.row())
        files["samples.parquet"] = samples.finish()
        for table_name, tables in (
            ("channels", [pa.Table.from_pylist(rows, schema=CHANNEL_COLUMNS)]),
            ("events", [document_table(documents)]),
            # channel by channel: merged parts have row groups of single channels
            *zip(("rollup_1s", "rollup_10s"), zip(*rollups, strict=True), strict=True),
        ):
            files[f"{table_name}.parquet"] = writer(table_name).write_all(tables)
    part = Part(
        name=name,
        segments=(name,),
        files=files,
        samples=sum(int(row["samples"]) for row in rows),
        t_first_ns=min(row["t_first_ns"] for row in rows),
        t_last_ns=max(row["t_last_ns"] for row in rows),
        arrival_first_ns=min(row["arrival_first_ns"] for row in rows),
        arrival_last_ns=max(row["arrival_last_ns"] for row in rows),
    )
    write_part(fresh, part)
    lake.swap((), [BuiltPart(fresh, part, Drops({}, {}))])


def write_raw_day(folder: Path, units: int, rate_hz: int, hours: int = 24) -> Store:
    """A store in which each unit stands still for a day in one step, all samples on the disk as counts."""
    store = Store.create(folder)
    rng = np.random.default_rng(2)
    run, dt_ns, size, together = "raw", SECOND_NS // rate_hz, 10_000, 10
    n = hours * HOUR_S * rate_hz
    end_ns = START_NS + (n - 1) * dt_ns
    names = unit_names(units)
    with builder_lock(store):
        for first in range(0, units, together):
            documents: list[AnyDocument] = []
            if first == 0:
                documents.append(RunStarted(run=run, t_ns=START_NS, procedure="static_bias"))
            gathered = []
            for number in range(first, min(first + together, units)):
                unit, epoch = names[number], epoch_of(run, number)
                words = StepWords(procedure="static_bias", position="IRA_up")
                begun = StepStarted(run=run, t_ns=START_NS, unit=unit, words=words)
                documents += [
                    UnitMounted(run=run, t_ns=START_NS, unit=unit),
                    PowerOn(run=run, t_ns=START_NS, unit=unit, epoch=str(epoch)),
                    begun,
                    StepEnded(run=run, t_ns=end_ns, unit=unit, step_uid=begun.uid),
                ]
                gathered.append(_day_of_counts(rng, unit, run, epoch, n, dt_ns, size))
            put_part(store, first // together + 1, documents, gathered=gathered)
    return store


def _day_of_counts(
    rng: np.random.Generator, unit: str, run: str, epoch: UUID, n: int, dt_ns: int, size: int
) -> ChannelBuffer:
    """White noise of 50 counts about a bias that walks."""
    bias = rng.normal(0, 20_000) + np.cumsum(rng.normal(0, 0.3, n // size))
    found: ChannelBuffer | None = None
    for at, mean in enumerate(bias):
        counts = np.round(rng.normal(mean, 50.0, size)).astype(np.int32)
        t0_ns = START_NS + at * size * dt_ns
        batch = SampleBatch(unit, "rate", run, epoch, at * size, t0_ns, dt_ns, "deg/h", counts=counts, scale=1e-3)
        if found is None:
            found = ChannelBuffer(channel_id(sample_key(PLACE, unit, "rate"), batch), PLACE, batch)
        found.add(read_raw_batch(encode_batch(batch)), batch.last_ns + 10**6)
    assert found is not None
    return found
