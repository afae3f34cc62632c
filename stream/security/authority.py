"""Authority by kind of document: what a principal's role lets it put on record."""

from functools import lru_cache

from stream import events
from stream.errors import WireError
from stream.identity import EstimateKey, EventKey, SampleKey
from stream.security.actor import UNAUTHENTICATED
from stream.security.rights import Principal, Role, includes, rights_of

_COMPENSATED = "_compensated"
_ESTIMATES = (
    events.EstimatePublished, events.NoiseFitted, events.SpectralLinesFound, events.EarlyDecision, events.VerdictGiven,
)  # fmt: skip
_OF_STATIONS = (
    events.RunStarted, events.StepStarted, events.StepEnded, events.PowerOn, events.PowerOff, events.UnitReleased,
    events.UnitMounted, events.NoteAdded, events.StationStated, events.CheckEntered, events.LimitsApplied,
    events.RunResumed, events.RunEnded, events.RunCommandGiven, events.RunCommandAnswered,
)  # fmt: skip
_OF_APPROVERS = (
    events.ModelActivated, events.SpecificationEntered, events.CertificateIssued, events.NoteAdded, events.CheckEntered,
    events.ExclusionEntered, events.ActProposed, events.ProposalRejected, events.AlertAcknowledged,
    events.RunCommandGiven, events.RunCommandAnswered,
)  # fmt: skip
_OF_ESTIMATORS = (events.CompensationStarted, events.NoteAdded)
_NAMED_BY = (
    events.ModelActivated, events.SpecificationEntered, events.CheckEntered, events.ExclusionEntered,
    events.AlertAcknowledged, events.ActProposed, events.ProposalRejected,
)  # fmt: skip


class NotAuthorised(WireError):
    """A message that its source may not put on record."""


@lru_cache(maxsize=200_000)
def _may_send(source: Principal, key: str) -> bool:
    return any(includes(each, key) for each in rights_of(source).publishes)


def check_authority(
    source: Principal, key: str, parsed: SampleKey | EventKey | EstimateKey, document: events.AnyDocument | None
) -> None:
    """Raise NotAuthorised if a source may not send a document, or samples where it is None, under a key."""
    if not _may_send(source, key):
        raise NotAuthorised(f"{source} may not send under this key")
    if isinstance(parsed, SampleKey):
        if source.role is Role.ESTIMATOR and not parsed.signal.endswith(_COMPENSATED):
            raise NotAuthorised(f"{source} may send compensated samples only")
        return
    if isinstance(parsed, EstimateKey):
        allowed: tuple[type, ...] = _ESTIMATES
    elif source.role is Role.RECORDER:
        return  # the store itself; what it seals is checked by its seal
    else:
        allowed = {
            Role.STATION: _OF_STATIONS, Role.ESTIMATOR: _OF_ESTIMATORS, Role.APPROVER: _OF_APPROVERS
        }.get(source.role, ())  # fmt: skip
    if not isinstance(document, allowed):
        raise NotAuthorised(f"{source} may not send a {type(document).__name__}")
    if isinstance(document, events.Act):
        _check_identity(source, document)


def _check_identity(source: Principal, document: events.Act) -> None:
    """Raise NotAuthorised if a document names another person than its source; an approver acts as nobody else."""
    own = source.common_name
    is_person = source.role is Role.APPROVER
    if document.identity != own and (is_person or document.identity not in {"", UNAUTHENTICATED}):
        claimed = document.identity or "nobody"
        raise NotAuthorised(f"{source} may not act as {claimed[:80]}: the identity of a document is that of its source")
    if is_person and isinstance(document, _NAMED_BY) and document.by != own:
        raise NotAuthorised(f"{source} may not act in the name of {document.by[:80]!r}")
    if is_person and isinstance(document, events.NoteAdded) and document.author not in {own, source.name}:
        raise NotAuthorised(f"{source} may not write a note of {document.author[:80]!r}")
