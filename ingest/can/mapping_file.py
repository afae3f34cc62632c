"""The mapping file: which signal of a CAN database is which signal of which unit.

One table a message::

    [[message]]
    message = "IMU"
    ids = { "FOG-0231" = 0x101, "FOG-0232" = 0x102 }   # or: unit = "FOG-0231", with the database's id
    signals = { YawRate = "rate", Temp = { signal = "temperature", unit_of_measure = "degC" } }
    counter = { signal = "Counter", modulus = 16 }
    checksum = { signal = "Crc", algorithm = "crc8_sae_j1850", first_byte = 0, last_byte = 6 }
    interval_s = 0.001
"""

from pathlib import Path

import msgspec

from stream.errors import BadInput
from stream.files.toml_text import decode_toml


class SignalEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Name of a signal, and its unit of measure if the database's is wrong."""

    signal: str
    unit_of_measure: str | None = None


class CounterEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The signal that counts frames, from 0 to `modulus` - 1 (by default all its bits hold)."""

    signal: str  # name in the database
    modulus: int | None = None  # by default 2 to the number of its bits


class ChecksumEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The signal with a checksum over bytes `first_byte` to `last_byte` but its own, with `prefix` before them."""

    signal: str  # name in the database
    algorithm: str  # xor, sum8, crc8_sae_j1850, crc8_sae_j1850_zero or crc8_autosar
    first_byte: int = 0  # of those it is over, from 0
    last_byte: int | None = None  # by default the frame's last
    prefix: tuple[int, ...] = ()  # bytes that are counted in before them


class MessageEntry(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One ``[[message]]``; with a counter and `interval_s`, sample n is at exactly n intervals after the first."""

    message: str  # name in the database
    id: int | None = None  # arbitration id in the database, if it has several messages of that name
    unit: str | None = None  # the unit that sends it, under the database's own id
    ids: dict[str, int] = {}  # unit to arbitration id, if several units send it
    channels: dict[str, int] = {}  # unit to channel, from 0 in every format, if one unit is on each
    sources: dict[str, int] = {}  # unit to source address, if several units send a J1939 message
    multiplexer: str | None = None  # a signal that says whose frame it is
    units: dict[str, int] = {}  # unit to raw value of the multiplexer
    channel: int | None = None  # channel that counts, from 0; by default the first that comes
    source: int | None = None  # J1939 source address that counts; by default the first that comes
    signals: dict[str, str | SignalEntry] = {}  # name in the database to name here; by default all, in lower case
    counter: CounterEntry | None = None  # tells lost frames
    checksum: ChecksumEntry | None = None  # tells damaged frames
    interval_s: float | None = None  # sample interval, seconds


class MappingFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A mapping file."""

    message: tuple[MessageEntry, ...]


def read_mapping(path: Path) -> tuple[MessageEntry, ...]:
    """Entries of a mapping file; raises BadInput if it cannot be read."""
    try:
        return decode_toml(path.read_bytes(), MappingFile).message
    except OSError as error:
        raise BadInput(f"{path}: cannot be read ({error.strerror or error})") from error
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: {error}; see `gyrofleet can scan --write` for a mapping to begin with") from error
