"""What follows from the steps of a procedure: durations, the settings that hold, where a run resumes."""

from collections.abc import Iterable, Sequence

import msgspec

from ingest.procedures.plan import ENDS, PlannedStep
from stream.errors import BadInput

NOTHING_RECORDED = "This procedure records nothing: none of its steps has a record_s above 0."


def resume_index(steps: Sequence[PlannedStep], at: int) -> int:
    """Index of the step at which a run resumes that was interrupted in the step `at`.

    During the interruption the station was made safe, or left alone: the preparation of a record, a soak or a time
    without power, is repeated, unless it takes an operator.

    >>> from ingest.procedures.procedure import load_procedure
    >>> steps = load_procedure("bias_temperature_sensitivity").steps()
    >>> [(each.number, each.words.step) for each in steps[1:5]]
    [(2, 'static'), (3, 'soak'), (4, 'static'), (5, 'soak')]
    >>> resume_index(steps, 3), resume_index(steps, 1)
    (2, 1)
    """
    while 0 < at < len(steps) and not steps[at - 1].is_recorded and steps[at - 1].prompt is None:
        at -= 1
    return at


def lasts_s(step: PlannedStep) -> float:
    """Least duration of a step, seconds, without the time in which instruments settle."""
    return step.off_s + step.warm_up_s + step.settle_s + step.record_s


def settings_before(steps: Sequence[PlannedStep], at: int) -> dict[str, float]:
    """Settings that hold when a step begins, without those that it replaces.

    >>> from ingest.procedures.procedure import load_procedure
    >>> settings_before(load_procedure("scale_factor").steps(), 3), settings_before([], 0)
    ({'rate': 4.0}, {})
    """
    held: dict[str, float] = {}
    for earlier in steps[:at]:
        held = _kept(held, earlier.settings) | earlier.settings
    return _kept(held, steps[at].settings) if at < len(steps) else held


def _kept(held: dict[str, float], settings: dict[str, float]) -> dict[str, float]:
    return {what: value for what, value in held.items() if ENDS.get(what) not in settings}


class StationRates(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Rates at which a station changes its settings."""

    table_acceleration_deg_per_s2: float = 50.0
    angle_rate_deg_per_s: float = 20.0  # rate of the table on the way to an angle
    chamber_deg_c_per_min: float = 2.0  # mean ramp of the chamber
    room_deg_c: float = 23.0  # temperature at the start
    prompt_s: float = 300.0  # time of an operator for one prompt

    def __post_init__(self) -> None:
        for name in ("table_acceleration_deg_per_s2", "angle_rate_deg_per_s", "chamber_deg_c_per_min"):
            if not getattr(self, name) > 0.0:
                raise BadInput(f"{name} of {getattr(self, name):g}: more than 0 is needed")
        if not self.prompt_s >= 0.0:
            raise BadInput(f"prompt_s of {self.prompt_s:g} is negative")


class Spent(msgspec.Struct, frozen=True, kw_only=True):
    """Seconds by their use: of the steps, of the units' power, of tables and chambers (`ramp_s`), and of operators."""

    steps: int = 0
    record_s: float = 0.0
    settle_s: float = 0.0
    warm_up_s: float = 0.0
    off_s: float = 0.0
    ramp_s: float = 0.0
    prompt_s: float = 0.0
    prompts: int = 0

    @property
    def total_s(self) -> float:
        """All together."""
        return self.record_s + self.settle_s + self.warm_up_s + self.off_s + self.ramp_s + self.prompt_s

    def __add__(self, other: "Spent") -> "Spent":
        return Spent(**{name: getattr(self, name) + getattr(other, name) for name in self.__struct_fields__})


def spent_by_part(steps: Iterable[PlannedStep], rates: StationRates) -> dict[str, Spent]:
    """Time of each part of a procedure, in order; `steps` are all steps, since ramps count from one to the next."""
    found: dict[str, Spent] = {}
    state = {"rate": 0.0, "temperature": rates.room_deg_c, "angle": 0.0}
    for step in steps:
        spent = Spent(
            steps=1, record_s=step.record_s, settle_s=step.settle_s, warm_up_s=step.warm_up_s, off_s=step.off_s,
            ramp_s=_ramp_s(state, step, rates), prompt_s=rates.prompt_s if step.prompt is not None else 0.0,
            prompts=int(step.prompt is not None),
        )  # fmt: skip
        state |= step.settings
        if "angle" in step.settings:
            state["rate"] = 0.0
        found[step.part] = found.get(step.part, Spent()) + spent
    return found


def _ramp_s(state: dict[str, float], step: PlannedStep, rates: StationRates) -> float:
    """Time until the settings have been reached: the longest of them, since they change at the same time."""
    speed = {
        "rate": rates.table_acceleration_deg_per_s2,
        "temperature": rates.chamber_deg_c_per_min / 60.0,
        "angle": rates.angle_rate_deg_per_s,
    }
    waited = [name for name in step.wait_settled if name in step.settings and name in speed]
    return max((abs(step.settings[name] - state[name]) / speed[name] for name in waited), default=0.0)
