"""Samples for the tests of the recorder, and the lake's values of them."""

from uuid import UUID

import numpy as np

from storage.sql.catalog import Catalog
from storage.store import Store
from stream.batch import SampleBatch
from stream.identity import Place, sample_key

PLACE = Place("plant", "bench")
KEY = sample_key(PLACE, "U1", "rate")


def batch(i: int, n: int = 100, signal: str = "rate", epoch: int = 1) -> SampleBatch:
    values = np.arange(i * n, (i + 1) * n, dtype=np.float64)
    return SampleBatch("U1", signal, "r1", UUID(int=epoch), i * n, i * n * 10**6, 10**6, "deg/s", values=values)


def lake_values(store: Store) -> list[float]:
    with Catalog(store) as catalog:
        return [value for (value,) in catalog.rows("select value from samples where signal = 'rate' order by t_ns")]
