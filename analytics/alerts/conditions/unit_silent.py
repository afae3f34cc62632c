"""A unit of a run at work delivers nothing."""

from collections.abc import Iterator

from analytics.alerts.finding import AlertView, Condition, Finding
from analytics.floor import UnitNow
from analytics.loop.bilingual import Bilingual


class UnitSilentCondition(Condition, frozen=True, kw_only=True, tag="unit_silent"):
    """No sample of a unit was recorded for `silent_s` seconds while its run goes on."""

    silent_s: float = 60.0

    def findings(self, view: AlertView) -> Iterator[Finding]:
        """Units that are silent now."""
        at_work = {(unit.run.run, name) for name, unit in view.units.items() if unit.is_at_work}
        last = {key: heard_ns for key, heard_ns in view.heard_ns.items() if key in at_work}
        for role in view.status.roles:
            if role.status.run is not None and role.condition == "working" and role.status.run.doing == "recording":
                began_ns = max(view.now_ns - round(role.works_s * 1e9), view.began_ns)
                run, units = role.status.run.run, role.status.run.units
                last |= {(run, unit): began_ns for unit in units if _is_awaited(view.units.get(unit), run)}
        for (run, name), arrived_ns in last.items():
            silent_s = (view.now_ns - arrived_ns) / 1e9
            if silent_s > self.silent_s:
                text = Bilingual(
                    f"unit {name} has delivered nothing for {silent_s:,.0f} s in run {run}; check its power and wiring",
                    f"产品{name}在试验{run}中已{silent_s:,.0f}秒无数据；请检查供电与接线",
                )
                yield Finding(f"{run}/{name}", name, text, unit=name)


def _is_awaited(unit: UnitNow | None, run: str) -> bool:
    """Whether the first sample of a unit is still to come: it is neither off nor released."""
    return unit is None or unit.run.run != run or (not unit.arrival_ns and not unit.is_off)
