"""Run documents: the events of a run, in the manner of Bluesky's event model.

Each is JSON with a ``kind``, transported and stored beside the samples. Times are int64 nanoseconds on the
source's clock. A document is identified by its ``uid``: sent twice, it is the same document.
"""

from enum import StrEnum
from typing import Annotated, Any

import msgspec

from stream.decoding import json_decoder
from stream.errors import NewerSchema, WireError
from stream.events.document import Act as Act
from stream.events.document import ApprovedAct as ApprovedAct
from stream.events.document import Document as Document
from stream.events.document import Moment as Moment
from stream.events.document import Verdict as Verdict
from stream.events.document import new_uid as new_uid
from stream.events.store_events import RAW_ROWS_DROPPED as RAW_ROWS_DROPPED
from stream.events.store_events import RAW_ROWS_RESTORED as RAW_ROWS_RESTORED
from stream.events.store_events import ActProposed as ActProposed
from stream.events.store_events import AlertAcknowledged as AlertAcknowledged
from stream.events.store_events import AlertCleared as AlertCleared
from stream.events.store_events import AlertRaised as AlertRaised
from stream.events.store_events import AlertSent as AlertSent
from stream.events.store_events import CertificateIssued as CertificateIssued
from stream.events.store_events import ProposalRejected as ProposalRejected
from stream.events.store_events import SpecificationAction as SpecificationAction
from stream.events.store_events import SpecificationEntered as SpecificationEntered
from stream.events.store_events import StoreNoted as StoreNoted

EVENT_SCHEMA = 1


class RunStarted(Document, frozen=True, kw_only=True, tag=True):
    """A run begins; `date_known` is False where times count from an unknown moment."""

    date_known: bool = True
    simulated: bool = False
    source: str = ""
    units: tuple[str, ...] = ()
    procedure: str | None = None
    operator: str | None = None
    lot: str | None = None
    details: dict[str, str] = msgspec.field(default_factory=dict)

    @property
    def is_imported(self) -> bool:
        """Whether the run comes from a file."""
        return self.source.startswith("file ")


class StepWords(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Commanded values of a step, in the words that files, events and SQL share."""

    procedure: str | None = None
    step: str | None = None
    repeat: int | None = None
    position: str | None = None
    axis: str | None = None
    phase: str | None = None
    rate_command_deg_per_s: float | None = None
    temperature_command_deg_c: float | None = None
    frequency_hz: float | None = None
    amplitude: float | None = None
    settle_s: float | None = None
    room: bool | None = None


class StepStarted(Document, frozen=True, kw_only=True, tag=True):
    """A step of a unit begins at its first sample."""

    unit: str
    words: StepWords


class StepEnded(Document, frozen=True, kw_only=True, tag=True):
    """The step whose StepStarted has uid `step_uid` ends at its last sample.

    It counts only if its outcome is ``completed``; an ``interrupted`` one is measured again. `replaces` are steps of
    the same words whose samples are all in it, as of a file of which the whole came later.
    """

    unit: str
    step_uid: str
    outcome: str = "completed"
    replaces: tuple[str, ...] = ()


class PowerOn(Document, frozen=True, kw_only=True, tag=True):
    """A unit is powered on: a new epoch of its samples."""

    unit: str
    epoch: str
    slot: str | None = None


class PowerOff(Document, frozen=True, kw_only=True, tag=True):
    """A unit is powered off."""

    unit: str
    epoch: str


class UnitReleased(Document, frozen=True, kw_only=True, tag=True):
    """A unit is released from its run before the end, since its limits are decided: `verdict` is PASS or FAIL.

    Of its record of `planned_s` it has `recorded_s`.
    """

    unit: str
    verdict: Verdict
    planned_s: float
    recorded_s: float
    slot: str | None = None


class UnitMounted(Act, frozen=True, kw_only=True, tag=True):
    """A unit is mounted in a slot of the station; `details` are free, `by` is who listed it at an import."""

    unit: str
    product: str | None = None
    lot: str | None = None
    slot: str | None = None
    fixture: str | None = None
    operator: str | None = None
    firmware: str | None = None
    details: dict[str, str] = msgspec.field(default_factory=dict)
    by: str = ""


class NoteAdded(Act, frozen=True, kw_only=True, tag=True):
    """A note of a person or a program."""

    text: str
    author: str = ""
    unit: str | None = None

    @property
    def is_of_import(self) -> bool:
        """Whether the import of a file wrote it; its time is that of the file's last sample."""
        return self.author == "import"


class StationStated(Act, frozen=True, kw_only=True, tag=True):
    """Later details of the station of a run, in the words of the details of its `RunStarted`; the last one counts."""

    details: dict[str, str] = msgspec.field(default_factory=dict)
    by: str = ""


class CheckEntered(Act, frozen=True, kw_only=True, tag=True):
    """A manual check of a unit without an instrument of the station, with its verdict (GJB 2426A 5.2, 5.3).

    `run` is empty where it belongs to none. `item` is ``visual``, ``electrical``, or another check.
    """

    unit: str
    item: str
    verdict: Verdict
    by: str
    value: float | None = None
    unit_of_measure: str = ""
    lower: float | None = None
    upper: float | None = None
    note: str = ""


class ExclusionAction(StrEnum):
    """Change that a document makes to what is evaluated."""

    EXCLUDED = "excluded"
    INCLUDED = "included"


class ExclusionEntered(Act, frozen=True, kw_only=True, tag=True):
    """A run, or one `unit` of it, is excluded from every evaluation, or included again; the last one of a unit counts.

    With a `check` it is only the `CheckEntered` of that uid. Samples and documents stay in the log.
    """

    action: ExclusionAction
    by: str
    reason: str
    unit: str | None = None
    check: str = ""


class Limit(msgspec.Struct, frozen=True, kw_only=True):
    """An upper limit on a characteristic, in `unit_of_measure`."""

    characteristic: str
    signal: str
    tau_s: float | None
    upper: float
    unit_of_measure: str


class LimitsApplied(Document, frozen=True, kw_only=True, tag=True):
    """Live limits that a run is judged by; with the planned duration it can be decided early.

    `revision` has the specifications that the limits are of, such as ``FOG-70-B``. They apply to every unit of the run
    where `unit` is left out, and to the whole run where `since_ns`, the start of a record of `planned_s`, is.
    """

    revision: str
    limits: tuple[Limit, ...]
    planned_s: float | None = None
    unit: str | None = None
    since_ns: Moment | None = None


class EstimatePoint(msgspec.Struct, frozen=True, kw_only=True):
    """One value with its confidence bounds; `edf` are degrees of freedom, `n` the number of averages or windows.

    `plausible` are the exponents alpha of the noises S_y(f) ~ f**alpha that are possible at this tau, and whose least
    degrees of freedom `edf` are; empty where not determined.
    """

    tau_s: float
    value: float
    lo: float
    hi: float
    edf: float
    n: int
    plausible: tuple[int, ...] = ()


class EstimatePublished(Document, frozen=True, kw_only=True, tag=True):
    """Estimates of a signal at `t_ns`: points, or a reason why there are none.

    They are published every `every_ns` of the signal's time, 0 if unknown. `longest_still`: samples of the longest
    stretch in which all are alike, counted where the signal has limits.
    """

    unit: str
    signal: str
    estimator: str
    unit_of_measure: str
    confidence: float
    samples: int
    missing: int
    sample_interval_s: float
    every_ns: int = 0
    final: bool = False
    points: tuple[EstimatePoint, ...] = ()
    reason: str | None = None
    longest_still: int = 0


class NoiseFitted(Document, frozen=True, kw_only=True, tag=True):
    """The noise coefficients of a finished run's Allan deviation (IEEE 952), or a reason why there are none."""

    unit: str
    signal: str
    coefficients: dict[str, Any] | None = None
    reason: str | None = None


class SpectralLinesFound(Document, frozen=True, kw_only=True, tag=True):
    """The sinusoids in the spectrum of a finished run, or a reason why there was no spectrum.

    The search covers `searched_lo_hz` to `searched_hi_hz`, in bins of `bin_width_hz`.
    """

    unit: str
    signal: str
    lines: tuple[dict[str, float], ...] | None
    unit_of_measure: str = ""
    searched_lo_hz: float | None = None
    searched_hi_hz: float | None = None
    bin_width_hz: float | None = None
    segments: int = 0
    reason: str | None = None


class EarlyDecision(Document, frozen=True, kw_only=True, tag=True):
    """A look at one limit during the run: PASS, FAIL or UNDECIDED, its rule, and the forecast of the decision."""

    unit: str
    signal: str
    limit: Limit
    outcome: str
    rule: str
    error_probability: float | None
    looked_at_fraction: float
    reason: str
    reason_zh: str
    forecast_s: float | None = None
    forecast_latest_s: float | None = None


class Check(msgspec.Struct, frozen=True, kw_only=True):
    """One limit compared with one estimate."""

    limit: Limit
    verdict: Verdict
    value: float | None = None
    lo: float | None = None
    hi: float | None = None
    reason: str | None = None


class VerdictGiven(Document, frozen=True, kw_only=True, tag=True):
    """A unit's verdict with its checks."""

    unit: str
    verdict: Verdict
    checks: tuple[Check, ...] = ()


class ModelActivated(ApprovedAct, frozen=True, kw_only=True, tag=True):
    """A version of the error model of a unit's signal is activated or deactivated.

    `model` is the hash of the version. `stage` is ``live``, ``shadow`` (only monitored) or ``off``. `run` is empty.
    Where two persons are needed, `store` is the identity of its store, `seal` the seal.
    """

    unit: str
    model: str
    version: int
    signal: str = "rate"
    stage: str = "live"
    reason: str = ""
    by: str = ""
    store: str = ""
    seal: str = ""


class CompensationStarted(Document, frozen=True, kw_only=True, tag=True):
    """A signal of one power-on is compensated by a version of its error model, from its first sample to its last.

    Sample 0 of `compensated` in `compensated_epoch` is sample `first_seq` of `signal` in `epoch`, and so on.
    """

    unit: str
    signal: str
    epoch: str
    model: str
    version: int
    compensated: str
    compensated_epoch: str
    first_seq: int = 0


class ResidualWatched(Document, frozen=True, kw_only=True, tag=True):
    """Comparison of a version of an error model with the one that it replaced, over a stretch of a run.

    `gain` is the whitened log-likelihood of the version less that of the other, or None for a `reason`; `cusum` the
    cumulative loss, not below 0, over the stretches since the document `activation` activated it. Above `threshold`
    the version is refused (`is_refused`), and the residual must be traced again.
    """

    unit: str
    signal: str
    model: str
    version: int
    activation: str
    stretch: str
    blocks: int
    gain: float | None
    cusum: float
    threshold: float
    is_refused: bool = False
    reason: str | None = None


class RunAction(StrEnum):
    """What the station of a run can be commanded."""

    PAUSE = "pause"
    RESUME = "resume"
    ABORT = "abort"


class RunCommandGiven(Document, frozen=True, kw_only=True, tag=True):
    """A person or a program commands the station of a run; the `uid` names the command.

    `t_ns` is when the station took it, `given_ns` when it was given, by the clock of whoever gave it.
    """

    action: RunAction
    by: str
    reason: str
    given_ns: Moment


class CommandOutcome(StrEnum):
    """What came of a command."""

    ACCEPTED = "accepted"  # it is being carried out
    DONE = "done"
    REFUSED = "refused"  # by the station, or since the run has ended
    UNANSWERED = "unanswered"  # withdrawn before the station took it


class RunCommandAnswered(Document, frozen=True, kw_only=True, tag=True):
    """What came of the command whose RunCommandGiven has the uid `command`."""

    command: str
    outcome: CommandOutcome
    text: str
    text_zh: str = ""


class RunResumed(Document, frozen=True, kw_only=True, tag=True):
    """A run continues under its id after an interruption of `gap_ns`."""

    gap_ns: int
    reason: str = ""


class StreamTotal(msgspec.Struct, frozen=True, kw_only=True):
    """Total number of samples of one signal and epoch."""

    unit: str
    signal: str
    epoch: str
    samples: int


class RunEnded(Document, frozen=True, kw_only=True, tag=True):
    """A run ends; `totals` are the contents of its complete record.

    `released` units were released before, which has saved `saved_s` of their planned records together.
    """

    outcome: str = "completed"
    totals: tuple[StreamTotal, ...] = ()
    released: int = 0
    saved_s: float = 0.0


AnyDocument = (
    RunStarted | StepStarted | StepEnded | PowerOn | PowerOff | UnitReleased | UnitMounted | NoteAdded | StationStated
    | CheckEntered | ExclusionEntered | SpecificationEntered | CertificateIssued | LimitsApplied | EstimatePublished
    | NoiseFitted | SpectralLinesFound | EarlyDecision | VerdictGiven | ModelActivated | CompensationStarted
    | ResidualWatched | RunResumed | StoreNoted | RunEnded | AlertRaised | AlertCleared | AlertSent | AlertAcknowledged
    | RunCommandGiven | RunCommandAnswered | ActProposed | ProposalRejected
)  # fmt: skip


class EventMessage(msgspec.Struct, frozen=True, kw_only=True):
    """A document on the wire, numbered by its source like samples."""

    schema: int
    epoch: str
    seq: Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]
    document: AnyDocument


class _Head(msgspec.Struct):
    schema: int


_encoder = msgspec.json.Encoder()
_decoder = json_decoder(EventMessage)
_head_decoder = json_decoder(_Head)


def encode_event(document: AnyDocument, epoch: str, seq: int) -> bytes:
    """The wire form (JSON) of a document."""
    return _encoder.encode(EventMessage(schema=EVENT_SCHEMA, epoch=epoch, seq=seq, document=document))


def decode_event(payload: bytes) -> EventMessage:
    """Read a document from its wire form.

    Raises a NewerSchema if it was written by a newer gyrofleet, a WireError if it is not a document.
    """
    try:
        schema = _head_decoder.decode(payload).schema
        if schema > EVENT_SCHEMA:
            raise NewerSchema(f"event of schema {schema}, this gyrofleet reads up to {EVENT_SCHEMA}: upgrade this side")
        if schema < 1:
            raise WireError(f"not a run document: schema {schema}")
        return _decoder.decode(payload)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise WireError(f"not a run document: {error}") from error


def document_schema() -> dict[str, Any]:
    """JSON schema of the documents, embedded in every log segment."""
    return msgspec.json.schema(EventMessage)
