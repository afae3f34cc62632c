"""Products: what the specification says of a kind of gyro."""

import math
from typing import Annotated

import msgspec

Positive = Annotated[float, msgspec.Meta(gt=0)]


class Product(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One product of a specification, `[product."FOG-70"]`.

    Parameters
    ----------
    scale_factor: Nominal, in `scale_factor_unit` per deg/s.
    scale_factor_unit: Unit of measure of the output.
    max_rate_deg_per_s: Largest input rate.
    nonlinearity_ppm: Limit of the scale factor's nonlinearity, up to which the range reaches.
    startup_band_deg_per_h: Error band within which the output must stay for the unit to have started.
    expected_threshold_deg_per_h: What the resolution test's rates are chosen by.
    average_s: Averaging time of the product's bias stability, besides 1, 10 and 100 s; at least 1 ms.
    """

    scale_factor: float | None = None
    scale_factor_unit: str = "deg/s"
    max_rate_deg_per_s: Positive | None = None
    nonlinearity_ppm: Positive | None = None
    startup_band_deg_per_h: Positive | None = None
    expected_threshold_deg_per_h: Positive | None = None
    average_s: Annotated[float, msgspec.Meta(ge=1e-3)] | None = None

    def __post_init__(self) -> None:
        numbers = {name: each for name, each in msgspec.structs.asdict(self).items() if isinstance(each, float)}
        for name, each in numbers.items():
            if not math.isfinite(each) or each == 0:
                raise ValueError(f"{name} is {each:g}, expected a finite number other than 0; leave it out if unknown")
