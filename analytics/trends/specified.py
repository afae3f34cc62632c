"""The limits of the products' specifications that hold for a series."""

from analytics.trends.series import Series, parameter_text
from analytics.trends.trend import Limits
from analytics.trends.words import Words
from storage.specifications.specification import SpecificationLimit
from storage.specifications.validity import ordered_periods, stored_specifications
from storage.store import Store
from stream.quantities import result_factor


def specified_limits(store: Store, series: Series) -> Limits:
    """Limits that are valid when the last value was measured, in the unit of the series.

    Values of products, or signals, with different limits have none in common: that is said in place of them.
    """
    moment = int(series.t_ns[-1])
    found: dict[tuple[float | None, float | None], str] = {}
    kinds = set(zip(series.groups["product"], series.groups["signal"], strict=True))
    without = 0
    periods = [each for each in ordered_periods(stored_specifications(store)) if each.from_ns <= moment < each.until_ns]
    for product, signal in sorted(kinds):
        meant = [
            (limit, period.specification.label)
            for period in periods
            for limit in period.specification.limits
            if _is_of(limit, series, product, signal)
        ]
        without += not meant
        for limit, label in meant:
            factor = result_factor(limit.unit_of_measure, series.unit_of_measure)
            sides = (limit.lower, limit.upper)
            lower, upper = (None if side is None else side * factor for side in sides)
            found[lower, upper] = label
    if len(found) > 1 or (found and without):
        return Limits(
            why_not=Words(
                "the values are of products or signals with different limits: choose by --product or --signal",
                "各产品或信号的限值不同：请用 --product 或 --signal 选择",
            )
        )
    if not found:
        return Limits()
    ((sides, label),) = found.items()
    return Limits(sides[0], sides[1], label)


def _is_of(limit: SpecificationLimit, series: Series, product: str, signal: str) -> bool:
    told = dict(series.variant.parameters)
    return (
        limit.metric == series.metric
        and limit.product in {None, product}
        and limit.signal in {None, signal}
        and (limit.standard is None or limit.standard in series.variant.standard.split(", "))
        and all(told.get(name) == parameter_text(value) for name, value in limit.parameters.items())
    )
