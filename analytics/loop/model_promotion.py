"""From a trace to a version of the unit's error model."""

import time
from collections.abc import Iterator

import msgspec

from analytics.loop.effects.events import TURN_ON
from analytics.loop.model.model_registry import ModelRegistry, ModelVersion, run_hashes
from analytics.loop.model.model_use import InUse, Stage, activate, logged_documents, read_uses
from analytics.loop.tracing.result.diagnosis_result import Diagnosis, ModelVerdict
from analytics.loop.tracing.search.fitted_candidates import JUMP, LINE
from analytics.loop.unit_diagnosis import UnitDiagnosis, diagnose_units
from analytics.loop.unit_reduction import Progress, Question, silent
from storage.recording.acts.proposing import check_may_propose
from storage.sql.catalog import Catalog
from storage.store import Store
from stream.errors import BadInput
from stream.events import ActProposed, ModelActivated, ResidualWatched
from stream.security.actor import Actor

EVENTS = (LINE, JUMP, TURN_ON)  # no model predicts them: a line has another phase in each run, a jump occurs once


def version_of(catalog: Catalog, found: UnitDiagnosis, use: InUse, *, by: Actor, note: str = "") -> ModelVersion:
    """A trace as a version to be written; BadInput if it has no fitted model."""
    diagnosis = found.diagnosis
    if diagnosis.model is None or diagnosis.declared is None or diagnosis.noise is None:
        raise BadInput(
            f"unit {found.unit}: the verdict is {diagnosis.verdict.value} ({'; '.join(diagnosis.missing)}), so that "
            "there is no fitted model to put to use; measure more runs"
        )
    runs = found.data.runs
    trained = [run for run in runs if run.run in diagnosis.training_runs] or list(runs)
    document = diagnosis.document()
    holdout, error = document["holdout"], document.get("error")
    return ModelVersion(
        unit=found.unit,
        signal=diagnosis.signal,
        version=0,
        parent=None if use.live is None else use.live.model,
        text=str(diagnosis.model),
        model=diagnosis.model,
        before=diagnosis.declared,
        noise=diagnosis.noise,
        block_s=runs[0].block_s,
        longest_s=max(float(run.slot[-1] + 1 - run.slot[0]) * run.block_s for run in trained),
        runs=run_hashes(catalog, tuple(run.run for run in runs)),
        training_runs=diagnosis.training_runs,
        verdict=diagnosis.verdict.value,
        added=tuple(name for name in diagnosis.names if name not in EVENTS),
        holdout=None if holdout is None else dict(msgspec.to_builtins(holdout)),
        made_ns=time.time_ns(),
        by=by.name,
        note=note,
        confounded=tuple(dict.fromkeys(_confounded(found.diagnosis))),
        error=None if error is None else dict(msgspec.to_builtins(error)),
    )


def _confounded(diagnosis: Diagnosis) -> Iterator[str]:
    """Effects that the data do not distinguish from those that are added."""
    for effect in diagnosis.effects:
        if effect.name not in EVENTS:
            yield from (other.name for other in effect.confounded if other.name not in diagnosis.names)


def confounded_warning(version: ModelVersion) -> str | None:
    """Warning that a version has one of several effects that the data do not distinguish; None where it does not."""
    if not version.confounded and version.verdict != ModelVerdict.CONFOUNDED:
        return None
    added, others = ", ".join(version.added), ", ".join(version.confounded) or "others"
    return (
        f"unit {version.unit}, version {version.version}: the data cannot tell {added} from {others} (verdict "
        f"{version.verdict}); the model holds {added}, and is wrong wherever the two differ: "
        "separate them by the test that `gyrofleet diagnose` names, or use --shadow"
    )


def promotion_warnings(store: Store, version: ModelVersion) -> list[str]:
    """What speaks against a version that goes live: it is one of several, leaves structure, or was refused before."""
    name = f"unit {version.unit}, version {version.version}"
    found = [confounded_warning(version)]
    if version.verdict == ModelVerdict.UNEXPLAINED:
        found.append(f"{name}: its trace left structure that no effect explains (verdict unexplained): it remains")
    watched = [
        each
        for each in logged_documents(store, (ResidualWatched,))
        if isinstance(each, ResidualWatched) and each.model == version.hash and each.is_refused
    ]
    if watched:
        last = watched[-1]
        found.append(
            f"{name}: the watch of its residual took it off in run {last.run or '?'} (cusum {last.cusum:.2f}, limit "
            f"{last.threshold:.2f}): diagnose the unit again, or use --shadow"
        )
    return [each for each in found if each is not None]


def promote_trace(
    store: Store,
    unit: str,
    question: Question,
    stage: Stage,
    *,
    by: Actor,
    note: str = "",
    on_progress: Progress = silent,
) -> tuple[ModelVersion, ModelActivated | ActProposed]:
    """Trace a unit's residual, write what is found as a new version of its model, and put it to use, or propose that.

    BadInput if the trace has no model, or it must not go live; then nothing is written.
    """
    check_may_propose(store, ModelActivated, by)
    with Catalog(store) as catalog:
        found = diagnose_units(catalog, [unit], question, on_progress=on_progress).units[unit]
        use = read_uses(store).get((unit, question.signal_name), InUse())
        version = version_of(catalog, found, use, by=by, note=note)
    check_usable(version, stage)
    written = ModelRegistry(store).add(version)
    return written, activate(store, written, stage, reason=note or f"trace: {version.verdict}", by=by)


def check_usable(version: ModelVersion, stage: Stage) -> None:
    """Refuse to go live with effects not confirmed by held-out runs, or with a term that cannot be computed live."""
    if stage is not Stage.LIVE:
        return
    if not version.is_confirmed:
        raise BadInput(
            f"unit {version.unit}: the trace found {', '.join(version.added)} ({version.verdict}), which held-out runs "
            "have not confirmed, so that it cannot go live; measure more runs, or put it to use with --shadow"
        )
    from analytics.loop.model.live_terms import check_live

    check_live(version.unit, version.model)
