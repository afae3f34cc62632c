"""Limits of specifications that live estimators judge while a run goes on, and those that wait for its end."""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from storage.specifications.chain import read_chain
from storage.specifications.screening_file import METRICS, WALK, WALK_UNIT
from storage.specifications.specification import Specification, SpecificationLimit, format_parameter
from storage.specifications.validity import Period, in_force, ordered_periods
from storage.store import Store
from stream.errors import NotFound, UnknownUnit
from stream.events import Limit
from stream.quantities import check_unit, is_angular_rate, result_factor

# metric -> characteristic of a live limit, and the parameter that is its averaging time
_LIVE = {metric: (characteristic, parameter) for characteristic, (metric, parameter) in METRICS.items()}
# averaging times of the metric, all of which a limit without `average_s` is on
_AVERAGES_S = (1.0, 10.0, 100.0)


class UnitLimits(NamedTuple):
    """Limits on one unit: names and revisions of the specifications, such as ``FOG-70-B``, and what they limit.

    Live estimators can judge those in `live`; `after` are subjects of the limits that are judged after the run.
    """

    label: str
    live: tuple[Limit, ...]
    after: tuple[str, ...]


def chosen_periods(store: Store, t_ns: int, wanted: str | None = None) -> list[Period]:
    """Specifications of a store that are valid at `t_ns` (UTC), or the one that is wanted.

    It is wanted as ``NAME``, for its revision of that moment, or ``NAME@REVISION``. Raises a NotFound if that is not in
    force (the message has the names that are) or if the chain of documents is broken, so that no limit counts; a
    StoreError if the lake or the log is damaged.
    """
    chain = read_chain(store)
    if chain.breaks:
        raise NotFound(
            f"the chain of specification documents in {store.log} is broken, so that no limit counts: "
            f"{chain.breaks[0].what}; `gyrofleet verify` has the details"
        )
    periods = ordered_periods(in_force(chain.links))
    valid = [each for each in periods if each.from_ns <= t_ns < each.until_ns]
    if wanted is None:
        return valid
    name, at, revision = wanted.partition("@")
    named = [each for each in periods if each.specification.name == name]
    if not named:
        names = ", ".join(dict.fromkeys(each.specification.name for each in periods))
        raise NotFound(
            f"there is no specification {name!r} in {store.folder}; "
            f"{f'there are {names}' if names else 'there is none: `gyrofleet limits add FILE` adds one'}"
        )
    found = [each for each in (named if at else valid) if each.specification.name == name]
    found = [each for each in found if not at or each.specification.revision == revision]
    if not found:
        known = ", ".join(f"{name}@{each.specification.revision} ({each.text})" for each in named)
        what = f"revision {revision!r} of" if at else "revision valid now of"
        raise NotFound(f"there is no {what} specification {name}; there are {known}")
    return found


def unit_limits(
    specifications: Iterable[Specification], product: str | None, signals: Sequence[str]
) -> UnitLimits | None:
    """Limits on a unit, those without a signal on all its `signals`; None where none is for its product."""
    labels: list[str] = []
    live: dict[Limit, None] = {}
    after: list[str] = []
    for specification in specifications:
        own = [limit for limit in specification.limits if limit.product in {None, product}]
        if own:
            labels.append(specification.label)
        for limit in own:
            found = list(live_limits(limit, signals))
            live |= dict.fromkeys(found)
            if not found:
                after.append(limit.subject)
    return UnitLimits(", ".join(labels), tuple(live), tuple(after)) if labels else None


def live_limits(limit: SpecificationLimit, signals: Sequence[str]) -> Iterator[Limit]:
    """A limit as live estimators take it, for each signal and averaging time; nothing where they cannot.

    They take upper limits on the standard deviation of averages, the Allan deviation at an averaging time, and the
    angle random walk, which they read from the Allan deviation at 1 s. A limit that asks for the length of its record
    is judged when the record is there.
    """
    characteristic, time = _LIVE.get(limit.metric, (None, None))
    times = _averaging_times(limit, time)
    if characteristic is None or times is None or limit.lower is not None or limit.upper is None or limit.upper <= 0:
        return
    if limit.record_s is not None:
        return
    unit, factor = limit.unit_of_measure, 1.0
    try:
        if characteristic == WALK:
            unit, factor = WALK_UNIT, result_factor(unit, WALK_UNIT)
        elif not is_angular_rate(check_unit(unit)) and limit.signal in {None, *signals}:
            return
    except UnknownUnit:
        return
    for signal in signals if limit.signal is None else [limit.signal]:
        for tau_s in times:
            yield Limit(
                characteristic=characteristic, signal=signal, tau_s=tau_s, upper=limit.upper * factor,
                unit_of_measure=unit,
            )  # fmt: skip


def _averaging_times(limit: SpecificationLimit, time: str | None) -> tuple[float | None, ...] | None:
    """Averaging times that a limit is on; None where its other parameters select values that live estimators lack."""
    given = dict(limit.parameters)
    if time is None:
        return (None,) if given in ({}, {"method": "allan"}) else None
    tau_s = given.pop(time, None)
    if given:
        return None
    if tau_s is None:
        return _AVERAGES_S if time == "average_s" else None
    return (float(tau_s),) if isinstance(tau_s, int | float) and not isinstance(tau_s, bool) and tau_s > 0 else None


def format_limit(limit: Limit) -> str:
    """A live limit in one line.

    >>> limit = SpecificationLimit(metric="allan_deviation", parameters={"tau_s": 100}, upper=0.2,
    ...     unit_of_measure="deg/h")
    >>> format_limit(*live_limits(limit, ["rate"]))
    'allan_deviation of rate, 100 s <= 0.2 deg/h'
    """
    tau = "" if limit.tau_s is None else f", {format_parameter(limit.tau_s)} s"
    return f"{limit.characteristic} of {limit.signal}{tau} <= {limit.upper:g} {limit.unit_of_measure}"
