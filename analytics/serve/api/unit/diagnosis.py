"""Diagnoses: error models of units and how they were used; a new diagnosis as a job; promotion and rollback."""

from typing import Annotated, Any, Literal

import msgspec

from analytics.serve.api.jobs import JobDocument, JobRow, document_of, job_row
from analytics.serve.api.operation import Call, Nothing, get, post
from analytics.serve.api.rows import Name, iso
from analytics.serve.api.unit.models import ModelRow, models_of
from analytics.serve.api.unit.units import unit_row
from analytics.serve.doors.roles import Role
from analytics.serve.jobs import Job
from analytics.serve.problems import Conflict
from stream.errors import BadInput
from stream.events import ModelActivated, ResidualWatched

Text = Annotated[str, msgspec.Meta(max_length=2000)]
Reason = Annotated[str, msgspec.Meta(min_length=3, max_length=1000)]


class DiagnosedUnit(msgspec.Struct, frozen=True, kw_only=True):
    """A unit with versions of its error model: how many, the last verdict, which are in use."""

    unit: str
    versions: int
    last_verdict: str
    live: int | None
    shadow: int | None


class DiagnosedUnits(msgspec.Struct, frozen=True, kw_only=True):
    """Units that have a version."""

    units: list[DiagnosedUnit]


class Diagnosis(msgspec.Struct, frozen=True, kw_only=True):
    """What is stored of a unit's diagnoses: versions of its model, how they were used, and the jobs of this server."""

    unit: str
    versions: list[ModelRow]
    history: list[dict[str, Any]]
    jobs: list[JobRow]


class DiagnosisAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A question, as that of `gyrofleet diagnose`; `save` keeps the model that is found as a version."""

    model: Text
    signal: Name = ""
    block: Name = ""
    holdout: Name = ""
    runs: list[Name] = []
    next_test: bool = False
    save: bool = False


class PromotionAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which version, for what use, and why; a confounded one goes live only if that is accepted."""

    version: int
    reason: Reason
    stage: Literal["live", "shadow"] = "live"
    accept_confounded: bool = False


class RollbackAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which use ends, and why."""

    reason: Reason
    signal: Name = "rate"
    stage: Literal["live", "shadow"] = "live"


class Activation(msgspec.Struct, frozen=True, kw_only=True):
    """Documents that were written to the log, and a warning if the data cannot tell the effects apart."""

    documents: list[dict[str, Any]]
    warning: str | None = None


@get("/api/diagnosis", table="units", is_kept=False, is_slow=True)
def list_diagnoses(call: Call, asked: Nothing) -> DiagnosedUnits:
    """Units that have versions of an error model."""
    from analytics.loop.model.model_registry import ModelRegistry
    from analytics.loop.model.model_use import InUse, read_uses

    del asked
    registry, uses = ModelRegistry(call.store), read_uses(call.store)
    rows = []
    for unit in registry.units():
        versions, _ = registry.readable(unit)
        if not versions:
            continue
        used = [uses.get((unit, signal), InUse()) for signal in dict.fromkeys(each.signal for each in versions)]
        live = [each.live.version for each in used if each.live is not None]
        shadow = [each.shadow.version for each in used if each.shadow is not None]
        rows.append(
            DiagnosedUnit(
                unit=unit, versions=len(versions), last_verdict=versions[-1].verdict, live=max(live, default=None),
                shadow=max(shadow, default=None),
            )
        )  # fmt: skip
    return DiagnosedUnits(units=rows)


@get("/api/diagnosis/{unit}", table="versions", is_kept=False, is_slow=True)
def diagnosis(call: Call, asked: Nothing) -> Diagnosis:
    """One unit: versions of its error model, what each won, how they were used, diagnoses at work."""
    from analytics.loop.model.model_use import logged_documents

    del asked
    unit = call.path["unit"]
    unit_row(call, unit)  # NotFound names similar ones
    versions = models_of(call.store, unit)
    documents = logged_documents(call.store, (ModelActivated, ResidualWatched)) if versions else []
    history = [
        msgspec.to_builtins(each) | {"time": iso(each.t_ns)}
        for each in documents
        if isinstance(each, ModelActivated | ResidualWatched) and each.unit == unit
    ]
    jobs = [job_row(job) for job in call.service.jobs.all() if job.kind == "diagnose" and job.subject == unit]
    return Diagnosis(unit=unit, versions=versions, history=history, jobs=jobs)


@post("/api/diagnosis/{unit}/jobs", role=Role.ENGINEER, status=202)
def diagnose_unit(call: Call, asked: DiagnosisAsked) -> JobDocument:
    """Diagnose a unit: find what a declared model lacks; a job, whose result is that of `gyrofleet diagnose --json`."""
    unit = call.path["unit"]
    unit_row(call, unit)
    if not asked.model.strip():
        raise BadInput("model is empty; declare one, as: rate = bias + scale_factor*input_rate + temperature")
    given = {"signal": asked.signal, "block": asked.block, "holdout": asked.holdout}
    arguments = (
        "diagnose", "--embed-report", f"--store={call.store.folder.resolve()}", f"--unit={unit}",
        f"--model={asked.model}",
        *(f"--{name}={value}" for name, value in given.items() if value),
        *(f"--run={run}" for run in asked.runs),
        *(("--next-test",) if asked.next_test else ()),
        *(("--save",) if asked.save else ()),
    )  # fmt: skip
    return document_of(call.service.jobs.enter(Job("diagnose", unit, arguments, call.person.name)))


@post("/api/models/{unit}/promote", role=Role.ENGINEER)
def promote_model(call: Call, asked: PromotionAsked) -> Activation:
    """Put a version of a unit's error model to use, or propose it where the site needs two persons.

    The log has who, when and why; a document of the kind ActProposed waits at /api/proposals.
    """
    from analytics.loop.model.model_registry import ModelRegistry
    from analytics.loop.model.model_use import Stage, activate
    from analytics.loop.model_promotion import check_usable, promotion_warnings

    version = ModelRegistry(call.store).version(call.path["unit"], asked.version)
    stage = Stage(asked.stage)
    check_usable(version, stage)
    warning = "; ".join(promotion_warnings(call.store, version)) or None if stage is Stage.LIVE else None
    if warning is not None and not asked.accept_confounded:
        raise Conflict(f"{warning}; to use it all the same, accept it with this warning (accept_confounded)")
    document = activate(call.store, version, stage, reason=asked.reason, by=call.person.actor)
    return Activation(documents=[msgspec.to_builtins(document)], warning=warning)


@post("/api/models/{unit}/rollback", role=Role.ENGINEER)
def roll_back_model(call: Call, asked: RollbackAsked) -> Activation:
    """Take the version in use out of use; the one before it takes its place, if there was one."""
    from analytics.loop.model.model_registry import ModelRegistry
    from analytics.loop.model.model_use import InUse, Stage, enter_activations, read_uses, rollback_documents

    unit, stage = call.path["unit"], Stage(asked.stage)
    use = read_uses(call.store).get((unit, asked.signal), InUse())
    if (use.live if stage is Stage.LIVE else use.shadow) is None:
        raise BadInput(f"unit {unit}, signal {asked.signal}: no version of its error model is {stage.value}")
    documents = rollback_documents(ModelRegistry(call.store), use, stage, reason=asked.reason, by=call.person.actor)
    enter_activations(call.store, documents)
    return Activation(documents=[msgspec.to_builtins(each) for each in documents])
