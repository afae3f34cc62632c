"""Batches of the signal `rate` of one unit."""

from uuid import UUID

from stream.batch import FloatArray, IntArray, SampleBatch


def rate_batch(
    values: FloatArray,
    first_slot: int = 0,
    unit: str = "deg/h",
    times_ns: IntArray | None = None,
    irregular: bool = False,
    dt_ns: int = 10_000_000,
) -> SampleBatch:
    return SampleBatch(
        unit="FOG-1",
        signal="rate",
        run="r1",
        epoch=UUID(int=1),
        seq=max(first_slot, 0),
        t0_ns=first_slot * dt_ns if times_ns is None else int(times_ns[0]),
        dt_ns=dt_ns,
        unit_of_measure=unit,
        values=values,
        times_ns=times_ns,
        irregular=irregular,
    )
