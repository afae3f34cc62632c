"""The next test: the cheapest run that would decide what a diagnosis leaves open, with its hours and power."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import msgspec

from analytics.loop.bilingual import Bilingual
from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.registry import effect
from analytics.loop.model.error_model import ErrorModel, ModelNoise
from analytics.loop.next_test.candidate import CandidateTest
from analytics.loop.next_test.candidates import candidate_tests, repetitions, rests
from analytics.loop.next_test.decisions import AT_REST, DRIVEN, again, excess, which
from analytics.loop.next_test.open_question import OpenQuestion, Question, held_still, lacking, open_question
from analytics.loop.next_test.plans import Decides, TestPlan, cheapest_plans, timed_tests
from analytics.loop.next_test.separation import FittedRecord, inseparable
from analytics.loop.next_test.station_bounds import StationBounds
from analytics.loop.tracing.case import case_of
from analytics.loop.tracing.fleet import FleetDiagnosis
from analytics.loop.tracing.result.diagnosis_result import Diagnosis

_SAME_COLUMNS = Bilingual(
    "No run decides: they follow the same regressor in the recorded channels, also in every test of this station; the "
    "separating test of each names what to record or to set up otherwise.",
    "任何试验均不能判别：它们在所记录的通道中（包括本试验台的各项试验）回归量相同；各自的区分方法指出须另行记录或布置的内容。",
)
_NO_TEST = Bilingual(
    "No test within the bounds of the station separates them in the recorded channels: widen the bounds (--bounds, "
    "--station), or set up by hand what the separating test of each names.",
    "在试验台能力范围内，没有试验能在所记录的通道中区分它们：请放宽范围（--bounds、--station），或按各自的区分方法人工布置。",
)
_FEWEST_RUNS = 1  # of those that are fitted
_CHANNELS_DIFFER = Bilingual(
    "No run can be computed: no runs have all channels that the effects found need. Record these in every run.",
    "无法计算应做的试验：没有一次试验含有所发现效应需要的全部通道。请在每次试验中记录这些通道。",
)
_UNDECLARED = Bilingual(
    "No run can be computed: no noise is declared that a run at rest could be compared with. Declare the noise of the "
    "data sheet (--noise) and diagnose a run at rest alone (--run): if it is unexplained as well, the cause needs no "
    "motion.",
    "无法计算应做的试验：未声明可与静止试验比较的噪声。请声明技术指标中的噪声（--noise），并单独诊断一次静止试验（--run）："
    "若仍无法解释，则成因与运动无关。",
)
_NO_EXCESS = Bilingual(
    "No run can be computed: the noise agrees with what is declared, but the held-out runs differ from the model in a "
    "way that no recorded channel shows. Compare what was done otherwise in them (mounting, place, operator, warm-up), "
    "record it, and repeat one training run and one held-out run.",
    "无法计算应做的试验：噪声与声明相符，而留出试验与模型的差异在所记录的通道中没有体现。"
    "请核对这些试验的不同之处（安装、地点、人员、预热），加以记录，并各重复一次训练试验与留出试验。",
)


class NextTest(msgspec.Struct, frozen=True, kw_only=True):
    """What is open, and the tests that would decide it, the cheapest that reaches the wanted power first.

    Parameters
    ----------
    question: Which of several effects is at work; whether one is seen again; whether a curve over a channel is seen
        again if the channel alone is stepped; whether unexplained noise is there at rest; or none that a run answers.
    weights: Posterior weight of each rival on the data so far.
    twins: By rival, effects with the same columns, which no run separates from it.
    channels: Of the curve.
    repeat: The cheapest repetition of a run that reaches the power, for comparison; None if none does.
    holdout: Runs to hold out in the diagnosis after the test; empty for its default.
    units: That the test is run with; empty: the one diagnosed.
    why_not: Why there is no plan, and what a person should do.
    """

    question: Question
    rivals: tuple[str, ...] = ()
    weights: dict[str, float] = {}
    twins: dict[str, tuple[str, ...]] = {}
    channels: tuple[str, ...] = ()
    plans: tuple[TestPlan, ...] = ()
    repeat: TestPlan | None = None
    holdout: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    bounds: StationBounds | None = None
    why_not: Bilingual | None = None

    def document(self) -> dict[str, Any]:
        """JSON form."""
        return {
            "question": self.question,
            "rivals": list(self.rivals),
            "weights": {name: round(weight, 4) for name, weight in self.weights.items()},
            "inseparable": {name: list(others) for name, others in self.twins.items()},
            "channels": list(self.channels),
            "plans": [each.document() for each in self.plans],
            "repeat": None if self.repeat is None else self.repeat.document(),
            "holdout": list(self.holdout),
            "units": list(self.units),
            "bounds": None if self.bounds is None else self.bounds.document(),
            "why_not": None if self.why_not is None else str(self.why_not),
        }


def next_test(
    diagnosis: Diagnosis,
    runs: Sequence[RunBlocks],
    model: ErrorModel,
    *,
    declared_noise: ModelNoise | None = None,
    bounds: StationBounds | None = None,
    positions: Mapping[str, float] | None = None,
    on_progress: Callable[[str], None] = lambda _: None,
) -> NextTest | None:
    """The tests that would decide what a diagnosis leaves open; None if it leaves nothing open.

    Parameters
    ----------
    runs, model, declared_noise: As they were diagnosed.
    bounds: Of the station; by default what the unit has been through.
    positions: Number of each word in the channel ``position``.
    """
    if diagnosis.noise is None:
        return NextTest(question="none", why_not=lacking(diagnosis).why_not)
    asked = open_question(
        diagnosis.effects,
        diagnosis.unreplicated,
        verdict=diagnosis.verdict,
        within_run=diagnosis.replication == "within_run",
    )
    if asked is None:
        return None
    others = [each for each in diagnosis.effects if asked.subject and each.name != asked.subject.name]
    runs, beside = comparable(runs, asked.rivals, {each.name: each.parameters for each in others})
    known = {run.run for run in runs}
    held_out = tuple(name for name in diagnosis.held_out_runs if name in known)
    if len(runs) - len(held_out) < _FEWEST_RUNS:
        return NextTest(question=asked.asked, rivals=asked.rivals, why_not=_CHANNELS_DIFFER)
    shaped = model.shaped(runs)
    training = case_of(runs, shaped, declared_noise, held_out).training
    planner = _Planner(
        asked,
        shaped,
        (FittedRecord(training.stack, diagnosis.noise, training.white),),
        runs,
        StationBounds.of_runs(runs) if bounds is None else bounds,
        positions or {},
        on_progress,
    )
    if asked.asked == "which":
        return planner.deciding(beside, held_out)
    if asked.asked == "excess":
        if diagnosis.declared_noise is None or not diagnosis.noise_excess:
            return NextTest(question="excess", why_not=_UNDECLARED)
        model_of_noise = training.stack.noise_model
        return planner.resting(excess(model_of_noise, diagnosis.noise, diagnosis.declared_noise))
    return planner.repeating()


def comparable(
    runs: Sequence[RunBlocks], rivals: Sequence[str], beside: Mapping[str, Mapping[str, object]]
) -> tuple[list[RunBlocks], dict[str, Mapping[str, object]]]:
    """The runs with every channel of the rivals, and the effects beside that all of these runs can be fitted with.

    An effect whose channel only some runs have was found in those; they are left out, as it would stay in their error.
    """
    needed = {channel for name in rivals for channel in effect(name).needs}
    having = [run for run in runs if needed <= set(run.channels)]
    common = set.intersection(*(set(run.channels) for run in having)) if having else set()
    partial = [set(effect(name).needs) for name in beside if not set(effect(name).needs) <= common]
    kept = [run for run in having if not any(needs <= set(run.channels) for needs in partial)]
    return kept, {name: shape for name, shape in beside.items() if set(effect(name).needs) <= common}


def fleet_next_test(
    fleet: FleetDiagnosis,
    units: Mapping[str, Sequence[RunBlocks]],
    model: ErrorModel,
    *,
    declared_noise: Mapping[str, ModelNoise] | None = None,
    bounds: StationBounds | None = None,
    positions: Mapping[str, float] | None = None,
    on_progress: Callable[[str], None] = lambda _: None,
) -> NextTest | None:
    """The tests, each with all units of a fleet, that would decide what the pooled search leaves open.

    The channels of a test are predicted from the runs of the first unit.
    """
    asked = open_question(fleet.effects, fleet.unreplicated, verdict=fleet.verdict)
    if asked is None or asked.asked == "excess":
        return None
    noises = declared_noise or {}
    records, every = [], []
    for unit, diagnosis in fleet.units.items():
        if diagnosis.noise is None:
            continue
        training = case_of(units[unit], model, noises.get(unit), diagnosis.held_out_runs).training
        records.append(FittedRecord(training.stack, diagnosis.noise, training.white))
        every.append(unit)
    first = units[every[0]]
    limits = StationBounds.of_runs(first) if bounds is None else bounds
    planner = _Planner(asked, model, tuple(records), first, limits, positions or {}, on_progress)
    others = {each.name: each.parameters for each in fleet.effects if asked.subject and each.name != asked.subject.name}
    found = planner.deciding(others, ()) if asked.asked == "which" else planner.repeating()
    return msgspec.structs.replace(found, units=tuple(every))


class _Planner(msgspec.Struct, frozen=True):
    """Computes the plans of a question."""

    asked: OpenQuestion
    model: ErrorModel
    records: tuple[FittedRecord, ...]
    runs: Sequence[RunBlocks]
    bounds: StationBounds
    positions: Mapping[str, float]
    on_progress: Callable[[str], None]

    def deciding(self, others: Mapping[str, Mapping[str, object]], held_out: tuple[str, ...]) -> NextTest:
        """Which of several rivals is at work."""
        if self.asked.why_not is not None:
            return self._without_plan()
        known = [run for each in self.records for run in each.stack.runs]
        names = (*self.asked.rivals, *held_still(self.asked.rivals, known))
        timed = timed_tests(self._tests(names), self.runs, self.bounds, self.positions)
        twins = inseparable(names, [*known, *(run for each in timed for run in each.runs)])
        if len(twins) == 1:
            (name,) = twins
            return NextTest(question="which", rivals=(name,), weights={name: 1.0}, twins=twins, why_not=_SAME_COLUMNS)
        beside = [(effect(name), shape) for name, shape in others.items()]
        decides, weights = which(self.records, self.model, tuple(twins), beside)
        plans, repeat = cheapest_plans(decides, timed, self.on_progress)
        return NextTest(
            question="which",
            rivals=tuple(twins),
            weights=dict(zip(twins, map(float, weights), strict=True)),
            twins={name: alike for name, alike in twins.items() if alike},
            plans=plans,
            repeat=repeat,
            holdout=held_out,
            bounds=self.bounds,
            why_not=None if plans else _NO_TEST,
        )

    def repeating(self) -> NextTest:
        """Whether an effect, or a curve, is seen again."""
        subject = self.asked.subject
        if self.asked.why_not is not None or subject is None:
            return self._without_plan()
        timed = timed_tests(self._tests(self.asked.rivals), self.runs, self.bounds, self.positions)
        plans, repeat = cheapest_plans(again(subject, self.records, self.model), timed, self.on_progress)
        return NextTest(
            question=self.asked.asked,
            rivals=self.asked.rivals,
            weights={subject.name: 1.0},
            channels=subject.unknown_function_of if self.asked.asked == "form" else (),
            plans=plans,
            repeat=repeat,
            bounds=self.bounds,
            why_not=None if plans else _NO_TEST,
        )

    def resting(self, decides: Decides) -> NextTest:
        """Whether unexplained noise is there at rest."""
        timed = timed_tests(rests(self.bounds, (1.0, 2.0, 4.0, 8.0)), self.runs, self.bounds, self.positions)
        plans, _ = cheapest_plans(decides, timed, self.on_progress)
        return NextTest(
            question="excess", rivals=(AT_REST, DRIVEN), plans=plans, bounds=self.bounds,
            why_not=None if plans else _NO_EXCESS,
        )  # fmt: skip

    def _tests(self, names: Sequence[str]) -> list[CandidateTest]:
        needed = {channel for name in names for channel in effect(name).needs}
        tests = candidate_tests(needed, self.bounds, self.runs, self.positions)
        return tests or list(repetitions(self.runs))

    def _without_plan(self) -> NextTest:
        rivals = self.asked.rivals
        weights = {rivals[0]: 1.0} if rivals else {}
        return NextTest(question=self.asked.asked, rivals=rivals, weights=weights, why_not=self.asked.why_not)
