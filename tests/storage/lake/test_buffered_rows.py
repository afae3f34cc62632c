"""Rows of channels that are read together are those of each channel alone."""

from uuid import UUID

import numpy as np
import pyarrow as pa

from storage.lake.buffered_rows import buffered_rows, together
from storage.lake.channel_buffer import ChannelBuffer
from storage.lake.clock_stretches import clock_table
from storage.lake.rollups import rollup_tables
from storage.lake.tables import SHARED_ROWS, SMALL_ROWS
from stream.batch import SampleBatch
from stream.identity import Place
from stream.wire.batches import encode_batch, read_raw_batch


def buffer_of(identity: int, rng: np.random.Generator, samples: int) -> ChannelBuffer:
    """A channel of counts or values, with or without flags and times, now and then late or set back."""
    is_counts, has_flags, has_times = (rng.random(3) < 0.4).tolist()
    buffer, t0_ns, dt_ns = None, int(rng.integers(0, 10**10)), int(rng.choice([10**8, 3 * 10**10]))
    for seq in range(0, samples, 50):
        n = min(50, samples - seq)
        data = np.round(rng.normal(0, 300, n)).astype(np.int32)
        times_ns = t0_ns + np.cumsum(rng.integers(-(10**7), 3 * dt_ns, n)) if has_times else None
        batch = SampleBatch(
            "U1", f"s{identity}", "r1", UUID(int=1), seq, t0_ns if times_ns is None else int(times_ns[0]), dt_ns, "V",
            counts=data if is_counts else None, values=None if is_counts else data.astype(np.float64),
            times_ns=times_ns,
            flags=rng.integers(0, 4, n).astype(np.uint8) if has_flags else None, irregular=has_times, scale=-0.5,
        )  # fmt: skip
        buffer = buffer or ChannelBuffer(identity, Place("local", "files"), batch)
        buffer.add(read_raw_batch(encode_batch(batch)), 10**12 + int(rng.integers(0, 10**11)))
        t0_ns += 50 * dt_ns - (3 * 10**9 if rng.random() < 0.2 else 0)
    assert buffer is not None
    return buffer


def test_channels_read_together_have_the_rows_of_each() -> None:
    rng = np.random.default_rng(4)
    channels = [buffer_of(number, rng, int(rng.integers(1, 200))) for number in range(-9, 30)]
    (group,) = together(channels)
    assert group == channels
    whole: list[pa.Table] = []
    alone: list[pa.Table] = []
    found = buffered_rows(group, whole.append)
    each = [buffered_rows([channel], alone.append) for channel in channels]
    assert pa.concat_tables(whole).equals(pa.concat_tables(alone))
    assert {table.column("flags").null_count == table.num_rows for table in alone} == {True, False}
    for one, other in zip(rollup_tables([found.seconds]), rollup_tables(own.seconds for own in each), strict=True):
        assert one.num_rows
        assert one.equals(other)
    assert clock_table([found.clocks]).equals(clock_table([own.clocks for own in each]))


def test_large_channels_are_read_alone_and_small_ones_until_a_row_group_is_full() -> None:
    rng = np.random.default_rng(5)
    small, large = buffer_of(1, rng, 3), buffer_of(2, rng, 3)
    small.samples, large.samples = SMALL_ROWS - 1, SMALL_ROWS
    until_full = -(-SHARED_ROWS // small.samples)
    groups = list(together([small, large, large, *[small] * (until_full + 1)]))
    assert groups == [[small], [large], [large], [small] * until_full, [small]]
