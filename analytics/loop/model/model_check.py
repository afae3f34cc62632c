"""The part of `gyrofleet verify` on error models: each is as it was written, and each model in use exists."""

from analytics.loop.model.model_registry import FOLDER, ModelRegistry
from analytics.loop.model.model_use import read_uses
from storage.findings import Finding, Severity
from storage.store import Store
from stream.errors import GyrofleetError, NotFound, StoreError

_REMEDY = "bring the file back from a copy of the store, or `gyrofleet model rollback`"


def model_findings(store: Store) -> list[Finding]:
    """Findings on a store's error models; an entry point in the group `gyrofleet.verify`."""
    registry = ModelRegistry(store)
    found = []
    for unit in registry.units():
        where = str(store.folder / FOLDER / unit)
        try:
            damaged = list(registry.readable(unit)[1].values())
        except GyrofleetError as error:  # the folder's name is not that of a unit
            damaged = [str(error)]
        found += [Finding("model_damaged", Severity.DAMAGE, where, why, _REMEDY) for why in damaged]
    try:
        uses = read_uses(store)
    except StoreError:
        return found  # the log or the lake is damaged, which its own check reports
    for (unit, signal), use in uses.items():
        for activated in use.activations:
            try:
                registry.by_hash(unit, activated.model)
            except NotFound:
                where = str(store.folder / FOLDER / unit)
                what = f"version {activated.version} of the error model of {signal}, which is in use, is not there"
                found.append(Finding("model_missing", Severity.DAMAGE, where, what, _REMEDY))
            except StoreError:
                continue  # reported above
    return found
