"""A unit of a run at work delivers nothing."""

from collections.abc import Iterator
from typing import Annotated

import msgspec

from analytics.alerts.finding import AlertView, Condition, Finding
from analytics.floor import UnitNow
from analytics.loop.bilingual import Bilingual


class UnitSilentCondition(Condition, frozen=True, kw_only=True, tag="unit_silent"):
    """No sample of a unit was recorded for `silent_s` seconds while its run goes on."""

    silent_s: Annotated[float, msgspec.Meta(gt=0.0)] = 60.0

    def findings(self, view: AlertView) -> Iterator[Finding]:
        """Units that are silent now."""
        at_work = {(unit.run.run, name) for name, unit in view.units.items() if unit.is_at_work}
        last = {key: last_sample_ns for key, last_sample_ns in view.last_sample_ns.items() if key in at_work}
        for role in view.status.roles:
            if role.status.run is not None and role.condition == "working" and role.status.run.doing == "recording":
                began_ns = max(view.now_ns - round(role.works_s * 1e9), view.began_ns)
                run, units = role.status.run.run, role.status.run.units
                last |= {(run, unit): began_ns for unit in units if _is_awaited(view.units.get(unit), run)}
        # what falls silent all at once has a common cause
        newest_s = (view.now_ns - max(last.values(), default=0)) / 1e9
        is_all = len(last) > 1 and newest_s > 0.8 * self.silent_s
        for (run, name), arrived_ns in last.items():
            silent_s = (view.now_ns - arrived_ns) / 1e9
            if silent_s > self.silent_s:
                en, zh = f"nothing of unit {name} was recorded for {silent_s:,.0f} s in run {run}", f"{silent_s:,.0f}秒"
                text = Bilingual(
                    f"{en}; check its power and wiring", f"产品{name}在试验{run}中已{zh}无记录；请检查供电与接线"
                )
                if is_all:
                    text = Bilingual(
                        f"{en}, nor of any other unit; see that recorder, bus and station are at work",
                        f"产品{name}在试验{run}中已{zh}无记录，其他产品亦无；请检查记录程序、总线与试验台",
                    )
                yield Finding(f"{run}/{name}", name, text, unit=name)

    def ending(self, key: str, raised_ns: int, view: AlertView) -> Bilingual | None:
        """That its run is over, or it has no power, and it has not sent again before."""
        run, _, name = key.rpartition("/")
        unit = view.units.get(name)
        if unit is not None and unit.arrival_ns > raised_ns:  # perhaps in another run
            return None
        if unit is None or unit.run.run != run or unit.run.outcome != "open":
            return Bilingual("the run ended while the unit was silent", "试验在该产品无记录期间结束")
        return (
            Bilingual("the unit was switched off while it was silent", "该产品在无记录期间断电")
            if unit.is_off
            else None
        )


def _is_awaited(unit: UnitNow | None, run: str) -> bool:
    """Whether the first sample of a unit is still to come: it is neither off nor released."""
    return unit is None or unit.run.run != run or (not unit.arrival_ns and not unit.is_off)
