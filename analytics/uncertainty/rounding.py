"""Rounding of uncertainties and of the values they belong to (JCGM 100 7.2.6, JJF 1059.1-2012 5.3.8)."""

from decimal import ROUND_CEILING, ROUND_HALF_EVEN, Decimal

# JCGM 100 7.2.6: 28.05 becomes 28 and 10.47 becomes 11; what two digits may lose of an uncertainty
_IMMATERIAL = Decimal("0.002")


def round_up(uncertainty: float, digits: int = 2) -> float:
    """An uncertainty rounded up to some significant digits; what is immaterial, 0.2 % of two digits, is dropped.

    >>> round_up(4.233e-4), round_up(1.0046e-2), round_up(10.47), round_up(28.05), round_up(4.4033e-4), round_up(0.0)
    (0.00043, 0.011, 11.0, 28.0, 0.00044, 0.0)
    """
    if uncertainty == 0:
        return 0.0
    exact = Decimal(repr(float(uncertainty)))
    last = _last_place(exact, digits)
    down = exact.quantize(last, rounding=ROUND_HALF_EVEN)
    if 0 <= exact - down <= exact * _IMMATERIAL.scaleb(2 - digits):
        return float(down)
    return float(exact.quantize(last, rounding=ROUND_CEILING))


def round_with(value: float, uncertainty: float, digits: int = 2) -> tuple[str, str]:
    """A value and its uncertainty as they are printed: the value to the last digit of the rounded uncertainty.

    >>> round_with(1.234567, 0.00123), round_with(98765.4, 1234.0), round_with(-0.00004, 0.01)
    (('1.2346', '0.0013'), ('98800', '1300'), ('0.000', '0.010'))
    """
    rounded = Decimal(repr(round_up(uncertainty, digits)))
    if rounded == 0:
        return f"{value:.6g}", "0"
    last = _last_place(rounded, digits)
    exact = Decimal(repr(float(value)))
    shown = exact.quantize(last, rounding=ROUND_HALF_EVEN)
    return f"{abs(shown) if shown == 0 else shown:f}", f"{rounded.quantize(last):f}"


def _last_place(number: Decimal, digits: int) -> Decimal:
    return Decimal(1).scaleb(number.adjusted() - digits + 1)
