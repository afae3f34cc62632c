"""A unit of a run at work delivers nothing."""

from collections.abc import Iterator

from analytics.alerts.finding import AlertView, Condition, Finding
from analytics.loop.bilingual import Bilingual


class UnitSilentCondition(Condition, frozen=True, kw_only=True, tag="unit_silent"):
    """No sample of a unit was recorded for `silent_s` seconds while its run goes on."""

    silent_s: float = 60.0

    def findings(self, view: AlertView) -> Iterator[Finding]:
        """Units that are silent now."""
        last = {(life.run, name): life.arrived_ns for name, life in view.units.items()}
        for role in view.status.roles:
            if role.status.run is not None and role.condition == "working" and role.status.run.doing == "recording":
                began_ns = max(role.status.began_ns, view.began_ns)
                last |= {
                    (role.status.run.run, unit): began_ns for unit in role.status.run.units if unit not in view.units
                }
        for (run, name), arrived_ns in last.items():
            silent_s = (view.now_ns - arrived_ns) / 1e9
            if silent_s > self.silent_s:
                text = Bilingual(
                    f"unit {name} has delivered nothing for {silent_s:,.0f} s in run {run}; check its power and wiring",
                    f"产品{name}在试验{run}中已{silent_s:,.0f}秒无数据；请检查供电与接线",
                )
                yield Finding(f"{run}/{name}", name, text, unit=name)
