"""What a trace came to, beside the truth: one line of JSON for each campaign."""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.registry import effect
from analytics.loop.live.residual_watch import THRESHOLD, cusum, stretches
from analytics.loop.model.model_registry import ModelVersion
from analytics.loop.tracing.diagnosis import diagnose
from analytics.loop.tracing.result.diagnosis_result import Diagnosis, FoundEffect, ModelVerdict
from tests.bench.tracing_cases import DECLARED, MODEL, OUTSIDE, Built, Case, built
from tests.bench.tracing_peers import peers

REFERENCE_S = 1800.0
RIGHT = frozenset({"exact", "in_set"})
_LATER_RUNS = 8


def traced(case: Case, *, with_peers: bool = False) -> dict[str, Any]:
    """Trace one campaign and judge what was said."""
    made = built(case)
    start = time.perf_counter()
    said = diagnose(made.runs, MODEL, declared_noise=DECLARED)
    line: dict[str, Any] = {
        "key": case.key,
        **{name: getattr(case, name) for name in ("row", "name", "z", "seed")},
        "planted": [{"name": each.effect, "shape": dict(each.shape)} for each in made.planted],
        "seconds": round(time.perf_counter() - start, 2),
        "outcome": outcome(case, made, said),
        "verdict": said.verdict.value,
        "found": [_told(each) for each in said.effects],
        "refused": [_told(each) for each in said.unreplicated if each.confirmed is False],
        "seen_once": [each.name for each in said.unreplicated if each.confirmed is None],
        "slope": [said.holdout.total.slope, said.holdout.total.slope_se] if said.holdout else None,
        "error": _error(said),
    }
    if case.row == "removed" and said.effects:
        line["watch"] = _watched(made, said)
    if with_peers:
        line["peers"] = peers(made.runs, MODEL, np.random.default_rng(case.seed))
    return line


def outcome(case: Case, made: Built, said: Diagnosis) -> str:
    """One word: exact, in_set, unknown, unreplicated, unexplained, missed, beside (the truth and more) or wrong."""
    if case.row == "outside":
        return _outside(OUTSIDE[case.name][0], said)
    truth = [each.effect for each in made.planted]
    hit = [each for each in said.effects if any(_means(each, name) for name in truth)]
    met = [name for name in truth if any(_means(each, name) for each in said.effects)]
    if not said.effects:
        return _nothing_said(truth, said)
    if len(met) == len(truth) and len(hit) == len(said.effects) and truth:
        named = set(said.names) == set(truth) and not said.confounded
        return "exact" if named else "in_set"
    if hit:
        return "beside" if len(hit) < len(said.effects) else "part"
    channels = {channel for each in said.effects for channel in each.unknown_function_of}
    driven = {channel for name in truth for channel in effect(name).needs}
    if channels & driven:
        return "unknown"
    is_left_open = said.verdict in (ModelVerdict.UNEXPLAINED, ModelVerdict.UNREPLICATED)
    return "unexplained" if truth and is_left_open else "wrong"


def _nothing_said(truth: Sequence[str], said: Diagnosis) -> str:
    if any(_means(each, name) for each in said.unreplicated for name in truth):
        return "unreplicated"
    if said.verdict is ModelVerdict.UNEXPLAINED:
        return "unexplained"
    channels = {channel for name in truth for channel in effect(name).needs}
    if any(channels & set(effect(each.name).needs) for each in said.unreplicated):
        return "unreplicated_form"
    return "other_unreplicated" if said.unreplicated else "missed"


def _means(found: FoundEffect, truth: str) -> bool:
    """Whether a finding names the truth, itself or as one of those that the data cannot tell apart.

    A free function may also be found as an effect of that channel alone; each run of a campaign begins with power-on,
    so that a drift in the run is one of the time since then.
    """
    names = (found.name, *(each.name for each in found.confounded))
    if truth in (*names, *found.companions):
        return True
    needs = effect(truth).needs
    if not truth.startswith("function_of"):
        return False
    driven = {("time_since_power_on",) if name == "drift_in_run" else effect(name).needs for name in names}
    return needs[0] in found.unknown_function_of or needs in driven


def _outside(channels: Sequence[str], said: Diagnosis) -> str:
    if not said.effects:
        return {ModelVerdict.UNEXPLAINED: "unexplained", ModelVerdict.NOTHING_MISSING: "missed"}.get(
            said.verdict, "unreplicated"
        )
    reported = {channel for each in said.effects for channel in each.unknown_function_of}
    if said.verdict is ModelVerdict.UNKNOWN_FUNCTION and reported & set(channels):
        return "exact"
    if said.verdict in (ModelVerdict.UNEXPLAINED, ModelVerdict.UNREPLICATED, ModelVerdict.CONFOUNDED):
        return said.verdict.value
    own = any(set(effect(each.name).needs) & set(channels) for each in said.effects)
    return "wrong_form" if own else "wrong"


def _told(each: FoundEffect) -> dict[str, Any]:
    return {
        "name": each.name,
        "parameters": {k: v for k, v in each.parameters.items() if not isinstance(v, list)},
        "significance": round(each.significance, 2),
        "confounded": [other.name for other in each.confounded],
        "companions": list(each.companions),
        "unknown_function_of": list(each.unknown_function_of),
        "replicates": each.replicates,
        "form_p": each.form_p_value,
        "homogeneity_p": each.heterogeneity_p_value,
    }


def _error(said: Diagnosis) -> dict[str, Any] | None:
    rows = [row for row in (said.error.rows if said.error else ()) if row.averaging_s == REFERENCE_S]
    if not rows or said.error is None:
        return None
    row = rows[0]
    return {
        "before": row.before,
        "after": row.after,
        "floor": row.floor,
        "excited": [row.excited_before, row.excited_after, row.excited_floor],
        "fraction": said.error.achievable_fraction,
        "fraction_excited": said.error.achievable_fraction_excited,
    }


def _watched(made: Built, said: Diagnosis) -> dict[str, Any]:
    """Runs until the promoted model is rolled back, with the effect still there and with it gone; None: never."""
    version = _version(made, said)
    kept = made.campaign.runs(made.planted, noise_seed=90_000 + made.campaign.seed)[:_LATER_RUNS]
    gone = made.campaign.runs((), noise_seed=91_000 + made.campaign.seed)[:_LATER_RUNS]
    return {"kept": _rolled_back(kept, version), "removed": _rolled_back(gone, version)}


def _version(made: Built, said: Diagnosis) -> ModelVersion:
    """What would be promoted."""
    model, before, noise = said.model, said.declared, said.noise
    assert model is not None
    assert before is not None
    assert noise is not None
    return ModelVersion(
        unit=made.campaign.unit,
        signal="rate",
        version=1,
        parent=None,
        text=str(model),
        model=model,
        before=before,
        noise=noise,
        block_s=made.campaign.block_s,
        longest_s=float(max(run.time_s[-1] for run in made.runs)),
        runs={},
        training_runs=said.training_runs,
        verdict=said.verdict.value,
        added=said.names,
        holdout=None,
        made_ns=0,
        by="bench",
        note="",
    )


def _rolled_back(runs: Sequence[RunBlocks], version: ModelVersion) -> int | None:
    lost = 0.0
    for number, run in enumerate(runs, start=1):
        for stretch in stretches(version, run, is_ended=True):
            lost = cusum(lost, stretch.gain)
        if lost > THRESHOLD:
            return number
    return None
