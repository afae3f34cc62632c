"""How long a procedure takes: what the steps say, and what tables and chambers need to get there."""

from collections.abc import Iterable

import msgspec

from ingest.procedures.plan import PlannedStep
from stream.errors import BadInput


class StationRates(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """How fast a station changes from one setting to another.

    Parameters
    ----------
    table_acceleration_deg_per_s2: Of the rate table.
    angle_rate_deg_per_s: How fast a table goes to an angle.
    chamber_deg_c_per_min: Mean ramp of the chamber.
    room_deg_c: Temperature that it starts from.
    prompt_s: How long an operator takes for what a prompt asks.

    Raises
    ------
    BadInput: If one of them is not positive (`prompt_s`: negative).
    """

    table_acceleration_deg_per_s2: float = 50.0
    angle_rate_deg_per_s: float = 20.0
    chamber_deg_c_per_min: float = 2.0
    room_deg_c: float = 23.0
    prompt_s: float = 300.0

    def __post_init__(self) -> None:
        """Check the bounds."""
        for name in ("table_acceleration_deg_per_s2", "angle_rate_deg_per_s", "chamber_deg_c_per_min"):
            if not getattr(self, name) > 0.0:
                raise BadInput(f"{name} of {getattr(self, name):g}: more than 0 is needed")
        if not self.prompt_s >= 0.0:
            raise BadInput(f"prompt_s of {self.prompt_s:g} is negative")


class Spent(msgspec.Struct, frozen=True, kw_only=True):
    """Seconds, by what they are spent on.

    `record_s` and `settle_s` are what the steps say, `warm_up_s` and `off_s` of the units' power, `ramp_s` what tables
    and chambers need, `prompt_s` what operators need for `prompts` requests.
    """

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
        """All of it, seconds."""
        return self.record_s + self.settle_s + self.warm_up_s + self.off_s + self.ramp_s + self.prompt_s

    def __add__(self, other: "Spent") -> "Spent":
        return Spent(**{name: getattr(self, name) + getattr(other, name) for name in self.__struct_fields__})


def spent_by_part(steps: Iterable[PlannedStep], rates: StationRates) -> dict[str, Spent]:
    """What each part of a procedure takes, in the order in which they begin.

    Parameters
    ----------
    steps: All steps, from the first on: ramps count from one to the next.
    rates: Of the station.

    Examples
    --------
    >>> from stream.events import StepWords
    >>> step = PlannedStep(number=1, words=StepWords(step="a"), settings={"rate": 100.0},
    ...                    wait_settled=("rate",), record_s=10.0, part="a")
    >>> spent_by_part([step], StationRates(table_acceleration_deg_per_s2=50.0))["a"].total_s
    12.0
    """
    found: dict[str, Spent] = {}
    state = {"rate": 0.0, "temperature": rates.room_deg_c, "angle": 0.0}
    for step in steps:
        spent = Spent(
            steps=1,
            record_s=step.record_s,
            settle_s=step.settle_s,
            warm_up_s=step.warm_up_s,
            off_s=step.off_s,
            ramp_s=_ramp_s(state, step, rates),
            prompt_s=rates.prompt_s if step.prompt is not None else 0.0,
            prompts=int(step.prompt is not None),
        )
        state |= step.settings
        if "angle" in step.settings:
            state["rate"] = 0.0
        found[step.part] = found.get(step.part, Spent()) + spent
    return found


def _ramp_s(state: dict[str, float], step: PlannedStep, rates: StationRates) -> float:
    """How long the step waits until what it waits for has settled: the longest of them, since they move together."""
    speed = {
        "rate": rates.table_acceleration_deg_per_s2,
        "temperature": rates.chamber_deg_c_per_min / 60.0,
        "angle": rates.angle_rate_deg_per_s,
    }
    return max(
        (
            abs(step.settings[name] - state[name]) / speed[name]
            for name in step.wait_settled
            if name in step.settings and name in speed
        ),
        default=0.0,
    )
