"""Units of measure of coefficients and shape parameters, from those of the channels."""

import re

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.base import Effect, ShapeParameter


def coefficient_unit(effect: Effect, signal_unit: str, run: RunBlocks) -> str:
    """Unit of a coefficient of `effect`, for a signal in `signal_unit` and the channels of `run`.

    Examples
    --------
    >>> import numpy as np
    >>> from analytics.loop.effects.registry import effect
    >>> from analytics.loop.blocks.run_blocks import Channel
    >>> one = np.ones(1)
    >>> run = RunBlocks("U", "r", "rate", np.array([0]), 30.0, 0, one, np.array([1]), one, "deg/h",
    ...                 {"temperature": Channel(one, one, "degC"), "input_rate": Channel(one, one, "deg/s")})
    >>> coefficient_unit(effect("temperature"), "deg/h", run)
    'deg/h/degC'
    >>> coefficient_unit(effect("scale_factor_temperature"), "deg/h", run)
    'deg/h/((deg/s)*degC)'
    """
    divisor = _filled(effect.per, run)
    if divisor == "1":
        return signal_unit
    return f"{signal_unit}/{_bracketed(divisor)}"


def parameter_unit(parameter: ShapeParameter, run: RunBlocks) -> str:
    """Unit of a shape parameter: its own, or that of the channel it names."""
    return _filled(parameter.unit_of_measure, run, is_alone=True)


def _filled(template: str, run: RunBlocks, is_alone: bool = False) -> str:
    def unit(match: re.Match[str]) -> str:
        channel = run.channels.get(match[1])
        text = "1" if channel is None else channel.unit_of_measure
        return text if is_alone or template == match[0] else _bracketed(text)

    return re.sub(r"\{([^}]+)\}", unit, template)


def _bracketed(unit: str) -> str:
    is_compound = re.search(r"[*/ ]", unit) is not None
    return f"({unit})" if is_compound else unit
