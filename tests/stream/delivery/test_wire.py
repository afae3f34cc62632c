"""Any batch encodes and decodes to itself; anything else is refused with a message, never a crash."""

from importlib.resources import as_file, files
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest
from google.protobuf import descriptor_pb2
from grpc_tools import protoc
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from stream.batch import SampleBatch
from stream.errors import BadInput, NewerSchema, WireError
from stream.events import EVENT_SCHEMA, NoteAdded, decode_event, encode_event
from stream.wire import samples_pb2
from stream.wire.batches import SAMPLE_SCHEMA, decode_batch, encode_batch
from tests.stream.examples import examples

names = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=20)
seconds = 10**9


@st.composite
def batches(draw: st.DrawFn) -> SampleBatch:
    n = draw(st.integers(1, 50))
    is_counts = draw(st.booleans())
    floats = st.floats(width=64, allow_nan=True, allow_infinity=True)
    times = draw(st.none() | hnp.arrays(np.int64, n, elements=st.integers(-(2**61), 2**61)))
    return SampleBatch(
        unit=draw(names),
        signal=draw(names),
        run=draw(names),
        epoch=UUID(int=draw(st.integers(0, 2**128 - 1))),
        seq=draw(st.integers(0, 2**52)),
        t0_ns=draw(st.integers(-(2**61), 2**61)),
        dt_ns=draw(st.integers(1, 10**15)),
        unit_of_measure=draw(names),
        counts=draw(hnp.arrays(np.int32, n)) if is_counts else None,
        values=None if is_counts else draw(hnp.arrays(np.float64, n, elements=floats)),
        times_ns=times,
        irregular=draw(st.booleans()),
        scale=draw(st.floats(allow_nan=False, allow_infinity=False)),
        offset=draw(st.floats(allow_nan=False, allow_infinity=False)),
        flags=draw(st.none() | hnp.arrays(np.uint8, n)),
    )


@examples(30, 100, batches())
def test_any_batch_decodes_to_itself(batch: SampleBatch) -> None:
    assert decode_batch(encode_batch(batch)) == batch


@given(st.binary(max_size=2000))
@settings(max_examples=500, deadline=None)
def test_random_bytes_are_a_named_error(payload: bytes) -> None:
    for decode in (decode_batch, decode_event):
        with pytest.raises(WireError):
            decode(payload)


@examples(50, 300, batches(), st.data())
def test_a_damaged_batch_is_a_batch_or_a_named_error(batch: SampleBatch, data: st.DataObject) -> None:
    payload = bytearray(encode_batch(batch))
    at = data.draw(st.integers(0, len(payload) - 1))
    payload[at] ^= data.draw(st.integers(1, 255))
    cut = data.draw(st.integers(0, len(payload)))
    for damaged in (bytes(payload), bytes(payload[:cut])):
        try:
            decode_batch(damaged)
        except WireError:
            continue


def test_a_newer_schema_is_refused_with_a_message() -> None:
    batch = SampleBatch("U", "rate", "r", UUID(int=1), 0, 0, seconds, "deg/s", values=np.zeros(3))
    message = samples_pb2.SampleBatch.FromString(encode_batch(batch))
    message.schema = SAMPLE_SCHEMA + 1
    with pytest.raises(NewerSchema, match=rf"schema {SAMPLE_SCHEMA + 1}.*up to {SAMPLE_SCHEMA}.*upgrade"):
        decode_batch(message.SerializeToString())
    newer = encode_event(NoteAdded(run="r", t_ns=0, text="x"), "e", 0).replace(
        f'"schema":{EVENT_SCHEMA}'.encode(), f'"schema":{EVENT_SCHEMA + 1}'.encode()
    )
    with pytest.raises(NewerSchema, match="upgrade"):
        decode_event(newer)


def test_arrays_that_do_not_fit_are_refused() -> None:
    common = ("U", "rate", "r", UUID(int=1), 0, 0, seconds, "deg/s")
    with pytest.raises(BadInput, match="exactly one"):
        SampleBatch(*common)
    with pytest.raises(BadInput, match="at least one sample"):
        SampleBatch(*common, values=np.zeros(0))
    with pytest.raises(BadInput, match="2 times_ns for 3 samples"):
        SampleBatch(*common, values=np.zeros(3), times_ns=np.zeros(2, np.int64))
    message = samples_pb2.SampleBatch.FromString(encode_batch(SampleBatch(*common, values=np.zeros(3))))
    message.values = message.values[:-1]
    with pytest.raises(WireError, match="23 bytes of values for 3 samples"):
        decode_batch(message.SerializeToString())


def test_the_generated_module_is_that_of_the_proto_file(tmp_path: Path) -> None:
    with as_file(files("stream.wire").joinpath("samples.proto")) as proto:
        out = tmp_path / "descriptors"
        code = protoc.main(["protoc", f"-I{proto.parent}", f"--descriptor_set_out={out}", str(proto)])
        assert code == 0
    compiled = descriptor_pb2.FileDescriptorSet.FromString(out.read_bytes()).file[0]
    generated = descriptor_pb2.FileDescriptorProto()
    samples_pb2.DESCRIPTOR.CopyToProto(generated)
    for message in compiled.message_type:
        for each in message.field:
            each.ClearField("json_name")  # made up by the compiler, left out at run time
    assert compiled == generated
