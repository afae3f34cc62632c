"""Which version of a unit's error model is in use: the latest document in the store's log, not a file."""

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum

import msgspec

from analytics.loop.model.model_registry import ModelRegistry, ModelVersion
from ingest.importing.entered import enter
from storage.log.store_documents import sealed
from storage.log.tail import documents_beyond
from storage.manifests.lake import read_manifest
from storage.recording.acts.proposing import carried_out, has_to_be_proposed, propose
from storage.recording.acts.two_persons import Proposal
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.decoding import decode_json
from stream.errors import BadInput, NotFound, QueryError, StoreError
from stream.events import ActProposed, AnyDocument, ModelActivated, new_uid
from stream.security.actor import Actor

_ROLE = "gyrofleet model"
_SQL = "select document from events where list_contains($kinds, kind) order by t_ns"


class Stage(StrEnum):
    """Use of a version."""

    LIVE = "live"  # it compensates the live stream
    SHADOW = "shadow"  # it is only monitored
    OFF = "off"


@dataclass(frozen=True)
class InUse:
    """Versions in use for a unit's signal, each as the document that activated it."""

    live: ModelActivated | None = None
    shadow: ModelActivated | None = None
    before: tuple[ModelActivated, ...] = ()  # live versions that the live one replaced, the latest last

    def after(self, document: ModelActivated) -> "InUse":
        """Use after a document.

        >>> one = ModelActivated(run="", t_ns=0, unit="U1", model="a", version=1, stage="shadow")
        >>> InUse().after(one).shadow is one, InUse().after(one).live
        (True, None)
        """
        live, shadow = (each if each and each.model != document.model else None for each in (self.live, self.shadow))
        if document.stage == Stage.LIVE:
            return InUse(document, shadow, self._before(document))
        return InUse(live, document if document.stage == Stage.SHADOW else shadow, self.before)

    def _before(self, document: ModelActivated) -> tuple[ModelActivated, ...]:
        """Versions that a new live one replaces; one that returns has those that were before it then."""
        models = [each.model for each in self.before]
        if self.live is None:
            return self.before[: models.index(document.model)] if document.model in models else ()
        others = (*self.before, self.live)
        return tuple(each for each in others if each.model != document.model)

    def stage(self, model: str) -> Stage:
        """Use of the version with that hash."""
        if self.live is not None and self.live.model == model:
            return Stage.LIVE
        return Stage.SHADOW if self.shadow is not None and self.shadow.model == model else Stage.OFF

    @property
    def activations(self) -> tuple[ModelActivated, ...]:
        """The documents that activated the versions in use."""
        return tuple(each for each in (self.live, self.shadow) if each is not None)


Uses = dict[tuple[str, str], InUse]  # versions in use, by unit and signal


def logged_documents(store: Store, kinds: Iterable[type[AnyDocument]]) -> list[AnyDocument]:
    """Documents of some kinds in a store, those not yet in the lake included, in the order of their times."""
    wanted = tuple(kinds)
    in_lake = read_manifest(store).segments
    found: dict[str, AnyDocument] = {}
    with Catalog(store) as catalog:
        try:
            for (text,) in catalog.rows(_SQL, {"kinds": [each.__name__ for each in wanted]}):
                decoded: AnyDocument = decode_json(text, AnyDocument)
                found[decoded.uid] = decoded
        except (QueryError, msgspec.MsgspecError, UnicodeDecodeError) as error:
            raise StoreError(
                f"documents in the lake of {store.folder} cannot be read ({error}); `gyrofleet verify` says what is "
                f"damaged, `gyrofleet recover` rebuilds it from the log"
            ) from error
    for document, _ in documents_beyond(store, in_lake):
        if isinstance(document, wanted):
            found.setdefault(document.uid, document)
    return sorted(found.values(), key=lambda each: each.t_ns)


def uses_of(documents: Iterable[AnyDocument]) -> Uses:
    """Versions in use after these documents, in their order."""
    found: Uses = {}
    for document in documents:
        if isinstance(document, ModelActivated):
            whose = (document.unit, document.signal)
            found[whose] = found.get(whose, InUse()).after(document)
    return found


def read_uses(store: Store) -> Uses:
    """Versions in use in a store now."""
    return uses_of(logged_documents(store, (ModelActivated,)))


def activation(version: ModelVersion, stage: Stage, reason: str, by: Actor, *, after_ns: int | None) -> ModelActivated:
    """The document that puts a version to use, later than the one before it; BadInput if it must not go live."""
    if stage is Stage.LIVE and not version.is_confirmed:
        raise BadInput(
            f"unit {version.unit}, version {version.version}: {', '.join(version.added)} was not confirmed by held-out "
            "runs, so that it cannot go live; measure more runs, or put it to use with --shadow"
        )
    now_ns = time.time_ns()
    return ModelActivated(
        run="",
        t_ns=now_ns if after_ns is None else max(now_ns, after_ns + 1),
        unit=version.unit,
        model=version.hash,
        version=version.version,
        signal=version.signal,
        stage=stage.value,
        reason=reason,
        by=by.name,
        identity=by.identity,
    )


def activate(
    store: Store, version: ModelVersion, stage: Stage, *, reason: str, by: Actor, approved: Proposal | None = None
) -> ModelActivated | ActProposed:
    """Put a version to use, or propose it where another person has to approve; the log has it when this returns.

    `approved` is the proposal that is carried out. BadInput if it must not be used, or is in that use already.
    """
    use = read_uses(store).get((version.unit, version.signal), InUse())
    if use.stage(version.hash) is stage:
        raise BadInput(f"unit {version.unit}: version {version.version} of its error model is {stage.value} already")
    document = activation(version, stage, reason, by, after_ns=_last_ns(use))
    if approved is not None:
        document = sealed(store, carried_out(approved, document, by, not_before_ns=document.t_ns))
    elif has_to_be_proposed(store, ModelActivated):
        return propose(store, document, by=by, reason=reason, unit=version.unit)
    enter_activations(store, [document])
    return document


def carry_out(store: Store, proposal: Proposal, by: Actor) -> ModelActivated:
    """Put the version that was proposed to use, as another person who approves it."""
    act = proposal.act
    assert isinstance(act, ModelActivated)
    version = ModelRegistry(store).by_hash(act.unit, act.model)
    done = activate(store, version, Stage(act.stage), reason=act.reason, by=by, approved=proposal)
    assert isinstance(done, ModelActivated)
    return done


def enter_activations(store: Store, documents: Sequence[AnyDocument]) -> None:
    """Write documents to the store's log; they are then on disk."""
    enter(store.folder, documents, role=_ROLE)


def rollback_documents(
    registry: ModelRegistry, use: InUse, stage: Stage, *, reason: str, by: Actor
) -> list[ModelActivated]:
    """The documents that end the use of the live or shadow version; the previous live version replaces a live one."""
    taken = use.live if stage is Stage.LIVE else use.shadow
    if taken is None:
        raise BadInput(f"no version of the error model is {stage.value}: there is nothing to roll back")
    off_ns = max(time.time_ns(), (_last_ns(use) or 0) + 1)
    off = msgspec.structs.replace(
        taken, uid=new_uid(), t_ns=off_ns, stage=Stage.OFF.value, reason=reason, by=by.name, identity=by.identity
    )
    if stage is not Stage.LIVE or not use.before:
        return [off]
    earlier = use.before[-1]
    try:
        back = registry.by_hash(taken.unit, earlier.model)
    except (NotFound, StoreError):  # the live version is taken out of use all the same
        lost = f"{reason}; version {earlier.version}, live before it, cannot be read and does not take its place"
        return [msgspec.structs.replace(off, reason=lost)]
    why = f"in place of version {taken.version}: {reason}"
    return [off, activation(back, Stage.LIVE, why, by, after_ns=off.t_ns)]


def _last_ns(use: InUse) -> int | None:
    return max((each.t_ns for each in use.activations), default=None)
