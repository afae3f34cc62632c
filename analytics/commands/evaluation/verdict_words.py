"""Words and tables of verdicts on the terminal, in English and Chinese."""

from collections.abc import Iterable
from typing import Any

from rich.text import Text

from analytics.commands.evaluation.plants import named
from stream.terminal.console import styled
from stream.terminal.result_table import ResultTable

_COLOURS = {"PASS": "green", "FAIL": "red", "MARGINAL": "yellow", "NO_DATA": "dim"}
_ZH_VERDICTS = {"PASS": "合格", "FAIL": "不合格", "MARGINAL": "临界", "NO_DATA": "无数据"}
ZH = {
    "passed units": "合格数", "failed units": "不合格数", "marginal units": "临界数", "units without data": "无数据数",
    "week": "周", "month": "月", "all": "全部",
    "unit": "产品编号", "product": "产品型号", "lot": "批次", "verdict": "判定", "latest": "最近判定",
    "passed": "合格项", "failed": "不合格项", "marginal": "临界项", "no data": "无数据项", "fails by": "不合格特性",
    "characteristic": "特性", "signal": "信号", "run": "试验", "value": "数值", "95 % interval": "95 % 区间",
    "limits": "限值", "standard": "标准", "revision": "规范版本", "reason": "原因", "units": "产品数",
    "yield": "合格率", "judged": "已判定", "share": "占比", "cumulative": "累计", "station": "试验台",
    "fixture": "夹具", "day": "日期", "rule": "判定规则", "accepted": "接受", "rejected": "拒绝",
    "consumer": "使用方风险", "producer": "生产方风险", "of process": "过程风险", "conformity": "合格概率",
}  # fmt: skip


def group_name(row: dict[str, Any], language: str, column: str = "name") -> str:
    """The name of a lot, station or other group; that of units without one."""
    from analytics.specifications.verdicts import UNGIVEN, UNGIVEN_ZH

    ungiven = UNGIVEN_ZH if language == "zh" else UNGIVEN
    return named(row | {column: ungiven} if row[column] is None else row, column)


def table_of(titles: Iterable[str], language: str) -> ResultTable:
    """An empty table with its titles in a language."""
    return ResultTable(*(ZH.get(title, title) if language == "zh" else title for title in titles))


def name_of_metric(metric: str, language: str) -> str:
    """A metric's name; an entered check may have a name of its own."""
    from analytics.evaluation.table import name_of
    from analytics.metric_registry.registry import metrics

    if metric in metrics():
        return name_of(metric, language)
    return ZH.get(metric, metric) if language == "zh" else metric


def verdict_text(verdict: str, language: str) -> str:
    """A verdict in a language."""
    return _ZH_VERDICTS[verdict] if language == "zh" else verdict


def coloured(verdict: str, language: str) -> Text:
    """The same in its colour."""
    return styled(verdict_text(verdict, language), _COLOURS[verdict])
