"""Measured CAN logs, read in place."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from uuid import UUID

import can
import cantools
import numpy as np
import pytest

from ingest.can.logs.log_file import CanLogFile
from ingest.can.mapping import CanMapping
from stream.batch import SampleBatch

DATA = Path(__file__).parents[3].parent / "shared" / "data"
VEHICLE = DATA / "can_vehicle"
GPS = DATA / "can_gps_imu"

pytestmark = [
    pytest.mark.measured,
    pytest.mark.skipif(not VEHICLE.is_dir(), reason=f"measured recordings are not in {DATA}"),
]


def frame_by_frame(path: Path, database: Path, message: str, signal: str) -> Iterator[tuple[int, float]]:
    of: Any = cantools.database.load_file(database)
    of = of.get_message_by_name(message)
    with can.LogReader(path) as frames:
        for frame in frames:
            if frame.arbitration_id == of.frame_id:
                yield round(frame.timestamp * 1e6) * 1000, of.decode(frame.data, decode_choices=False)[signal]


def sample_batches(file: CanLogFile) -> list[SampleBatch]:
    return [each for each in file.batches(lambda unit, run: UUID(int=1)) if isinstance(each, SampleBatch)]


def test_yaw_rate_of_a_car_is_that_of_cantools() -> None:
    path, database = VEHICLE / "vehicle_60s.blf", VEHICLE / "vehicle.dbc"
    file = CanLogFile(path, CanMapping([database], unit="CAR").plan())
    assert file.check().damage == ""
    batches = [batch for batch in sample_batches(file) if batch.signal == "yaw_rate"]
    values = np.concatenate([batch.value_array for batch in batches])
    times = np.concatenate([batch.time_array for batch in batches])
    theirs = list(frame_by_frame(path, database, "KINEMATICS", "YAW_RATE"))
    assert len(values) == len(theirs) == 4974
    assert {batch.unit_of_measure for batch in batches} == {"deg/s"}
    assert values.tolist() == [value for _, value in theirs]
    assert math.isclose(values.std(), np.std([value for _, value in theirs]))
    assert times.tolist() == [t_ns for t_ns, _ in theirs]


@pytest.mark.long
def test_angular_rates_of_an_mf4() -> None:
    path, database = max(GPS.glob("*.MF4")), GPS / "canmod-gps.dbc"
    file = CanLogFile(path, CanMapping([database], unit="GPS").plan(), run="drive")
    summary = file.check()
    found = {each.signal: each.sampling for each in summary.signals}
    assert (found["angularratex"].samples, found["angularratex"].dt_ns) == (4518, 10_000_000)
    batches = sample_batches(file)
    for axis in "XYZ":
        theirs = list(frame_by_frame(path, database, "gnss_imu", f"AngularRate{axis}"))
        mine = [b for b in batches if b.signal == f"angularrate{axis.lower()}"]
        assert [v for b in mine for v in b.value_array.tolist()] == [value for _, value in theirs]
        assert [t for b in mine for t in b.time_array.tolist()] == [t_ns for t_ns, _ in theirs]
