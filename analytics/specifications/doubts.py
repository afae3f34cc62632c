"""What is doubtful in a specification that can be entered: limits that one side leaves open, or that nothing meets."""

import math
from collections.abc import Iterable, Iterator, Mapping

from analytics.metric_registry.magnitudes import as_judged
from analytics.metric_registry.registry import alike, metrics
from storage.specifications.specification import Product, Specification, SpecificationLimit
from storage.specifications.validity import stored_specifications
from storage.sql.catalog import Catalog
from storage.store import Store


def doubts_of(store: Store, found: Specification) -> list[str]:
    """Sentences on the limits of a specification that is entered into a store, and on its products."""
    numbers = {
        name: each for of in (*stored_specifications(store), found) for name, each in of.products.items()
    }  # fmt: skip
    doubts = [doubt for limit in found.limits for doubt in (*_open_side(limit), *_no_average(limit, numbers))]
    products = dict.fromkeys([*(each.product for each in found.limits if each.product), *found.products])
    return [*doubts, *_unknown_products(store, products)]


def _open_side(limit: SpecificationLimit) -> Iterator[str]:
    judged = as_judged(limit)
    if judged is not limit:
        yield f"{limit.subject}: upper limits the magnitude: judged as {judged.lower:g} ... {judged.upper:g}"
    elif metrics()[limit.metric].header.better == "neither" and None in {limit.lower, limit.upper}:
        side, beyond, other, bound = ("upper", "below", "lower", limit.upper)
        if bound is None:
            side, beyond, other, bound = ("lower", "above", "upper", limit.lower)
        if bound is None or (bound > 0) != (side == "upper"):
            return  # no magnitude has such a bound
        yield (
            f"warning: {limit.subject}: by {side} = {bound:g} alone every value {beyond} it passes, however far: where "
            f"its magnitude is meant, write {other} = {-bound:g} too"
        )


def _no_average(limit: SpecificationLimit, numbers: Mapping[str, Product]) -> Iterator[str]:
    from analytics.step_records.series_statistics import AVERAGES_S  # slow to import

    asked = limit.parameters.get("average_s")
    if limit.metric != "bias_stability_averaged" or not isinstance(asked, int | float):
        return
    own = [each.average_s for name, each in numbers.items() if limit.product in {None, name}]
    if not any(each is not None and math.isclose(asked, each, rel_tol=1e-9) for each in (*AVERAGES_S, *own)):
        yield (
            f"warning: {limit.subject}: averages of {asked:g} s are not computed, so that its units will be NO_DATA: "
            f'write average_s = {asked:g} in [product."{limit.product or "NAME"}"]'
        )


def _unknown_products(store: Store, products: Iterable[str]) -> Iterator[str]:
    if not products:
        return
    with Catalog(store) as catalog:
        known = [name for (name,) in catalog.rows("select distinct product from units where product is not null")]
    for product in products if known else ():
        if product not in known:
            yield f"warning: no unit of the store is of product {product!r}; {alike(product, known, 'there are')}"
