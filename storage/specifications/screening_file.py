"""Files of screening limits, the format before specifications had live limits: read, and converted.

A `[[limit]]` has `characteristic`, `signal`, `upper`, `unit_of_measure` and `tau_s` where a specification has
`metric`, `signal`, `upper`, `unit_of_measure` and `parameters`.
"""

import math
from typing import Annotated, Any, Literal

import msgspec

from stream.errors import BadInput, UnknownUnit
from stream.files.toml_text import decode_toml
from stream.quantities import check_unit, is_angular_rate

WALK = "angle_random_walk"
WALK_UNIT = "deg/sqrt(h)"
METRICS = {
    "bias_stability": ("bias_stability_averaged", "average_s"),
    "allan_deviation": ("allan_deviation", "tau_s"),
    WALK: (WALK, None),
}


class _Entry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    characteristic: Literal["bias_stability", "allan_deviation", "angle_random_walk"]
    signal: Annotated[str, msgspec.Meta(min_length=1)]
    upper: Annotated[float, msgspec.Meta(gt=0)]
    unit_of_measure: str
    tau_s: Annotated[float, msgspec.Meta(gt=0)] | None = None


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    revision: Annotated[str, msgspec.Meta(min_length=1)]
    limit: Annotated[tuple[_Entry, ...], msgspec.Meta(min_length=1)]


def converted_limits(content: str | bytes, where: str) -> tuple[str, list[dict[str, Any]]] | None:
    """Revision and limits of a file of screening limits, the limits as a specification has them; None for other files.

    Raises a BadInput if a limit is not right; the message names its place. Raises a DecodeError if the content is not
    TOML, or not a file of screening limits.
    """
    raw = decode_toml(content, dict[str, Any])
    limits = raw.get("limit")
    if not isinstance(limits, list) or not any(isinstance(each, dict) and "characteristic" in each for each in limits):
        return None
    file = decode_toml(content, _File)
    found = []
    for at, entry in enumerate(file.limit):
        _check(entry, f"{where}: $.limit[{at}] ({entry.characteristic})")
        metric, parameter = METRICS[entry.characteristic]
        limit = {"metric": metric, "signal": entry.signal, "upper": entry.upper}
        limit |= {"unit_of_measure": entry.unit_of_measure}
        found.append(limit if parameter is None else limit | {"parameters": {parameter: entry.tau_s}})
    return file.revision, found


def _check(entry: _Entry, where: str) -> None:
    if not math.isfinite(entry.upper) or not math.isfinite(entry.tau_s or 0.0):
        raise BadInput(f"{where}: upper and tau_s are finite numbers")
    if entry.characteristic == WALK:
        if entry.unit_of_measure != WALK_UNIT:
            raise BadInput(f"{where}: unit_of_measure is {WALK_UNIT!r}, not {entry.unit_of_measure!r}")
        if entry.tau_s not in (None, 1.0):
            raise BadInput(f"{where}: it is read at 1 s; leave tau_s out")
        return
    if entry.tau_s is None:
        raise BadInput(f"{where}: tau_s is missing")
    try:
        is_rate = is_angular_rate(check_unit(entry.unit_of_measure))
    except UnknownUnit as error:
        raise BadInput(f"{where}: {error}") from error
    if entry.signal == "rate" and not is_rate:
        raise BadInput(f"{where}: {entry.unit_of_measure!r} is no angular rate; for example deg/h")
