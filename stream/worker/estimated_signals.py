"""Which signals are estimated while they flow."""

from collections.abc import Iterable
from typing import NamedTuple, Self

from stream.quantities import is_angular_rate

ALL = "all"
_OUTPUT = "rate"


class EstimatedSignals(NamedTuple):
    """Which signals are estimated while they flow: angular rates, the outputs of gyros, and those that are named.

    A noise fit costs more than the import of a file of a few hundred rows, and nobody asks for that of a supply
    voltage. `gyrofleet allan` and `gyrofleet spectrum` compute any recorded signal from its samples.

    `names` are estimated whatever they measure; `rates`: also angular rates, and signals named ``rate`` or ``rate_*``
    in other units, such as counts; `everything`: every signal.

    >>> chosen = EstimatedSignals.named(["supply_voltage"])
    >>> chosen.includes("rate", "count"), chosen.includes("table_rate", "deg/s"), chosen.includes("temperature", "degC")
    (True, True, False)
    >>> chosen.includes("supply_voltage", "V"), EstimatedSignals.named(["all"]).includes("temperature", "degC")
    (True, True)
    """

    names: frozenset[str] = frozenset()
    rates: bool = True
    everything: bool = False

    @classmethod
    def named(cls, names: Iterable[str]) -> Self:
        """Angular rates and those signals; ``all`` stands for every signal."""
        chosen = frozenset(names)
        return cls(names=chosen - {ALL}, everything=ALL in chosen)

    def includes(self, signal: str, unit_of_measure: str) -> bool:
        """Whether a signal in that unit of measure is estimated."""
        if self.everything or signal in self.names:
            return True
        is_output = signal == _OUTPUT or signal.startswith(f"{_OUTPUT}_")
        return self.rates and (is_output or is_angular_rate(unit_of_measure))

    def remark_on(self, known: Iterable[str]) -> str | None:
        """What to say of signals that are named and not known; None where all are.

        >>> EstimatedSignals.named(["rat"]).remark_on(["temperature", "rate"])
        'nothing delivers rat, which --estimates names; there is rate, temperature'
        """
        known = set(known)
        if not (strange := sorted(self.names - known)):
            return None
        return f"nothing delivers {', '.join(strange)}, which --estimates names; there is {', '.join(sorted(known))}"
