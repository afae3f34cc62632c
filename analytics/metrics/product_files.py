"""Products: what the specification says of a kind of gyro, kept in the store by revision."""

import hashlib
import math
from operator import itemgetter
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec
import pyarrow as pa

from analytics.specification_dates import begin_ns
from storage.store import Store
from stream.errors import BadInput

FOLDER = "products"
Positive = Annotated[float, msgspec.Meta(gt=0)]


class Product(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One product of a specification, `[product."FOG-70"]`.

    Parameters
    ----------
    scale_factor : float, optional
        Nominal, in `scale_factor_unit` per deg/s.
    scale_factor_unit : str
        Unit of measure of the output.
    max_rate_deg_per_s : float, optional
        Largest input rate.
    nonlinearity_ppm : float, optional
        Limit of the scale factor's nonlinearity, up to which the range reaches.
    startup_band_deg_per_h : float, optional
        Error band within which the output must stay for the unit to have started.
    expected_threshold_deg_per_h : float, optional
        What the resolution test's rates are chosen by.
    average_s : float, optional
        Averaging time of the product's bias stability, besides 1, 10 and 100 s; at least 1 ms.
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


class _File(msgspec.Struct, frozen=True):
    product: dict[str, Product] = {}
    valid_from: Any = None


class Products(NamedTuple):
    """The products that a store knows, and a hash of what was said of them."""

    by_name: dict[str, Product]
    fingerprint: str

    @property
    def scales(self) -> pa.Table:
        """Nominal scale factors, a table of `product, unit_of_measure, scale_factor`."""
        known = {name: each for name, each in self.by_name.items() if each.scale_factor}
        return pa.table(
            {
                "product": pa.array(known.keys(), pa.string()),
                "unit_of_measure": pa.array([each.scale_factor_unit for each in known.values()], pa.string()),
                "scale_factor": pa.array([each.scale_factor for each in known.values()], pa.float64()),
            }
        )


def parse_products(content: bytes, source: str) -> dict[str, Product]:
    r"""Read the `[product."NAME"]` tables of a specification; other tables are left to others.

    Raises
    ------
    BadInput
        If it is not such a file; the message names the place.

    Examples
    --------
    >>> parse_products(b'[product.FOG-70]\nmax_rate_deg_per_s = 300.0', "spec.toml")["FOG-70"].max_rate_deg_per_s
    300.0
    """
    return _parsed(content, source).product


def _parsed(content: bytes, source: str) -> _File:
    try:
        return msgspec.toml.decode(content, type=_File)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise BadInput(f"specification {source}: {error}") from error


def products_of(store: Store) -> Products:
    """The products of the specifications in a store; what began to be valid last goes before what was before.

    Raises
    ------
    BadInput
        If a file there cannot be read.
    """
    dated: list[tuple[int, str, dict[str, Product]]] = []
    told = hashlib.sha256()
    for path in _specifications(store):
        content = path.read_bytes()
        told.update(content)
        file = _parsed(content, str(path))
        begin = begin_ns(file.valid_from, f"specification {path}: valid_from")
        dated.append((-(2**63) if begin is None else begin, path.name, file.product))
    found: dict[str, Product] = {}
    for _, _, products in sorted(dated, key=itemgetter(0, 1)):
        found |= products
    return Products(found, told.hexdigest())


def _specifications(store: Store) -> list[Path]:
    return sorted((store.folder / FOLDER).glob("*.toml"))
