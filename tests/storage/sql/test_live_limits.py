"""Which limits of a specification live estimators judge, for which units, and which specification holds."""

from pathlib import Path

import pytest

from storage.specifications.chain import append_document, read_chain
from storage.specifications.live_limits import chosen_periods, live_limits, unit_limits
from storage.specifications.specification import Specification, SpecificationLimit, parse_specification
from storage.store import Store
from stream.errors import NotFound
from stream.events import SpecificationEntered

DAY_NS = 86_400 * 10**9
LIMIT = '[[limit]]\nmetric = "bias_stability_averaged"\nparameters = {average_s = 10}\nupper = 1.0\n'


def limit(metric: str = "bias_stability_averaged", **words: object) -> SpecificationLimit:
    given = {"upper": 1.0, "unit_of_measure": "deg/h"} | words
    return SpecificationLimit(metric=metric, **given)  # type: ignore[arg-type]


def live(each: SpecificationLimit) -> list[tuple[str, str, float | None, float, str]]:
    found = live_limits(each, ["rate_x", "rate_y"])
    return [(e.characteristic, e.signal, e.tau_s, round(e.upper, 9), e.unit_of_measure) for e in found]


def test_a_limit_is_on_every_angular_rate_unless_it_names_a_signal() -> None:
    both = [("bias_stability", signal, 10.0, 1.0, "deg/h") for signal in ("rate_x", "rate_y")]
    assert live(limit(parameters={"average_s": 10})) == both
    assert live(limit(parameters={"average_s": 10}, signal="rate_y")) == both[1:]


def test_averages_that_are_not_named_are_all_of_the_metric() -> None:
    assert [each[2] for each in live(limit(signal="rate_x"))] == [1.0, 10.0, 100.0]


def test_the_angle_random_walk_is_in_the_unit_of_the_estimator() -> None:
    walk = limit("angle_random_walk", upper=0.6, unit_of_measure="deg/h/sqrt(Hz)", signal="rate_x")
    assert live(walk) == [("angle_random_walk", "rate_x", None, 0.01, "deg/sqrt(h)")]  # two-sided, as it was entered
    walk = limit("angle_random_walk", upper=0.6, unit_of_measure="deg/h/sqrt(Hz), one-sided", signal="rate_x")
    assert live(walk) == [("angle_random_walk", "rate_x", None, 0.007071068, "deg/sqrt(h)")]
    assert live(limit("angle_random_walk", unit_of_measure="deg/sqrt(h)", parameters={"method": "normalised"})) == []


@pytest.mark.parametrize(
    "each",
    [
        limit("bias"),
        limit("bias_instability"),
        limit("allan_deviation"),
        limit("allan_deviation", parameters={"tau_s": "long"}),
        limit("allan_deviation", parameters={"tau_s": True}),
        limit(parameters={"average_s": 10, "position": "IRA_up"}),
        limit(lower=0.5),
        limit(upper=None, lower=0.5),
        limit(upper=-1.0),
        limit(unit_of_measure="ppm"),
        limit(unit_of_measure="no such unit"),
    ],
)
def test_what_live_estimators_do_not_give_is_judged_after_the_run(each: SpecificationLimit) -> None:
    assert live(each) == []
    found = unit_limits([Specification("fog", "A", None, None, {}, (each,))], None, ["rate_x", "rate_y"])
    assert found is not None
    assert (found.live, found.after) == ((), (each.subject,))


def test_a_unit_has_the_limits_of_its_product_and_those_of_every_product() -> None:
    own, others, common = (
        limit(parameters={"average_s": tau}, product=p) for tau, p in ((1, "A"), (2, "B"), (3, None))
    )
    first = Specification("fog", "A", None, None, {}, (own, others))
    second = Specification("all", "7", None, None, {}, (common,))
    found = unit_limits([first, second], "A", ["rate"])
    assert found is not None
    assert found.label == "fog-A, all-7"
    assert [each.tau_s for each in found.live] == [1.0, 3.0]
    unknown = unit_limits([first, second], None, ["rate"])
    assert unknown is not None
    assert (unknown.label, [each.tau_s for each in unknown.live]) == ("all-7", [3.0])
    assert unit_limits([first], "C", ["rate"]) is None


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """A store with two revisions of fog, the second valid from 1 January 2026, and one of other."""
    store = Store.create(tmp_path / "store")
    texts = (
        ("fog", "A", LIMIT), ("fog", "B", f"valid_from = 2026-01-01\n{LIMIT}"), ("other", "1", LIMIT),
    )  # fmt: skip
    for name, revision, text in texts:
        content = f'revision = "{revision}"\n{text}unit_of_measure = "deg/h"\n'
        parse_specification(content, f"{name}.toml")
        append_document(
            store,
            SpecificationEntered(
                run="", t_ns=0, action="added", name=name, revision=revision, content=content, by="Li",  # type: ignore[arg-type]
                previous=read_chain(store).head,
            ),
        )  # fmt: skip
    return store


def labels(store: Store, t_ns: int, wanted: str | None = None) -> list[str]:
    return [each.specification.label for each in chosen_periods(store, t_ns, wanted)]


@pytest.mark.long
def test_the_revision_of_the_runs_start_holds_unless_another_is_named(store: Store) -> None:
    before, after = 20_000 * DAY_NS, 20_500 * DAY_NS
    assert labels(store, before) == ["fog-A", "other-1"]
    assert labels(store, after) == ["fog-B", "other-1"]
    assert labels(store, after, "fog") == ["fog-B"]
    assert labels(store, after, "fog@A") == ["fog-A"]
    with pytest.raises(NotFound, match=r"no specification 'frog' in .*; there are fog, other"):
        labels(store, after, "frog")
    with pytest.raises(NotFound, match=r"no revision 'C' of specification fog; there are fog@A \(.*\), fog@B"):
        labels(store, after, "fog@C")
    with pytest.raises(NotFound, match="there is none"):
        labels(Store.create(store.folder.with_name("empty")), after, "fog")


def test_where_the_chain_is_broken_no_limit_counts(store: Store) -> None:
    append_document(
        store,
        SpecificationEntered(run="", t_ns=0, action="withdrawn", name="fog", revision="A", by="Li", previous="lost"),  # type: ignore[arg-type]
    )
    with pytest.raises(NotFound, match="broken, so that no limit counts"):
        labels(store, 20_000 * DAY_NS)
