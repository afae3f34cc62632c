"""Units of measure: refused at the border with a hint, reported as the standards ask."""

from itertools import permutations

import pint
import pytest

from stream.errors import BadInput, UnknownUnit
from stream.identity import check_name, parse_key
from stream.quantities import check_unit, conversion, is_angular_rate, report_unit
from stream.units.known_units import KNOWN


@pytest.mark.parametrize("text", ["dge/s", "deg/", "[", "deg/s)", "degrees Celsius per", "__import__('os')"])
def test_what_is_no_unit_is_refused(text: str) -> None:
    with pytest.raises(UnknownUnit, match="not known"):
        check_unit(text)


@pytest.mark.parametrize(
    ("text", "factor"),
    [
        ("deg/s", 3600.0),
        ("deg/h", 1.0),
        ("rad/s", 180.0 / 3.141592653589793 * 3600.0),
        ("arcsec/s", 1.0),
        ("rpm", 360.0 * 60.0),
    ],
)
def test_angular_rates_are_reported_in_deg_per_h(text: str, factor: float) -> None:
    unit, found = report_unit(text)
    assert unit == "deg/h"
    assert found == pytest.approx(factor, rel=1e-12)


@pytest.mark.parametrize("text", ["Hz", "m/s^2", "deg", "deg/s^2", "1/s", "degC", "count", "1", "", "T", "deg/m"])
def test_other_signals_keep_their_unit(text: str) -> None:
    assert not is_angular_rate(check_unit(text))
    assert report_unit(check_unit(text))[1] == 1.0


def test_offsets_are_converted_and_contradictions_refused() -> None:
    factor, offset = conversion("degF", "degC")
    assert factor * 212 + offset == pytest.approx(100)
    assert factor * 32 + offset == pytest.approx(0, abs=1e-9)
    with pytest.raises(UnknownUnit, match="different quantities"):
        conversion("V", "degC")


@pytest.mark.parametrize("name", ["", "a b", "a/b", "*", "a$", "x?", "#", "@x", ".x", "a" * 129, "a\n"])
def test_names_that_cannot_travel_are_refused(name: str) -> None:
    with pytest.raises(BadInput, match="rename it"):
        check_name("unit", name)


@pytest.mark.parametrize("name", ["FOG-0231", "陀螺-7", "a.b_c(1)", "u'1", 'u"1', "a" * 128])
def test_names_of_the_floor_are_kept(name: str) -> None:
    assert check_name("unit", name) == name


@pytest.mark.parametrize("key", ["", "gyrofleet", "other/a/b/event", "gyrofleet/a/b/c", "gyrofleet/a/b/c/d/e/f/g"])
def test_foreign_keys_are_told_apart(key: str) -> None:
    with pytest.raises(BadInput, match="not one of gyrofleet's"):
        parse_key(key)


def pint_registry() -> "pint.UnitRegistry[float]":
    registry: pint.UnitRegistry[float] = pint.UnitRegistry(cache_folder=None)
    registry.define("dps = degree / second")
    registry.define("LSB = count")
    return registry


def test_known_units_are_converted_as_pint_does() -> None:
    registry = pint_registry()
    known = KNOWN
    pairs = [pair for pair in permutations(known, 2) if known[pair[0]].quantity == known[pair[1]].quantity]
    for source, target in pairs:
        factor, offset = conversion(source, target)
        for value in (0.0, 1.0, -40.0):
            expected = registry.Quantity(value, source).to(target).magnitude
            assert factor * value + offset == pytest.approx(expected, rel=1e-12, abs=1e-12)
    assert len(pairs) > 20


@pytest.mark.long
def test_known_units_of_different_quantities_are_as_different_to_pint() -> None:
    registry = pint_registry()
    for source, target in permutations(KNOWN, 2):
        try:
            conversion(source, target)
        except UnknownUnit:
            assert not registry.is_compatible_with(source, target)
        else:
            assert registry.Unit(source).is_compatible_with(target)
