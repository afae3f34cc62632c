"""Whether instruments that were made safe are measured at rest."""

import time
from collections.abc import Mapping

from ingest.instruments.base import Instrument
from stream.errors import InstrumentError

_LOOK_S = 0.1
_PATIENCE_S = 5.0  # in which a table that brakes comes nearer to rest
_NEARER = 0.99
_MOST_S = 60.0


def has_safe_state(instrument: Instrument) -> bool:
    """Whether its class says what is safe."""
    return type(instrument).make_safe is not Instrument.make_safe


def still_moving(instrument: Instrument) -> str:
    """Wait until an instrument that was made safe is measured at rest, or comes no nearer; what it does, else empty."""
    began_s = nearer_s = now_s = time.monotonic()
    nearest = float("inf")
    while True:
        try:
            with instrument.lock:
                moving = instrument.moving()
        except InstrumentError as error:
            trouble = f"it was commanded, and what it does cannot be measured: {error}"
        else:
            if moving is None:
                return ""
            trouble = moving.text
            if moving.left < _NEARER * nearest:
                nearest, nearer_s = moving.left, now_s
        now_s = time.monotonic()
        if now_s - nearer_s > _PATIENCE_S or now_s - began_s > _MOST_S:
            return trouble
        time.sleep(_LOOK_S)


def by_hand(unsafe: Mapping[str, str]) -> list[str]:
    """A sentence for each instrument that could not be made safe."""
    return [f"{name} could not be made safe: {trouble}; make it safe by hand" for name, trouble in unsafe.items()]
