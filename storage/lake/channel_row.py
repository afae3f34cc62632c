"""The row of a channel of one segment, as its messages are counted one by one."""

from typing import Any

from stream.batch import SampleBatch
from stream.identity import Place
from stream.wire.batches import RawBatch

OF_FIRST = ("unit", "signal", "run", "unit_of_measure", "scale", "offset", "dt_ns")


class ChannelRow:
    """Counts the messages of a channel without keeping them; `first` is its first batch, already decoded."""

    __slots__ = ("_about", "_arrival_ns", "_irregular", "_samples", "_seq", "_t_ns")

    def __init__(self, identity: int, place: Place, first: SampleBatch) -> None:
        self._about: dict[str, Any] = {name: getattr(first, name) for name in OF_FIRST} | {
            "channel": identity, "site": place.site, "station": place.station, "epoch": str(first.epoch),
            "is_counts": first.counts is not None, "overlapping": False,
        }  # fmt: skip
        self._irregular, self._samples = False, 0
        self._seq: tuple[int, int] | None = None  # of the first sample, and after the last one
        self._t_ns = self._arrival_ns = (0, 0)  # first and last

    def add(self, batch: RawBatch, arrival_ns: int) -> None:
        """Count a message."""
        message, last_ns = batch
        self._irregular |= message.irregular
        self.add_regular(message.seq, message.seq + message.samples, message.t0_ns, last_ns, arrival_ns)

    def add_regular(self, seq: int, next_seq: int, t0_ns: int, last_ns: int, arrival_ns: int) -> None:
        """Count a message at the channel's interval, by its numbers and the times of its first and last sample."""
        self._samples += next_seq - seq
        if self._seq is None:
            self._seq, self._t_ns, self._arrival_ns = (seq, next_seq), (t0_ns, last_ns), (arrival_ns, arrival_ns)
            return
        self._seq = min(self._seq[0], seq), max(self._seq[1], next_seq)
        self._t_ns = min(self._t_ns[0], t0_ns), max(self._t_ns[1], last_ns)
        self._arrival_ns = min(self._arrival_ns[0], arrival_ns), max(self._arrival_ns[1], arrival_ns)

    def row(self) -> dict[str, Any]:
        """Its row in the table of channels."""
        assert self._seq is not None
        return self._about | {
            "irregular": self._irregular, "samples": self._samples, "seq_first": self._seq[0],
            "seq_next": self._seq[1], "t_first_ns": self._t_ns[0], "t_last_ns": self._t_ns[1],
            "arrival_first_ns": self._arrival_ns[0], "arrival_last_ns": self._arrival_ns[1],
        }  # fmt: skip
