"""The order of a certificate, as people may write it."""

import datetime as dt
from pathlib import Path

import pytest

from analytics.certificate.statement.order import ReferenceTable, read_order
from analytics.certificate.statement.references import Reference
from analytics.certificate.statement.validity import later
from stream.errors import BadInput


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[laboratory]\nnam = 'x'", "nam"),
        ("[people]\nissued_by = 3", "issued_by"),
        ("[environment]\ntemperature_deg_c = [25, 20]", "temperature_deg_c"),
        ("[environment]\nrelative_humidity_percent = [40, 140]", "between 0 and 100"),
        ("valid_months = 0", "between 1 and 120"),
        ("[laboratory]\ncountry = 'China'", "write it as CN"),
        ("[[reference]]\nname = 'table'", "serial"),
        ("[laboratory", "order.toml"),
    ],
)
def test_what_is_wrong_in_an_order_is_named(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "order.toml"
    path.write_text(text)
    with pytest.raises(BadInput, match="order") as caught:
        read_order(path)
    assert expected in str(caught.value)


def test_an_order_that_is_not_there_says_so(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="give --order FILE"):
        read_order(tmp_path / "none.toml")


def reference(due: dt.date) -> Reference:
    return Reference.of_table(
        ReferenceTable(name="rate table", serial="T-1", certificate="C-1", due=due, uncertainty="Urel = 1e-4, k = 2")
    )


def test_a_standard_out_of_date_is_missing() -> None:
    """It holds on its last day, not on the next."""
    due = dt.date(2026, 3, 2)
    assert reference(due).missing(due) == []
    (found,) = reference(due).missing(due + dt.timedelta(days=1))
    assert "was valid until 2026-03-02" in found.en
    assert "有效期至 2026-03-02" in found.zh


@pytest.mark.parametrize(
    ("day", "months", "until"),
    [
        ("2026-03-02", 12, "2027-03-01"),
        ("2028-02-29", 12, "2029-02-27"),
        ("2026-12-15", 1, "2027-01-14"),
        ("2026-08-31", 6, "2027-02-27"),
    ],
)
def test_validity_ends_the_day_before(day: str, months: int, until: str) -> None:
    assert later(dt.date.fromisoformat(day), months).isoformat() == until
