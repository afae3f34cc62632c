"""What a pass has done for a plant, how far the copy is behind, and what was refused; kept beside the copy."""

from pathlib import Path

import msgspec

from storage.fleet_store import Replica
from stream.decoding import decode_json
from stream.files.atomic_file import write_durably

_FILE = "progress.json"


class Refusal(msgspec.Struct, frozen=True):
    """What was not taken of a plant: `kind` for programs, in one word; `segment` may be a file's name, or empty."""

    plant: str
    kind: str
    segment: str
    what: str


class Lag(msgspec.Struct, frozen=True):
    """How far a copy is behind its plant: segments, bytes, and seconds between the newest arrivals of both."""

    segments: int = 0
    bytes: int = 0
    seconds: float = 0.0


class Progress(msgspec.Struct, frozen=True, kw_only=True):
    """State of the copy of a plant after a pass.

    `contact_ns` is when the plant last answered, `at_ns` when the pass ended. `notes` are for information. `trouble` is
    why the pass ended early, empty if it did not.
    """

    plant: str
    store: str = ""
    at_ns: int = 0
    contact_ns: int = 0
    segments: int = 0
    bytes: int = 0
    added: int = 0
    added_bytes: int = 0
    added_files: int = 0
    transferred_bytes: int = 0
    seconds: float = 0.0
    lag: Lag = Lag()
    refused: tuple[Refusal, ...] = ()
    notes: tuple[str, ...] = ()
    trouble: str = ""

    @property
    def is_well(self) -> bool:
        """Whether nothing was refused and the pass came to its end."""
        return not self.refused and not self.trouble


def read_progress(replica: Replica) -> Progress:
    """The state after the last pass; one without numbers if there is none."""
    try:
        return decode_json((replica.folder / _FILE).read_bytes(), Progress)
    except (OSError, msgspec.MsgspecError):  # written again by the next pass
        return Progress(plant=replica.plant.name, store=replica.plant.store)


def write_progress(replica: Replica, progress: Progress) -> None:
    """Keep the state."""
    path: Path = replica.folder / _FILE
    write_durably(path, msgspec.json.encode(progress))
