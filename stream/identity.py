"""Names of units, signals and runs, and the key expressions of their messages.

Samples     ``gyrofleet/<site>/<station>/<unit>/<signal>``
Estimates   ``gyrofleet/<site>/<station>/<unit>/<signal>/estimate/<estimator>``
Events      ``gyrofleet/<site>/<station>/event``
Control     ``gyrofleet/@<topic>`` (a chunk that starts with ``@`` is matched by no wildcard)
"""

import re
from functools import lru_cache
from typing import NamedTuple

from stream.bounds import MAX_KEY_CHARS, MAX_NAME_CHARS
from stream.errors import BadInput

ROOT = "gyrofleet"
EVERYTHING = f"{ROOT}/**"
ACKNOWLEDGEMENT_KEY = f"{ROOT}/@acknowledgement"

# A chunk of a Zenoh key expression contains none of / * $ ? #; white space and a leading @ or . confuse people.
_NAME = re.compile(rf"[^\s/\\*$?#@.][^\s/\\*$?#]{{0,{MAX_NAME_CHARS - 1}}}")
NAME_RULE = (
    f"1 to {MAX_NAME_CHARS} characters without white space, / \\ * $ ? #, and characters that nobody sees, not "
    "starting with @ or a dot"
)


class Place(NamedTuple):
    """Origin of samples: a site and one of its stations."""

    site: str
    station: str


UNSTATED = Place("local", "files")  # of imported files, where nobody says where they were measured


class SampleKey(NamedTuple):
    """The parts of a samples' key expression."""

    place: Place
    unit: str
    signal: str


class EstimateKey(NamedTuple):
    """The parts of an estimate's key expression."""

    place: Place
    unit: str
    signal: str
    estimator: str


class EventKey(NamedTuple):
    """The parts of a run document's key expression."""

    place: Place


def check_name(kind: str, name: str) -> str:
    """Return `name` if it can be part of a key expression; `kind`, such as ``unit``, is for the message.

    Raises a BadInput if it is no name, see `is_name`. Names are identities, and nothing else: whatever shows or keeps
    one treats it as text, since ``=1+1`` and ``<b>`` are names too.

    >>> check_name("unit", "FOG-0231")
    'FOG-0231'
    """
    if not is_name(name):
        shown = name if len(name) <= MAX_NAME_CHARS else f"{name[:MAX_NAME_CHARS]}..."
        raise BadInput(f"{kind} {shown!r} cannot be used as a name: {NAME_RULE}; rename it, for example FOG-0231")
    return name


@lru_cache(maxsize=200_000)
def is_name(text: str) -> bool:
    r"""Whether a text can be the name of a unit, signal, run, site, station or procedure.

    It has 1 to 128 characters: no white space, none of ``/ \ * $ ? #``, no control characters, no marks of writing
    direction or others that nobody sees, no halves of characters; the first is not ``@`` or a dot.

    >>> [is_name(each) for each in ("FOG-0231", "零偏", "..", "a/b", "a b", "a\x1b[31m", "a\u202eb", "")]
    [True, True, False, False, False, False, False, False]
    """
    return text.isprintable() and _NAME.fullmatch(text) is not None


def cleaned_name(text: str) -> str:
    """A text with an underscore for each stretch of characters that no name has; empty if nothing is left.

    >>> cleaned_name("Yaw Rate/2")
    'Yaw_Rate_2'
    """
    kept = "".join(each if is_name(f"x{each}") else "\0" for each in text)
    return re.sub("\0+", "_", kept).lstrip(".@")


def sample_key(place: Place, unit: str, signal: str) -> str:
    """Key expression of the samples of one signal.

    >>> sample_key(Place("plant", "chamber-2"), "FOG-0231", "rate")
    'gyrofleet/plant/chamber-2/FOG-0231/rate'
    """
    return f"{ROOT}/{place.site}/{place.station}/{unit}/{signal}"


def estimate_key(place: Place, unit: str, signal: str, estimator: str) -> str:
    """Key expression of one estimator's results for one signal."""
    return f"{sample_key(place, unit, signal)}/estimate/{estimator}"


def event_key(place: Place) -> str:
    """Key expression of the run documents of one station."""
    return f"{ROOT}/{place.site}/{place.station}/event"


def parse_key(key: str) -> SampleKey | EstimateKey | EventKey:
    """The parts of a key expression; a BadInput if it is none of the three forms above.

    >>> parse_key("gyrofleet/plant/chamber-2/event")
    EventKey(place=Place(site='plant', station='chamber-2'))
    """
    if len(key) > MAX_KEY_CHARS:
        raise BadInput(f"key expression {key[:80]!r}... has {len(key)} characters, at most {MAX_KEY_CHARS} are allowed")
    match key.split("/"):
        case [root, site, station, "event"] if root == ROOT:
            return EventKey(Place(site, station))
        case [root, site, station, unit, signal] if root == ROOT:
            return SampleKey(Place(site, station), unit, signal)
        case [root, site, station, unit, signal, "estimate", estimator] if root == ROOT:
            return EstimateKey(Place(site, station), unit, signal, estimator)
    raise BadInput(f"key expression {key!r} is not one of gyrofleet's: expected {ROOT}/<site>/<station>/...")
