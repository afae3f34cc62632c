"""What a diagnosis leaves open: the question of the next test, its rivals, or why no run answers it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from analytics.loop.bilingual import Bilingual, listed
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import EffectKind, Role
from analytics.loop.effects.events import STATION, TURN_ON
from analytics.loop.effects.registry import effect, effects
from analytics.loop.tracing.result.diagnosis_result import Diagnosis, FoundEffect, ModelVerdict
from analytics.loop.tracing.search.evidence import look_alike

Question = Literal["which", "again", "form", "excess", "none"]

_NOT_PLANNED = Bilingual("No run can be computed", "无法计算应做的试验")


@dataclass(frozen=True)
class OpenQuestion:
    """A question: which of several effects, whether one is seen again or in which form, whether noise stays at rest."""

    asked: Question
    subject: FoundEffect | None = None
    rivals: tuple[str, ...] = ()
    why_not: Bilingual | None = None  # why no run is computed, and what a person should do


def open_question(
    found: Sequence[FoundEffect], seen_once: Sequence[FoundEffect], *, verdict: ModelVerdict, within_run: bool = False
) -> OpenQuestion | None:
    """The first question that findings leave open; None if they leave none.

    Parameters
    ----------
    within_run: Whether the replicates are segments of one run, which confirm nothing.
    """
    several = next((each for each in found if recorded_rivals(each)), None)
    if several is not None:
        return OpenQuestion("which", several, (several.name, *recorded_rivals(several)))
    if (alone := next((each for each in found if each.confounded), None)) is not None:
        others = (each.name for each in alone.confounded if each.name == STATION)
        return OpenQuestion("which", alone, (alone.name, *others), _unrecorded(alone))
    unconfirmed = [each for each in (*seen_once, *found) if within_run or not each.confirmed]
    planned = next((each for each in unconfirmed if is_repeatable(each)), None)
    unknown = next((each for each in found if each.unknown_function_of), None)
    if unknown is not None and is_repeatable(unknown):
        return OpenQuestion("form", unknown, (unknown.name,))
    if planned is not None:
        return OpenQuestion("again", planned, (planned.name,))
    if unconfirmed:
        first = unconfirmed[0]
        why = _by_station() if first.name == STATION else _by_chance(first)
        return OpenQuestion("again", first, (first.name,), why)
    if verdict is ModelVerdict.UNEXPLAINED:
        return OpenQuestion("excess")
    return None


def held_still(names: Sequence[str], runs: Sequence[RunBlocks]) -> tuple[str, ...]:
    """Look-alikes of effects that the search could not try: a channel of theirs is recorded, but stood still."""
    recorded = set.intersection(*(set(run.channels) for run in runs))
    found = []
    for other in effects().values():
        is_like = any(look_alike(effect(name), other) for name in names) and other.role is Role.CAUSE
        if not is_like or other.name in names or other.kind is not EffectKind.LIBRARY:
            continue
        if recorded.issuperset(other.needs) and other.unavailable(runs) is not None and other.shapes(runs):
            columns = np.concatenate([other.regressors(run, other.shapes(runs)[0]) for run in runs])
            if np.isfinite(columns).all() and np.ptp(columns, axis=0).any():
                found.append(other.name)
    return tuple(found)


def lacking(diagnosis: Diagnosis) -> OpenQuestion:
    """Of a record that is not enough for a diagnosis: what to record first."""
    missing = listed(diagnosis.missing)
    return OpenQuestion(
        "none",
        why_not=Bilingual(
            f"{_NOT_PLANNED}: there is no fitted noise to compute it with. Record first what is missing: {missing}.",
            f"{_NOT_PLANNED.zh}：没有可用于计算的噪声拟合结果。请先补录所缺数据：{missing.zh}。",
        ),
    )


def recorded_rivals(found: FoundEffect) -> tuple[str, ...]:
    """Names of the alternatives that the runs so far can be fitted with."""
    return tuple(
        each.name
        for each in found.confounded
        if each.recorded and each.is_plausible and each.evidence_behind is not None and is_fitted(each.name)
    )


def is_fitted(name: str) -> bool:
    """Whether an effect has columns in a run that has not been done: turn-on scatter, jumps and lines have none."""
    return name != TURN_ON and effect(name).kind not in (EffectKind.LINE, EffectKind.EVENT)


def is_repeatable(found: FoundEffect) -> bool:
    """Whether a run predicts the effect."""
    return is_fitted(found.name) and len(found.coefficients) == len(effect(found.name).columns(found.parameters))


def _unrecorded(found: FoundEffect) -> Bilingual:
    """The others are not recorded, or are not plausible: what to record."""
    absent = [each.name for each in found.confounded if not each.recorded]
    if any(each.name == STATION for each in found.confounded):
        return _by_station()
    if not absent:
        own = effect(found.name)
        return Bilingual(
            f"No run decides: the others would need an implausible size, or act from one power-on to the next. What "
            f"separates them: {own.separating_test}.",
            f"任何试验均不能判别：其余效应所需大小不合理，或仅逐次通电而异。区分方法：{own.separating_test_zh}。",
        )
    channels = ", ".join(dict.fromkeys(channel for name in absent for channel in effect(name).needs))
    return Bilingual(
        f"No run decides while {', '.join(absent)} are not recorded: record {channels} in the same runs.",
        f"{'、'.join(absent)}未被记录，任何试验均不能判别：请在相同试验中记录{channels}。",
    )


def _by_station() -> Bilingual:
    other = effect(STATION)
    return Bilingual(
        f"The station explains these runs as well. What separates them: {other.separating_test}.",
        f"试验台同样能解释这些试验。区分方法：{other.separating_test_zh}。",
    )


def _by_chance(found: FoundEffect) -> Bilingual:
    own = effect(found.name)
    return Bilingual(
        f"{_NOT_PLANNED}: its time or phase is not under control of the station, so that no run is sure to show it. "
        f"What a person can do: {own.separating_test}.",
        f"{_NOT_PLANNED.zh}：其出现时刻或相位不受试验台控制，没有试验必然显示它。可由人员进行：{own.separating_test_zh}。",
    )
