"""Options of `gyrofleet diagnose`: block length, declared noise, runs to hold out."""

import re

from analytics.loop.model.declared_noise import GivenNoise
from stream.errors import BadInput

_SECONDS = {"": 1.0, "s": 1.0, "min": 60.0, "h": 3600.0}
_NOISE_TERMS = ("N", "B", "K", "turn_on")
_LEAST_NOISE, _MOST_NOISE = 1e-20, 1e20


def block_seconds(text: str) -> float:
    """Seconds of a length of time.

    Examples
    --------
    >>> block_seconds("30s"), block_seconds("0.5 min"), block_seconds("10")
    (30.0, 30.0, 10.0)
    """
    match = re.fullmatch(r"\s*([0-9.]+(?:e[+-]?[0-9]+)?)\s*(s|min|h|)\s*", text)
    try:
        if match is None:
            raise ValueError(text)
        return float(match[1]) * _SECONDS[match[2]]
    except ValueError:
        raise BadInput(f"--block {text}: give a length of time such as 30s, 1min or 0.5h") from None


def noise_of(text: str) -> GivenNoise:
    """Noise declared on the command line; only turn_on may be missing.

    Examples
    --------
    >>> noise_of("N=0.005, B=0.02, K=0.01, turn_on=0.3").turn_on
    0.3
    >>> noise_of("N=0.005, B=0.02, K=0.01").turn_on is None
    True
    """
    form = "N=..,B=..,K=..[,turn_on=..] in deg/sqrt(h), deg/h, deg/h/sqrt(h), deg/h, 0 for a term that is absent"
    pairs = [(name.strip(), value.strip()) for name, _, value in (part.partition("=") for part in text.split(","))]
    names = [name for name, _ in pairs]
    if sorted({*names, "turn_on"}) != sorted(_NOISE_TERMS) or len(set(names)) < len(names):
        missing = [name for name in _NOISE_TERMS[:3] if name not in names]
        wrong = f"{', '.join(missing)} is missing" if missing else "a term is unknown or repeated"
        raise BadInput(f"--noise {text}: {wrong}; give {form}")
    try:
        values = {name: float(value) for name, value in pairs}
    except ValueError as error:
        raise BadInput(f"--noise {text}: {error}; give {form}") from error
    if not all(0 <= value < float("inf") for value in values.values()) or values["N"] == 0:
        raise BadInput(f"--noise {text}: terms are positive numbers, N above 0; give {form}")
    if strange := [name for name, value in values.items() if value and not _LEAST_NOISE <= value <= _MOST_NOISE]:
        raise BadInput(f"--noise {text}: {', '.join(strange)} is of no sensor's size; give {form}")
    return GivenNoise(values["N"], values["B"], values["K"], values.get("turn_on"))


def holdout_of(text: str) -> tuple[str, ...] | None:
    """Runs to hold out, by name; None for the last third.

    Examples
    --------
    >>> holdout_of("last-third"), holdout_of("none"), holdout_of("runs=r7,r8")
    (None, (), ('r7', 'r8'))
    """
    if text == "last-third":
        return None
    if text == "none":
        return ()
    names = tuple(name.strip() for name in text.removeprefix("runs=").split(",") if name.strip())
    if not text.startswith("runs=") or not names:
        raise BadInput(f"--holdout {text}: give last-third, none, or runs=A,B with the names of runs")
    return names
