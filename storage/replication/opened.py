"""The sources that an address names: a store's folder, a fleet store's, an endpoint, or a bucket."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

from storage.fleet_store import FleetStore, is_fleet
from storage.plant import read_plant
from storage.replication.addresses import is_bucket, is_endpoint
from storage.replication.sources.bus_source import BusSource
from storage.replication.sources.folder_source import FolderSource
from storage.replication.sources.source import SegmentSource
from storage.store_marker import MARKER, read_marker
from stream.errors import BadInput, StoreError

_ONE = "--plant names one plant; give one --from with it"


@contextmanager
def opened_sources(
    addresses: Sequence[str], plant: str | None, endpoint_url: str | None = None
) -> Iterator[list[SegmentSource]]:
    """The plants behind the addresses; `plant` is the name of one at its first use, or which of several is meant.

    `endpoint_url` is of the object store, where an address is one of a bucket.
    """
    with ExitStack() as stack:
        found: list[SegmentSource] = []
        for address in addresses:
            folder = Path(address)
            if is_endpoint(address):
                if plant is not None and len(addresses) > 1:
                    raise BadInput(_ONE)
                found.append(stack.enter_context(BusSource(address, plant)))
            elif is_bucket(address):
                from storage.object_lake.bucket import Bucket
                from storage.replication.sources.bucket_source import BucketSource

                found.append(stack.enter_context(BucketSource(Bucket(address, endpoint_url), plant)))
            elif is_fleet(folder):
                fleet = FleetStore.open(folder)
                chosen = fleet.replicas() if plant is None else [fleet.replica(plant)]
                found += [stack.enter_context(FolderSource(each.store.folder)) for each in chosen]
            else:
                if plant is not None and len(addresses) > 1:
                    raise BadInput(_ONE)
                if not folder.exists():
                    raise StoreError(
                        f"--from {address}: there is no such folder; give a plant's store, its endpoint as "
                        "tcp/10.0.0.7:7448, or s3://BUCKET/PREFIX"
                    )
                found.append(stack.enter_context(FolderSource(folder, plant)))
        yield found


@contextmanager
def recalled_from(
    address: str, target: Path, plant: str | None, endpoint_url: str | None = None
) -> Iterator[SegmentSource]:
    """The copy of the plant whose store `target` is; a folder that is none yet needs the plant's name."""
    known = read_plant(target)
    name = plant or (None if known is None else known.name)
    if is_fleet(Path(address)):
        fleet = FleetStore.open(Path(address))
        if name is None and (target / MARKER).exists():
            of_store = [each for each in fleet.replicas() if each.plant.store == read_marker(target / MARKER)]
            name = of_store[0].plant.name if of_store else None
        if name is None:
            raise BadInput(f"which plant of {address} is to be brought back to {target}? Give --plant NAME")
        with FolderSource(fleet.replica(name).store.folder) as source:
            yield source
        return
    with opened_sources([address], name, endpoint_url) as found:
        yield found[0]
