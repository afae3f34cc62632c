"""The views of the lake with the rows that only the log has so far, shared by requests."""

import itertools
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from functools import cached_property
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.compute as pc

from analytics.serve.live.follower import FloorFollower
from analytics.serve.shared_lake import SERVED, SERVED_KINDS, SERVED_OF, LakeState, SharedLake
from storage.sql.catalog import Catalog
from storage.sql.overlay import Overlay
from stream.closing import Closing

_numbers = itertools.count()


class Recorded(NamedTuple):
    """What the log has of a unit that the lake does not have; 0 where there is nothing."""

    samples: int = 0
    t_last_ns: int = 0
    arrival_last_ns: int = 0


class FreshViews(Closing):
    """A version of the lake, which stays open meanwhile, with the rows of the log as they are now.

    A segment is in the lake or in these rows: none of its messages is missing or there twice. `channels` is the number
    of rows of channels that only the log has: beside one version of the lake it grows with each new channel.
    """

    def __init__(self, lake: SharedLake, live: FloorFollower, state: LakeState) -> None:
        self._rows, events = live.beyond(state.segments)
        channels, self.channels = self._rows, self._rows.num_rows
        with ExitStack() as stack:
            catalog = stack.enter_context(lake.views.lease(state.lake))
            self._views: Catalog | Overlay = catalog
            if channels.num_rows or events.num_rows:
                kinds = set(pc.unique(events.column("kind")).to_pylist())
                # without such a document they are the lake's
                same = [name for name, own in SERVED_OF.items() if kinds.isdisjoint(own)]
                name = f"log_{next(_numbers)}"
                self._views = stack.enter_context(catalog.overlay(name, channels, events, SERVED, SERVED_KINDS, same))
            self._leases = stack.pop_all()

    @cached_property
    def recorded(self) -> Mapping[str, Recorded]:
        """What the log has beyond the lake, by unit."""
        found: dict[str, Recorded] = {}
        names = ("unit", "samples", "t_last_ns", "arrival_last_ns")
        for unit, samples, t_ns, arrival_ns in zip(
            *(self._rows.column(name).to_pylist() for name in names), strict=True
        ):
            before = found.get(unit, Recorded())
            found[unit] = Recorded(
                before.samples + samples, max(before.t_last_ns, t_ns), max(before.arrival_last_ns, arrival_ns)
            )
        return found

    def batches(self, sql: str, parameters: object = None) -> Iterator[pa.RecordBatch]:
        """The batches of a result of one of the project's own reading statements."""
        return self._views.batches(sql, parameters)

    def rows(self, sql: str, parameters: object = None) -> list[tuple[Any, ...]]:
        """All rows of a statement's result."""
        return self._views.rows(sql, parameters)

    def named_rows(self, sql: str, parameters: object = None) -> tuple[list[str], list[tuple[Any, ...]]]:
        """Names of the columns of a statement's result and all rows."""
        return self._views.named_rows(sql, parameters)

    def close(self) -> None:
        """Leave the lake."""
        self._leases.close()
