"""The 24 rows of JJF 2014-2022 annex A (inner page of the certificate) for one unit."""

from collections import defaultdict
from typing import NamedTuple

from analytics.evaluation.selection import Row, Selection, selected
from analytics.metric_registry.registry import metrics
from storage.sql.catalog import Catalog

STANDARD = "JJF2014"


class Characteristic(NamedTuple):
    """A row of the annex: its name as it is printed there, and the metric that fills it."""

    zh: str
    en: str
    metric: str


_ROWS = """\
scale_factor: 标度因数: Scale factor
scale_factor_nonlinearity: 标度因数非线性度: Scale factor nonlinearity
range: 量程: Range
scale_factor_asymmetry: 标度因数不对称度: Scale factor asymmetry
scale_factor_repeatability: 标度因数重复性: Scale factor repeatability
scale_factor_temperature_sensitivity: 标度因数温度灵敏度: Scale factor temperature sensitivity
scale_factor_acceleration_sensitivity: 标度因数轴向加速度敏感度: Scale factor sensitivity to axial acceleration
scale_factor_shock_change: 标度因数冲击前后变化量: Change of the scale factor by shock
scale_factor_vibration_change: 标度因数振动前后变化量: Change of the scale factor by vibration
threshold: 阈值: Threshold
resolution: 分辨率: Resolution
misalignment: 输入轴失准角: Input axis misalignment
misalignment_repeatability: 输入轴失准角重复性: Input axis misalignment repeatability
bias: 零偏: Bias
bias_stability_averaged: 零偏稳定性: Bias stability
bias_repeatability: 零偏重复性: Bias repeatability
bias_temperature_sensitivity: 零偏温度灵敏度: Bias temperature sensitivity
bias_acceleration_sensitivity: 零偏加速度灵敏度: Bias acceleration sensitivity
bias_shock_change: 零偏冲击前后变化量: Change of the bias by shock
bias_vibration_change: 零偏振动前后变化量: Change of the bias by vibration
angle_random_walk: 角度随机游走系数: Angle random walk
bandwidth: 带宽: Bandwidth
output_delay: 输出延迟时间: Output delay
startup_time: 启动时间: Start-up time
"""
_NAMES = (line.split(": ") for line in _ROWS.splitlines())
CHARACTERISTICS = tuple(Characteristic(zh, en, metric) for metric, zh, en in _NAMES)


class AnnexRow(NamedTuple):
    """One characteristic of a unit: the values of the last run with any, or the reason why there is none."""

    number: int
    characteristic: Characteristic
    results: tuple[Row, ...]
    reason: str | None

    @property
    def clause(self) -> str:
        """Clause of the standard."""
        sources = metrics()[self.characteristic.metric].header.sources
        return "; ".join(each.clause for each in sources if each.standard == STANDARD)

    def document(self) -> dict[str, object]:
        """The row as JSON."""
        names = self.characteristic._asdict()
        return {"number": self.number, **names, "results": self.results, "reason": self.reason}


def annex_a(catalog: Catalog, unit: str) -> list[AnnexRow]:
    """The annex of a unit: always 24 rows."""
    rows = selected(catalog, Selection(units=(unit,), standards=(STANDARD,)))
    began = dict(catalog.rows("select run, t_start_ns from unit_runs where unit = $unit", {"unit": unit}))
    of_metric: defaultdict[str, list[Row]] = defaultdict(list)
    for row in rows:
        of_metric[row["metric"]].append(row)
    return [_row(number, each, of_metric[each.metric], began) for number, each in enumerate(CHARACTERISTICS, 1)]


def _row(number: int, characteristic: Characteristic, rows: list[Row], began: dict[str, int]) -> AnnexRow:
    if not rows:
        needs = metrics()[characteristic.metric].header.needs
        return AnnexRow(number, characteristic, (), f"no completed step gives it: it needs {needs}")

    def when(row: Row) -> int:
        return max((began.get(run, 0) for run in row["runs"] or [row["run"]]), default=0)

    results: list[Row] = []
    for signal in sorted({row["signal"] or "" for row in rows}):
        valued = [row for row in rows if (row["signal"] or "") == signal and row["value"] is not None]
        # clause 6.1 asks for (20 +- 5) degC: other temperatures are shown only where there is nothing else
        valued = [row for row in valued if row["parameters"].get("room") is not False] or valued
        last = max((when(row) for row in valued), default=0)
        results += [row for row in valued if when(row) == last]
    if results:
        return AnnexRow(number, characteristic, tuple(results), None)
    return AnnexRow(number, characteristic, (), max(rows, key=when)["reason"])
