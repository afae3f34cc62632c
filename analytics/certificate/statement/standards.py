"""The standards by which certificates are issued: what a certificate states, and the environment that they ask for."""

import tomllib
from functools import lru_cache
from importlib.resources import files

import msgspec

from analytics.certificate.statement.words import Words
from stream.decoding import converted
from stream.errors import BadInput


class Item(msgspec.Struct, frozen=True, kw_only=True):
    """One thing that a certificate states: its clause, and the name of the function of `content` that fills it."""

    clause: str
    filled_by: str
    en: str
    zh: str


class Standard(msgspec.Struct, frozen=True, kw_only=True):
    """A standard, as `standards.toml` describes it."""

    name: str
    code: str
    title: Words
    inner_page: Words
    device: Words
    items: tuple[Item, ...]
    temperature_deg_c: tuple[float, float]
    relative_humidity_percent: tuple[float, float]
    temperature_change_deg_c: float | None = None


@lru_cache(maxsize=1)
def standards() -> dict[str, Standard]:
    """All standards by name.

    >>> [item.clause for item in standards()["JJF2014"].items][:3]
    ['8 a', '8 b', '8 c']
    """
    text = files("analytics.certificate.statement").joinpath("standards.toml").read_text(encoding="utf-8")
    found = tomllib.loads(text)
    return {name: converted({**table, "name": name}, Standard) for name, table in found.items()}


def standard_of(text: str) -> Standard:
    """The standard that a person names; raises BadInput if no certificate is issued by it.

    >>> standard_of("JJF 1536-2015").code
    'JJF 1536-2015'
    """
    name, _, year = text.strip().upper().replace(" ", "").replace("—", "-").partition("-")
    found = standards().get(name)
    if found is None:
        raise BadInput(f"no certificate is issued by {text!r}; there are {', '.join(standards())}")
    if year and year != found.code.partition("-")[2]:
        raise BadInput(f"certificates are issued by {found.code}, not by {text.strip()}")
    return found
