"""Noise coefficients of a signal in the closed loop: white, flicker, random walk and turn-on scatter."""

import msgspec


class ModelNoise(msgspec.Struct, frozen=True, omit_defaults=True):
    """Noise of a signal in its result unit u and hours; for deg/h the units in parentheses.

    Parameters
    ----------
    N: White noise, u*sqrt(h) (angle random walk, deg/sqrt(h)).
    B: Flicker: bias instability, u (deg/h); 0 where there is none.
    K: Random walk, u/sqrt(h) (rate random walk, deg/h/sqrt(h)); 0 where there is none.
    turn_on: Standard deviation of the bias from run to run, u (deg/h).

    Examples
    --------
    >>> ModelNoise(N=0.005, B=0.02, K=0.01, turn_on=0.3).turn_on
    0.3
    """

    N: float
    B: float
    K: float
    turn_on: float
