"""Units in which a station states the uncertainty of its standards: converted right, or refused with those that fit."""

import contextlib
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pint
import pytest

from ingest.measurement_standards import QUANTITIES, StatedUncertainty
from ingest.standard_units import factor_to_kept
from stream.errors import BadInput, UnknownUnit
from stream.quantities import check_unit, conversion, is_angular_rate, result_factor

KEPT = tuple(dict.fromkeys(each.unit for each in QUANTITIES.values()))
# every unit of one word to which pint has a factor and that is taken, by definition: each other one is refused
TAKEN = {
    "ppm": {"percent": 1e4, "permille": 1e3, "ppm": 1.0},
    "arcsec": {
        "degree": 3600.0, "radian": 206264.80624709636, "turn": 1296e3, "arcminute": 60.0, "arcsecond": 1.0,
        "milliarcsecond": 1e-3,
    },
    "V": {"volt": 1.0},
    "degC": {"kelvin": 1.0, "degree_Celsius": 1.0, "degree_Fahrenheit": 5 / 9},
    "s": {"second": 1.0, "minute": 60.0, "hour": 3600.0, "day": 86400.0},
}  # fmt: skip


@pytest.mark.parametrize("kept", KEPT)
def test_of_all_units_of_pint_only_those_of_one_meaning_are_taken(kept: str) -> None:
    registry: pint.UnitRegistry[float] = pint.UnitRegistry(cache_folder=None)
    names = {registry.get_name(name) for name in registry._units if name.isidentifier()}
    found = {}
    for name in sorted(names):
        with contextlib.suppress(BadInput):
            found[name] = factor_to_kept(name, kept)
    assert found == pytest.approx(TAKEN[kept], rel=1e-12)


@pytest.mark.parametrize(
    ("unit", "kept", "factor"),
    [
        ("1", "ppm", 1e6), ("‰", "ppm", 1e3), ("uV/V", "ppm", 1.0), ("s/d", "ppm", 1e6 / 86400), ("″", "arcsec", 1.0),
        ("′", "arcsec", 60.0), ("gon", "arcsec", 3240.0), ("mgon", "arcsec", 3.24),
        ("mm/m", "arcsec", 206.26480624709636),
        ("mrad", "arcsec", 206.26480624709636), ("uV", "V", 1e-6), ("℃", "degC", 1.0), ("mK", "degC", 1e-3),
        ("degF", "degC", 5 / 9), ("us", "s", 1e-6),
    ],
)  # fmt: skip
def test_what_has_one_meaning_is_converted(unit: str, kept: str, factor: float) -> None:
    assert factor_to_kept(unit, kept) == pytest.approx(factor, rel=1e-12)


@pytest.mark.parametrize(
    "unit",
    ["mil", "dB", "Np", "B", "count", "LSB", "bit", "grad", "Grad", "grade", "u", "pi", "deg/m", "deg**0.5", "1/deg"],
)
def test_what_has_several_meanings_or_none_is_refused_for_each_quantity(unit: str) -> None:
    for kept in KEPT:
        with pytest.raises(BadInput, match=f"it is kept in {kept}: write "):
            factor_to_kept(unit, kept)


def test_a_mil_elsewhere_is_the_6400th_part_of_a_turn() -> None:
    assert conversion("mil", "deg")[0] == pytest.approx(360 / 6400)


def test_no_text_of_a_unit_ends_in_another_error_than_that_it_is_none() -> None:
    draw = random.Random(59)
    pieces = [
        *(
            "deg",
            "arcsec",
            "mil",
            "dB",
            "dBm",
            "Np",
            "degC",
            "degF",
            "″",
            "′",
            "V",
            "s",
            "h",
            "count",
            "%",
            "‰",
            "sqrt(",
            "√",
        ),
        *(
            "(",
            ")",
            "[",
            "/",
            "*",
            "**",
            "^",
            "-",
            "+",
            ".",
            ",",
            " ",
            "0",
            "1",
            "2",
            "9999",
            "1e",
            "0.5",
            "_",
            "if",
            "g",
        ),
        *("\x00", "\n", "é", "度", "µ", "²", "⁻", "'", '"', "nan", "inf", "delta_", "\ud800"),
    ]
    for _ in range(1500):
        text = "".join(draw.choices(pieces, k=draw.randint(1, 7)))
        for read in (
            check_unit, is_angular_rate, lambda text: conversion(text, "arcsec"), lambda text: conversion("degC", text),
            lambda text: result_factor(text, "deg/sqrt(h)"),
        ):  # fmt: skip
            with contextlib.suppress(UnknownUnit):
                read(text)
        for kept in KEPT:
            with contextlib.suppress(BadInput):
                assert factor_to_kept(text, kept) > 0


@pytest.mark.parametrize(("given", "meant"), [("rectangular", "uniform"), ("arcsine", "u_shaped")])
def test_synonyms_of_distributions_are_read(given: Any, meant: Any) -> None:
    one, other = (StatedUncertainty(half_width=20.0, distribution=each, unit="ppm") for each in (given, meant))
    assert one.entry("rate") == other.entry("rate")


def test_config_check_names_units_that_fit(run_command: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "station.toml").write_text(
        '[station]\nsite = "lab"\nname = "pier"\n[standards.level]\nuncertainty.heading = { U = 1, unit = "mil" }\n'
        'uncertainty.rate = { U = 0.001, unit = "dB" }\nuncertainty.levelling = { U = 5, unit = "″" }\n',
        encoding="utf-8",
    )
    done = run_command("config", "check", "station.toml", cwd=tmp_path)
    said = " ".join((done.out + done.err).split())
    assert done.code != 0
    assert "uncertainty.heading.unit: 'mil'" in said
    assert "write arcsec, arcmin, deg" in said
    assert "Traceback" not in said
