"""What follows from the steps of a procedure for one who carries them out: where to go on, and what holds there."""

from collections.abc import Sequence

from ingest.procedures.procedure import PlannedStep


def goes_on_at(steps: Sequence[PlannedStep], at: int) -> int:
    """Index of the step that a run goes on with that was interrupted in another.

    While it was interrupted the station was made safe, or nobody saw to it: what prepares a record, a soak or a time
    without power, is done again, unless it takes an operator.

    Examples
    --------
    >>> from ingest.procedures.procedure import load_procedure
    >>> steps = load_procedure("bias_temperature_sensitivity").steps()
    >>> [(each.number, each.words.step) for each in steps[1:5]]
    [(2, 'static'), (3, 'soak'), (4, 'static'), (5, 'soak')]
    >>> goes_on_at(steps, 3), goes_on_at(steps, 1)
    (2, 1)
    """
    while 0 < at < len(steps) and not steps[at - 1].is_recorded and steps[at - 1].prompt is None:
        at -= 1
    return at


def lasts_s(step: PlannedStep) -> float:
    """How long a step takes at least, seconds; what settles comes on top."""
    return step.off_s + step.warm_up_s + step.settle_s + step.record_s


def settings_before(steps: Sequence[PlannedStep], at: int) -> dict[str, float]:
    """What holds when a step begins, and that step does not replace.

    Examples
    --------
    >>> from ingest.procedures.procedure import load_procedure
    >>> settings_before(load_procedure("scale_factor").steps(), 3), settings_before([], 0)
    ({'rate': 4.0}, {})
    """
    held: dict[str, float] = {}
    for earlier in steps[:at]:
        held = _kept(held, earlier.settings) | earlier.settings
    return _kept(held, steps[at].settings) if at < len(steps) else held


def _kept(held: dict[str, float], settings: dict[str, float]) -> dict[str, float]:
    """What stays: a table turns or stands somewhere, one takes the place of the other."""
    gone = {"angle"} if "rate" in settings else {"rate"} if "angle" in settings else set()
    return {what: value for what, value in held.items() if what not in gone}
