"""Units that several plants have, and what the plants state differently of them."""

from collections import defaultdict
from collections.abc import Iterable
from contextlib import suppress

import msgspec

from storage.fleet_store import Replica
from storage.manifests.lake import read_manifest
from storage.sql.catalog import Catalog
from stream.decoding import decode_json
from stream.files.atomic_file import write_durably

_FILE = "identities.json"
_STATED = ("product", "lot", "device")
_SQL = """
select unit, list_sort(list(distinct product)), list_sort(list(distinct lot)),
  list_sort(list(distinct details->>'$.device'))
from units group by unit order by unit
"""


class Stated(msgspec.Struct, frozen=True):
    """What a plant states of a unit, over all of its runs."""

    product: tuple[str, ...] = ()
    lot: tuple[str, ...] = ()
    device: tuple[str, ...] = ()


class Conflict(msgspec.Struct, frozen=True):
    """A unit of which plants state different things: `field` is product, lot or device, `plants` what each states."""

    unit: str
    field: str
    plants: dict[str, tuple[str, ...]]

    def __str__(self) -> str:
        """In words.

        >>> print(Conflict("FOG-1", "product", {"a": ("F70",), "b": ("F98",)}))
        unit FOG-1 has another product in each plant: a: F70; b: F98. They are kept apart; is it one device?
        """
        each = "; ".join(f"{plant}: {', '.join(stated)}" for plant, stated in sorted(self.plants.items()))
        return (
            f"unit {self.unit} has another {self.field} in each plant: {each}. They are kept apart; is it one device?"
        )


class _Kept(msgspec.Struct, frozen=True):
    lake: int  # number of the lake's manifest from which they are
    units: dict[str, Stated]


def identities(replica: Replica) -> dict[str, Stated]:
    """What a plant states of its units, by its lake; read again only after that has changed."""
    path = replica.folder / _FILE
    number = read_manifest(replica.store).number
    with suppress(OSError, msgspec.MsgspecError):
        kept = decode_json(path.read_bytes(), _Kept)
        if kept.lake == number:
            return kept.units
    with Catalog(replica.store) as catalog:
        found = {
            str(unit): Stated(*(tuple(each for each in stated or () if each is not None) for stated in of_unit))
            for unit, *of_unit in catalog.rows(_SQL)
        }
    with suppress(OSError):  # it is read again
        write_durably(path, msgspec.json.encode(_Kept(number, found)))
    return found


def conflicts(replicas: Iterable[Replica]) -> list[Conflict]:
    """Units of which plants state different things, by unit; one that all state alike has moved, and is none."""
    by_unit: defaultdict[str, dict[str, Stated]] = defaultdict(dict)
    for replica in replicas:
        for unit, stated in identities(replica).items():
            by_unit[unit][replica.plant.name] = stated
    found = []
    for unit, plants in sorted(by_unit.items()):
        for field in _STATED if len(plants) > 1 else ():
            of_field = {name: value for name, stated in plants.items() if (value := getattr(stated, field))}
            if len(set(of_field.values())) > 1:
                found.append(Conflict(unit, field, of_field))
    return found
