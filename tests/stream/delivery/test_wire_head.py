"""The head of a batch, the batch as bytes and the decoded batch agree, and refuse the same."""

from uuid import UUID

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_array_equal

from stream.batch import CountArray, SampleBatch
from stream.errors import BadInput, WireError
from stream.wire import samples_pb2
from stream.wire.batches import decode_batch, encode_batch, encode_preview, read_batch_head, read_wire_batch

int64s = st.one_of(st.integers(-(2**63), 2**63 - 1), st.integers(-3, 3), st.sampled_from([2**63 - 1, -(2**63)]))
sizes = st.sampled_from([0, 0, 1, 2, 3])
few = st.sampled_from([0, 0, 4])


@st.composite
def messages(draw: st.DrawFn) -> bytes:
    """Messages of which nearly every field may be wrong."""
    message = samples_pb2.SampleBatch(
        schema=draw(st.sampled_from([1, 1, 2, 2, 0, 3])),
        unit=draw(st.sampled_from(["U1", ""])),
        signal="rate",
        run="r1",
        epoch=bytes(draw(st.sampled_from([16, 16, 16, 15]))),
        seq=draw(int64s),
        samples=draw(st.sampled_from([1, 2, 2, 2, 3, 0, 2_000_000])),
        t0_ns=draw(int64s),
        dt_ns=draw(int64s),
        irregular=draw(st.booleans()),
        unit_of_measure="deg/s",
        scale=draw(st.floats()),
        counts=bytes(draw(few) * draw(sizes)),
        count_planes=draw(st.binary(max_size=13)) if draw(few) else b"",
        count_residuals=draw(st.binary(max_size=17)) if draw(few) else b"",
        values=bytes(8 * draw(sizes)),
        times_ns=draw(hnp.arrays(np.int64, draw(sizes), elements=int64s)).tobytes(),
        flags=bytes(draw(sizes)),
    )
    payload = bytes(message.SerializeToString())
    if draw(st.integers(0, 9)) == 0:
        at = draw(st.integers(0, len(payload)))
        payload = payload[:at] + draw(st.binary(max_size=2)) + payload[at + draw(st.integers(0, 2)) :]
    return payload


def validated(batch: SampleBatch) -> SampleBatch:
    """The same batch through the checks of its own."""
    return SampleBatch(**{name: getattr(batch, name) for name in batch.__dataclass_fields__})


@given(st.one_of(messages(), st.binary(max_size=300)))
@settings(max_examples=200, deadline=None)
def test_all_ways_of_reading_refuse_the_same_and_agree(payload: bytes) -> None:
    refusals = []
    for read in (decode_batch, read_batch_head, read_wire_batch):
        try:
            read(payload)
        except WireError as error:
            refusals.append(str(error))
    assert refusals in ([], refusals[:1] * 3)
    if refusals:
        return
    batch, head, wire = decode_batch(payload), read_batch_head(payload), read_wire_batch(payload)
    assert validated(batch) == batch
    assert head == (
        batch.unit, batch.signal, batch.run, batch.epoch.hex, batch.seq, batch.next_seq, batch.t0_ns, batch.last_ns,
        batch.dt_ns,
    )  # fmt: skip
    assert wire[:7] == (*head[:3], *head[4:8])
    assert wire.meaning[:4] == (batch.epoch.bytes, batch.dt_ns, batch.unit_of_measure, batch.irregular)
    arrays = [b"" if each is None else each.tobytes() for each in (batch.counts, batch.values, batch.times_ns)]
    assert [wire.counts, wire.values, wire.times_ns] == arrays
    preview = samples_pb2.Preview.FromString(encode_preview(payload))
    assert preview.unit_of_measure == batch.unit_of_measure
    with np.errstate(all="ignore"):
        assert_array_equal(preview.value, batch.value_array[0])


@given(hnp.arrays(np.int32, st.integers(1, 40)), st.booleans())
def test_a_preview_is_the_first_sample(counts: CountArray, are_values: bool) -> None:
    given = {"values": counts / 7.0} if are_values else {"counts": counts, "scale": 0.25, "offset": 3.0}
    batch = SampleBatch("U1", "rate", "r1", UUID(int=1), 0, 0, 1000, "deg/s", **given)
    preview = samples_pb2.Preview.FromString(encode_preview(encode_batch(batch)))
    assert preview.value == batch.value_array[0]


@given(int64s, int64s, int64s, st.none() | hnp.arrays(np.int64, 2, elements=int64s), st.floats())
@settings(max_examples=200, deadline=None)
def test_what_a_batch_itself_refuses_is_refused_on_the_wire(
    seq: int, t0_ns: int, dt_ns: int, times: np.ndarray[tuple[int], np.dtype[np.int64]] | None, scale: float
) -> None:
    message = samples_pb2.SampleBatch(schema=1, unit="U", epoch=bytes(16), seq=seq, samples=2, t0_ns=t0_ns, dt_ns=dt_ns)
    message.values = bytes(16)
    message.scale = scale
    message.times_ns = b"" if times is None else times.tobytes()
    try:
        common = ("U", "", "", UUID(int=0), seq, t0_ns, dt_ns, "")
        SampleBatch(*common, values=np.zeros(2), times_ns=times, scale=scale)
        is_taken = True
    except BadInput:
        is_taken = False
    try:
        read_batch_head(message.SerializeToString())
    except WireError:
        assert not is_taken
    else:
        assert is_taken


def test_a_batch_read_twice_shares_its_epoch() -> None:
    batch = SampleBatch("U1", "rate", "r1", UUID(int=7), 0, 0, 10, "deg/s", values=np.zeros(3))
    assert decode_batch(encode_batch(batch)).epoch is decode_batch(encode_batch(batch)).epoch


def test_counts_of_the_first_schema_are_read_as_those_of_now() -> None:
    counts = np.array([0, -1, 70_000, -(2**31)], np.int32)
    batch = SampleBatch("U1", "rate", "r1", UUID(int=7), 0, 0, 10, "deg/s", counts=counts, scale=0.5)
    message = samples_pb2.SampleBatch.FromString(encode_batch(batch))
    message.schema, message.counts = 1, counts.tobytes()
    message.ClearField("count_residuals")
    payload = message.SerializeToString()
    assert decode_batch(payload) == batch
    assert read_wire_batch(payload) == read_wire_batch(encode_batch(batch))
