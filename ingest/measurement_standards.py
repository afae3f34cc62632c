"""What is stated of a station's measurement standards: serial, certificate, validity, uncertainty of each quantity.

It stands in the station's file and in the details of a run's first document, as one JSON text named ``standards``.
"""

import datetime as dt
import json
import math
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import msgspec

from ingest.standard_units import factor_to_kept
from stream.errors import BadInput
from stream.mistakes import similar_names

DETAIL = "standards"  # its key in the details of a run
# standard uncertainty as a part of the half-width (JCGM 100 4.3.7, 4.3.9, H.1.3.4)
_DIVISORS = {"uniform": math.sqrt(3.0), "triangular": math.sqrt(6.0), "u_shaped": math.sqrt(2.0)}
_SYNONYMS = {"rectangular": "uniform", "arcsine": "u_shaped"}


class Quantity(NamedTuple):
    """A quantity whose uncertainty a measurement standard states."""

    unit: str  # in which it is kept
    en: str
    zh: str


QUANTITIES: Mapping[str, Quantity] = {
    "rate": Quantity("ppm", "table rate, error common to all rates", "转台速率(各速率共同误差)"),
    "rate_nonuniformity": Quantity("ppm", "table rate, error that differs from rate to rate", "转台速率(各速率间差异)"),
    "angle": Quantity("arcsec", "table angle", "转台角位置"),
    "vibration_rate": Quantity("ppm", "rate amplitude of the angular-vibration table", "角振动台角速率幅值"),
    "voltage": Quantity("ppm", "voltmeter gain", "数字电压表增益"),
    "voltage_offset": Quantity("V", "voltmeter offset", "数字电压表零点"),
    "supply_power": Quantity("ppm", "power measured by the supply", "电源功率测量"),
    "temperature": Quantity("degC", "temperature", "温度"),
    "levelling": Quantity("arcsec", "levelling", "调平"),
    "heading": Quantity("arcsec", "north reference", "北向基准"),
    "latitude": Quantity("arcsec", "latitude", "纬度"),
    "mounting": Quantity("arcsec", "fixture", "夹具安装"),
    "clock": Quantity("ppm", "clock rate", "时钟频率"),
    "clock_delay": Quantity("s", "time stamps of gyro and table against each other", "陀螺与转台时标差"),
}


class StatedUncertainty(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """U with k, or a half-width with its distribution; `freedom` where the certificate states it."""

    unit: str
    U: float | None = None
    k: float | None = None  # by default 2
    half_width: float | None = None
    distribution: Literal["uniform", "rectangular", "triangular", "u_shaped", "arcsine"] | None = (
        None  # uniform if None
    )
    freedom: float | None = None

    def entry(self, quantity: str) -> dict[str, Any]:
        """As it stands in the log, in the unit of the quantity. Raises BadInput if it cannot be meant."""
        if quantity not in QUANTITIES:
            near = similar_names(quantity, QUANTITIES)
            hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(QUANTITIES)}"
            raise BadInput(f"uncertainty.{quantity}: no such quantity; {hint}")
        mixed = self.distribution if self.half_width is None else self.k
        if (self.U is None) == (self.half_width is None) or mixed is not None:
            raise BadInput(f"uncertainty.{quantity} has either U with k, or half_width with distribution")
        stated = self.U if self.U is not None else self.half_width
        distribution = (
            "normal" if self.U is not None else _SYNONYMS.get(self.distribution or "", self.distribution or "uniform")
        )
        divisor = (2.0 if self.k is None else self.k) if self.U is not None else _DIVISORS[distribution]
        freedom = math.inf if self.freedom is None else self.freedom
        if stated is None or not (0 <= stated < math.inf and 0 < divisor < math.inf and freedom > 0):
            raise BadInput(f"uncertainty.{quantity}: U and half_width are from 0, k and freedom above 0")
        unit = QUANTITIES[quantity].unit
        try:
            factor = factor_to_kept(self.unit, unit)
        except BadInput as error:
            raise BadInput(f"uncertainty.{quantity}.unit: {error}") from error
        return {
            "quantity": quantity, "stated": stated * factor, "divisor": divisor, "u": stated * factor / divisor,
            "unit": unit, "distribution": distribution,
            "freedom": self.freedom,
        }  # fmt: skip


class Standard(msgspec.Struct, frozen=True, kw_only=True):
    """What is stated of a measurement standard."""

    serial: str = ""  # its serial number
    certificate: str = ""  # number of its calibration certificate
    calibration_due: str | None = None  # last day on which its calibration holds, as 2027-03-31
    traceable_to: str = ""  # such as the national standard of rate at NIM
    uncertainty: dict[str, StatedUncertainty] = {}  # by quantity, as rate or angle

    def check(self) -> None:
        """Raise BadInput if it cannot be meant."""
        if self.calibration_due is not None:
            try:
                dt.date.fromisoformat(self.calibration_due)
            except ValueError as error:
                what = f"calibration_due is {self.calibration_due!r}: {error}"
                raise BadInput(f"{what}; write it as 2027-03-31") from None
        for quantity, stated in self.uncertainty.items():
            stated.entry(quantity)

    def entry(self, name: str, kind: str) -> dict[str, Any]:
        """As it stands in the log."""
        return {
            "name": name, "kind": kind, "serial": self.serial, "certificate": self.certificate,
            "calibration_due": self.calibration_due, "traceable_to": self.traceable_to,
            "quantities": [stated.entry(quantity) for quantity, stated in self.uncertainty.items()],
        }  # fmt: skip


def standards_text(standards: Mapping[str, tuple[str, Standard]]) -> str:
    """Kind and statement of each standard by its name, as the text of a run's detail.

    >>> table = Standard(serial="RT-17", uncertainty={"rate": StatedUncertainty(U=1e-4, unit="1")})
    >>> json.loads(standards_text({"table": ("rate_table", table)}))[0]["quantities"][0]["u"]
    50.0
    """
    entries = [standard.entry(name, kind) for name, (kind, standard) in standards.items()]
    return json.dumps(entries, ensure_ascii=False, separators=(",", ":"))
