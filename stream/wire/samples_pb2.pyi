from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Optional as _Optional

DESCRIPTOR: _descriptor.FileDescriptor

class SampleBatch(_message.Message):
    __slots__ = ("schema", "unit", "signal", "run", "epoch", "seq", "samples", "t0_ns", "dt_ns", "irregular", "times_ns", "unit_of_measure", "counts", "scale", "offset", "values", "flags", "count_planes", "count_residuals")
    SCHEMA_FIELD_NUMBER: _ClassVar[int]
    UNIT_FIELD_NUMBER: _ClassVar[int]
    SIGNAL_FIELD_NUMBER: _ClassVar[int]
    RUN_FIELD_NUMBER: _ClassVar[int]
    EPOCH_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    SAMPLES_FIELD_NUMBER: _ClassVar[int]
    T0_NS_FIELD_NUMBER: _ClassVar[int]
    DT_NS_FIELD_NUMBER: _ClassVar[int]
    IRREGULAR_FIELD_NUMBER: _ClassVar[int]
    TIMES_NS_FIELD_NUMBER: _ClassVar[int]
    UNIT_OF_MEASURE_FIELD_NUMBER: _ClassVar[int]
    COUNTS_FIELD_NUMBER: _ClassVar[int]
    SCALE_FIELD_NUMBER: _ClassVar[int]
    OFFSET_FIELD_NUMBER: _ClassVar[int]
    VALUES_FIELD_NUMBER: _ClassVar[int]
    FLAGS_FIELD_NUMBER: _ClassVar[int]
    COUNT_PLANES_FIELD_NUMBER: _ClassVar[int]
    COUNT_RESIDUALS_FIELD_NUMBER: _ClassVar[int]
    schema: int
    unit: str
    signal: str
    run: str
    epoch: bytes
    seq: int
    samples: int
    t0_ns: int
    dt_ns: int
    irregular: bool
    times_ns: bytes
    unit_of_measure: str
    counts: bytes
    scale: float
    offset: float
    values: bytes
    flags: bytes
    count_planes: bytes
    count_residuals: bytes
    def __init__(self, schema: _Optional[int] = ..., unit: _Optional[str] = ..., signal: _Optional[str] = ..., run: _Optional[str] = ..., epoch: _Optional[bytes] = ..., seq: _Optional[int] = ..., samples: _Optional[int] = ..., t0_ns: _Optional[int] = ..., dt_ns: _Optional[int] = ..., irregular: _Optional[bool] = ..., times_ns: _Optional[bytes] = ..., unit_of_measure: _Optional[str] = ..., counts: _Optional[bytes] = ..., scale: _Optional[float] = ..., offset: _Optional[float] = ..., values: _Optional[bytes] = ..., flags: _Optional[bytes] = ..., count_planes: _Optional[bytes] = ..., count_residuals: _Optional[bytes] = ...) -> None: ...

class Preview(_message.Message):
    __slots__ = ("value", "unit_of_measure")
    VALUE_FIELD_NUMBER: _ClassVar[int]
    UNIT_OF_MEASURE_FIELD_NUMBER: _ClassVar[int]
    value: float
    unit_of_measure: str
    def __init__(self, value: _Optional[float] = ..., unit_of_measure: _Optional[str] = ...) -> None: ...
