"""Sums and products in a procedure come to what Python makes of them."""

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from ingest.procedures.values import Variables, number_of, text_of
from stream.errors import BadInput

WHERE = "f.toml: $.step[0].record_s"
VARIABLES: Variables = {"rate": 12.5, "turns": 3, "axis": "X", "rates": (1.0, 2.0)}
terms = st.one_of(
    st.integers(0, 99).map(str),
    st.floats(0.001, 1e6).map(lambda each: f"{each:.6f}"),
    st.sampled_from(["$rate", "$turns", "-$rate", "-$turns"]),
)


@given(terms, st.lists(st.tuples(st.sampled_from("+-*/"), terms), max_size=6))
def test_an_expression_is_what_python_makes_of_it(first: str, more: list[tuple[str, str]]) -> None:
    text = first + "".join(f" {operator} {term}" for operator, term in more)
    plain = text.replace("$rate", "12.5").replace("$turns", "3")
    try:
        wanted = eval(plain)  # made of numbers and operators above
    except ZeroDivisionError:
        with pytest.raises(BadInput, match="divides by zero"):
            number_of(text, VARIABLES, WHERE)
        return
    assume(math.isfinite(wanted))
    assert number_of(text, VARIABLES, WHERE) == pytest.approx(wanted, rel=1e-12, abs=1e-9)


@pytest.mark.parametrize(
    ("value", "reported"),
    [
        ("$nothing", r"\$nothing is neither a parameter nor a loop's variable; there is \$rate"),
        ("$axis", "a number is expected"),
        ("$rates", "a number is expected"),
        ("2 ** 3", "is no number"),
        ("(1 + 2)", "is no number"),
        ("1 2", "cannot be read from '2' on"),
        ("__import__('os')", "is no number"),
        ("", "is no number"),
        ("1e999", "no finite number"),
        (float("nan"), "no finite number"),
        (True, "a number is expected"),
    ],
)
def test_what_is_no_number_is_told_with_its_place(value: str | float, reported: str) -> None:
    with pytest.raises(BadInput, match=rf"f\.toml: \$\.step\[0\]\.record_s: .*{reported}"):
        number_of(value, VARIABLES, WHERE)


def test_texts_are_filled_in() -> None:
    assert text_of("{axis} at {rate}", VARIABLES, WHERE) == "X at 12.5"
    assert text_of("$axis", VARIABLES, WHERE) == "X"
    with pytest.raises(BadInput, match=r"\$no is neither"):
        text_of("{no}", VARIABLES, WHERE)
