"""A chamber is away from the temperature that the step commands."""

from collections.abc import Iterator
from typing import Annotated

import msgspec

from analytics.alerts.finding import AlertView, Condition, Finding
from analytics.loop.bilingual import Bilingual
from stream.errors import UnknownUnit
from stream.quantities import conversion


class OffSetPointCondition(Condition, frozen=True, kw_only=True, tag="off_set_point"):
    """The `signal` of an instrument is more than `within_deg_c` from the temperature that the step at work commands.

    A chamber needs time for a new temperature: `after_s` of the rule is how long it may take.
    """

    signal: str = "chamber_temperature"
    within_deg_c: Annotated[float, msgspec.Meta(gt=0.0)] = 3.0

    def findings(self, view: AlertView) -> Iterator[Finding]:
        """Instruments that are off now."""
        for name, unit in view.units.items():
            if not unit.is_at_work:
                continue
            run, reading, command = unit.run.run, unit.temperature(self.signal), unit.run.temperature_command_deg_c
            if reading is None or command is None:
                continue
            try:
                factor, offset = conversion(reading[1], "degC")
            except UnknownUnit:
                continue
            measured = reading[0] * factor + offset
            if not abs(measured - command) <= self.within_deg_c:
                text = Bilingual(
                    f"{self.signal} of {name} is {measured:.1f} degC in run {run}, {command:g} degC are commanded",
                    f"试验{run}中{name}的{self.signal}为{measured:.1f}°C，指令为{command:g}°C",
                )
                yield Finding(f"{run}/{name}/{self.signal}", name, text, unit=name)
