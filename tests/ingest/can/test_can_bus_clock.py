"""Times of CAN frames: those of the station, whatever clock the interface has."""

from collections.abc import Callable

import can
import can.interfaces
import numpy as np

from ingest.can.bus.columns import ReceiveClock
from ingest.station_clock import StationClock

MakeFrame = Callable[..., can.Message]


def test_receive_times_are_those_of_the_station() -> None:
    station, said = StationClock(speed=100.0, start_ns=10**18), list[str]()
    clock = ReceiveClock(station, said.append)
    stamps_s = clock.now_s() - np.array([0.3, 0.2, 0.1])
    times_ns = clock.times_ns(stamps_s, clock.now_s())
    assert times_ns.tolist() == [station.at_ns(each) for each in stamps_s.tolist()]
    assert said == []


def test_a_counter_of_the_interface_is_set_to_the_station_once_and_after_a_jump() -> None:
    station, said = StationClock(), list[str]()
    clock = ReceiveClock(station, said.append)
    read_s = clock.now_s()
    first = clock.times_ns(np.array([100.0, 100.5]), read_s)
    later = clock.times_ns(np.array([101.0]), read_s + 0.9)  # read late or early, its counter says when it came
    assert (first[1], later[0] - first[1]) == (station.at_ns(read_s), 500_000_000)
    assert said == []
    begun_anew = clock.times_ns(np.array([0.25]), read_s + 2.0)
    assert begun_anew[0] == station.at_ns(read_s + 2.0)
    assert len(said) == 1
    assert "jump" in said[0]
    assert clock.source == "the interface, counted from its own start"


def test_frames_without_a_time_have_that_of_reading(frame: MakeFrame) -> None:
    station = StationClock()
    clock = ReceiveClock(station, print)
    read_s = clock.now_s()
    assert clock.times_ns(np.array([0.0, np.nan]), read_s).tolist() == [station.at_ns(read_s)] * 2
    assert clock.source == "the computer, when a frame was read"
