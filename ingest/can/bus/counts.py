"""What has come from a CAN bus."""

from dataclasses import dataclass


@dataclass(frozen=True)
class CanBusCounts:
    """What has come from a bus so far, in frames unless said otherwise.

    Attributes
    ----------
    received: Everything that was read from the interface: data, remote and error frames, and what is no frame.
    decoded: Data frames that the decoder has taken.
    unknown: Of these, frames of identifiers that are not mapped. An interface that filters does not give them.
    remote_frames, error_frames: Frames that carry no samples.
    malformed: What is no frame of this bus: too long, an impossible identifier, a datagram of somebody else.
    undecoded: Data frames on which the decoder failed.
    overrun: Frames that were read and not kept, because decoding or delivery was too far behind.
    interface_overrun: Frames that the operating system dropped, and times at which a controller said that it dropped
        some.
    undelivered: Samples whose delivery failed.
    bus_off, error_passive: Times at which the controller went there.
    outages: Times at which the interface was lost.
    """

    received: int = 0
    decoded: int = 0
    unknown: int = 0
    remote_frames: int = 0
    error_frames: int = 0
    malformed: int = 0
    undecoded: int = 0
    overrun: int = 0
    interface_overrun: int = 0
    undelivered: int = 0
    bus_off: int = 0
    error_passive: int = 0
    outages: int = 0
