"""The order of a certificate: a TOML file with what the store does not know (laboratory, customer, people, ...)."""

import datetime as dt
import re
from pathlib import Path

import msgspec

from analytics.certificate.statement.words import Words
from stream.errors import BadInput
from stream.files.toml_text import decode_toml

Text = str | Words
Range = tuple[float, float]


class _Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base class of the tables of the file."""


class LaboratoryTable(_Table, frozen=True, kw_only=True):
    """`[laboratory]`: who calibrates, and where if not at its address."""

    name: Text = ""
    address: Text = ""
    place: Text = ""
    accreditation: Text = ""
    country: str = "CN"  # ISO 3166-1


class CustomerTable(_Table, frozen=True, kw_only=True):
    """`[customer]`: who ordered the calibration."""

    name: Text = ""
    address: Text = ""


class DeviceTable(_Table, frozen=True, kw_only=True):
    """`[device]`: what the calibrated unit is; `model` is the product in the store where it is not given."""

    description: Text = ""
    manufacturer: Text = ""
    model: str = ""
    received: dt.date | None = None
    sampling: Text = ""


class EnvironmentTable(_Table, frozen=True, kw_only=True):
    """`[environment]`: least and greatest value during the calibration, where the store has not recorded them."""

    temperature_deg_c: Range | None = None
    temperature_change_deg_c: float | None = None  # largest change during one measurement
    relative_humidity_percent: Range | None = None
    other: Text = ""


class ReferenceTable(_Table, frozen=True, kw_only=True):
    """`[[reference]]`: a measurement standard that was used, with its own certificate."""

    name: Text
    serial: str
    certificate: str
    due: dt.date  # last day on which its calibration is valid
    uncertainty: Text  # U and k as its certificate states them
    traceable_to: Text = ""


class PeopleTable(_Table, frozen=True, kw_only=True):
    """`[people]`: who calibrated, checked and issues, and the position of the issuer."""

    calibrated_by: Text = ""
    checked_by: Text = ""
    issued_by: Text = ""
    issued_as: Text = ""


class ConformityTable(_Table, frozen=True, kw_only=True):
    """`[conformity]`: the specification by which results are judged; its limits state the decision rule."""

    specification: str


class Order(_Table, frozen=True, kw_only=True):
    """The file as a whole."""

    laboratory: LaboratoryTable = LaboratoryTable()
    customer: CustomerTable = CustomerTable()
    device: DeviceTable = DeviceTable()
    environment: EnvironmentTable = EnvironmentTable()
    reference: tuple[ReferenceTable, ...] = ()
    people: PeopleTable = PeopleTable()
    conformity: ConformityTable | None = None  # a statement of conformity is made only where it was ordered
    traceability: Text = ""  # of the measurement standards together, beside what is stated of each
    deviations: Text = ""  # from the standard; "none" where there are none
    remarks: Text = ""
    items: tuple[str, ...] = ()  # metrics that were ordered; without them, those that have results
    valid_months: int | None = None  # recommended interval, where it is agreed (ISO/IEC 17025 7.8.4.3)
    number_prefix: str = ""


def read_order(path: Path | None) -> Order:
    """Read the file; an empty order without one. Raises BadInput, with the place in it, if it is none.

    >>> read_order(None).people.issued_by
    ''
    """
    if path is None:
        return Order()
    try:
        order = decode_toml(path.read_bytes(), Order)
    except OSError as error:
        raise BadInput(f"the order {path} cannot be read: {error.strerror}; give --order FILE") from error
    except msgspec.MsgspecError as error:
        raise BadInput(f"the order {path}: {error}") from error
    _check(order, path)
    return order


def _check(order: Order, path: Path) -> None:
    around = order.environment
    for name, given, least, most in (
        ("temperature_deg_c", around.temperature_deg_c, -90.0, 200.0),
        ("relative_humidity_percent", around.relative_humidity_percent, 0.0, 100.0),
    ):
        if given is not None and not least <= given[0] <= given[1] <= most:
            raise BadInput(
                f"the order {path}: environment.{name} is {list(given)}; it is the least and the greatest value, "
                f"between {least:g} and {most:g}"
            )
    if re.fullmatch("[A-Z]{2}", order.laboratory.country) is None:
        raise BadInput(f"the order {path}: laboratory.country is {order.laboratory.country!r}; write it as CN or DE")
    if order.valid_months is not None and not 1 <= order.valid_months <= 120:
        raise BadInput(f"the order {path}: valid_months is {order.valid_months}; it lies between 1 and 120")
