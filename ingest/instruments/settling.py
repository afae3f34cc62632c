"""Whether what is measured has come to rest at what was asked for."""

from stream.errors import BadInput


class Settling:
    """Settled once everything measured for a time lies inside a band.

    Parameters
    ----------
    target: What was asked for.
    band: Largest distance from it, in the same unit.
    stable_s: How long it is to stay inside the band; at 0, one measurement inside it is enough.

    Raises
    ------
    BadInput: If band or time is negative.

    Examples
    --------
    >>> settling = Settling(target=40.0, band=0.5, stable_s=60.0)
    >>> [settling.see(round(t_s * 1e9), deg_c) for t_s, deg_c in [(0, 39.0), (30, 39.6), (60, 39.9), (90, 40.1)]]
    [False, False, False, True]
    >>> settling.see(100 * 10**9, 40.6), settling.see(110 * 10**9, 40.0), settling.see(170 * 10**9, 40.0)
    (False, False, True)
    """

    def __init__(self, target: float, band: float, stable_s: float) -> None:
        if not (band >= 0.0 and stable_s >= 0.0):
            raise BadInput(f"settled within {band} for {stable_s} s: neither can be negative")
        self.target = target
        self._band = band
        self._stable_ns = round(stable_s * 1e9)
        self._since_ns: int | None = None

    def see(self, t_ns: int, value: float) -> bool:
        """Take a measurement; whether it is settled with it."""
        if not abs(value - self.target) <= self._band:
            self._since_ns = None
            return False
        if self._since_ns is None:
            self._since_ns = t_ns
        return t_ns - self._since_ns >= self._stable_ns
