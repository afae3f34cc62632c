"""Versions of error models, and which of them are in use."""

from typing import TYPE_CHECKING, Any

import msgspec

from analytics.serve.api.rows import iso
from storage.store import Store

if TYPE_CHECKING:
    from analytics.loop.model.model_registry import ModelVersion
    from analytics.loop.model.model_use import InUse


class ModelRow(msgspec.Struct, frozen=True, kw_only=True):
    """A version of the error model of a unit's signal.

    `holdout` is the answer of the held-out runs, `error` the error with the declared model and with this one, None in
    versions of earlier releases.
    """

    unit: str
    signal: str
    version: int
    hash: str
    parent: str | None
    stage: str
    verdict: str
    text: str
    added: list[str]
    confounded: list[str]
    is_confirmed: bool
    holdout: dict[str, Any] | None
    error: dict[str, Any] | None
    terms: list[dict[str, Any]]
    runs: list[str]
    made_ns: int
    made: str | None
    by: str
    note: str


def models_of(store: Store, unit: str) -> list[ModelRow]:
    """Versions of a unit by increasing number; damaged ones are left to `gyrofleet verify`."""
    from analytics.loop.model.model_registry import ModelRegistry
    from analytics.loop.model.model_use import InUse, read_uses

    versions, _ = ModelRegistry(store).readable(unit)
    if not versions:
        return []
    uses = read_uses(store)
    return [model_row(version, uses.get((version.unit, version.signal), InUse())) for version in versions]


def model_row(version: "ModelVersion", use: "InUse") -> ModelRow:
    """A version with its use."""
    model = version.model
    terms = [
        {"term": label, "coefficient": value, "standard_uncertainty": float(error), "unit_of_measure": per}
        for label, value, error, per in zip(model.labels(), model.coefficients, model.errors, model.units, strict=False)
    ]
    return ModelRow(
        unit=version.unit, signal=version.signal, version=version.version, hash=version.hash, parent=version.parent,
        stage=use.stage(version.hash).value, verdict=version.verdict, text=version.text, added=list(version.added),
        confounded=list(version.confounded), is_confirmed=version.is_confirmed, holdout=version.holdout,
        error=version.error, terms=terms, runs=list(version.runs), made_ns=version.made_ns,
        made=iso(version.made_ns), by=version.by, note=version.note,
    )  # fmt: skip
