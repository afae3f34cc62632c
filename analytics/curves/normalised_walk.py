"""Angle random walk by normalised bias stability, of a signal in the store."""

from collections import deque

import numpy as np

from storage.sql.catalog import Catalog
from storage.sql.reading import SignalRecord, read_signal
from stream.batch import FloatArray
from stream.clock import GridTracker
from stream.estimators.base import NoEstimate
from stream.estimators.noise.noise_fit import NoiseCoefficient
from stream.estimators.noise.normalised_random_walk import MOST_INTERVAL_S, angle_random_walk_normalised
from stream.quantities import ANGULAR_RATE_UNIT, report_unit

MOST_SLOTS = 2**24


def normalised_walk(catalog: Catalog, record: SignalRecord) -> NoiseCoefficient | NoEstimate:
    """Angle random walk by the normalised method (GJB 2426A-2004 5.12.5.4.1), from the samples of a record.

    In deg/sqrt(h); NoEstimate where the samples are no angular rate, lie on no grid or are too slow or too few.

    Only the last 2**24 slots of the grid are used, 23 h at 200 Hz: the median over pieces of 30 s gains nothing from
    more, and memory stays bounded.

    >>> record = SignalRecord("FOG-1", "temperature", "r1", "degC", 3600, False)
    >>> normalised_walk(None, record)  # the store is not read
    NoEstimate(reason='the signal is in degC: an angle random walk is of an angular rate, such as deg/s')
    """
    unit_of_measure, factor = report_unit(record.unit_of_measure)
    if unit_of_measure != ANGULAR_RATE_UNIT:
        why = "an angle random walk is of an angular rate, such as deg/s"
        return NoEstimate(f"the signal is in {unit_of_measure}: {why}")
    tracker = GridTracker()
    pieces: deque[tuple[int, FloatArray]] = deque()
    for batch in read_signal(catalog, record):
        for first_slot, start, stop in tracker.place(batch):
            pieces.append((first_slot, batch.value_array[start:stop] * factor))
        if tracker.irregular:
            return NoEstimate("the samples lie on no grid, and means over 1 s of the normalised method need one")
        if tracker.sample_interval_s >= MOST_INTERVAL_S:
            pieces.clear()  # the method refuses it whatever the samples are: spare reading them
            break
        while pieces and pieces[0][0] + len(pieces[0][1]) <= tracker.next_slot - MOST_SLOTS:
            pieces.popleft()
    found = angle_random_walk_normalised(_joined(pieces), tracker.sample_interval_s)
    return found if isinstance(found, NoEstimate) else found.coefficient


def _joined(pieces: deque[tuple[int, FloatArray]]) -> FloatArray:
    """Values from the first to the last slot that is kept, NaN where there is none."""
    if not pieces:
        return np.empty(0)
    stop = pieces[-1][0] + len(pieces[-1][1])
    origin = max(pieces[0][0], stop - MOST_SLOTS)
    joined = np.full(stop - origin, np.nan)
    for first_slot, values in pieces:
        skipped = max(0, origin - first_slot)
        joined[first_slot + skipped - origin : first_slot - origin + len(values)] = values[skipped:]
    return joined
