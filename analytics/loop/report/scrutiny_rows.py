"""How far a diagnosis can be relied on, as tables: regressors, coherence, recovery, provenance."""

from collections.abc import Mapping, Sequence

from analytics.loop.channel_coherence import ChannelCoherence
from analytics.loop.provenance import Provenance
from analytics.loop.recovery import Recovery
from analytics.loop.regressor_diagnostics import RegressorDiagnostics
from analytics.loop.report.report_tables import TextTable
from analytics.loop.report.wording import Wording, number

_MOST_CHANNELS = 8


def regressor_rows(found: RegressorDiagnostics, words: Wording) -> TextTable:
    """Collinearity and leverage of each column of the model found."""
    head = words.each(
        ("term", "项"), ("variance inflation", "方差膨胀因子"), ("most correlated with", "相关最大者"),
        ("correlation", "相关系数"), ("run with most leverage", "杠杆最大的试验"), ("its share", "其占比"),
    )  # fmt: skip
    rows = []
    for each in found.regressors:
        run, share = max(each.leverage.items(), key=lambda item: item[1], default=("", 0.0))
        vif = words.of("determined by the others", "由其余项决定") if each.vif is None else f"{each.vif:.3g}"
        rows.append((each.name, vif, each.nearest, f"{each.correlation:.2f}", run, f"{share:.0%}"))
    title = words.of(
        f"Regressors of the model found (condition number {found.condition:.3g})",
        f"所得模型的回归量（条件数{found.condition:.3g}）",
    )
    return TextTable(title, head, tuple(rows))


def coherence_rows(found: Sequence[ChannelCoherence], words: Wording) -> TextTable:
    """Coherence of the residual of the model found with the channels, the least likely by chance first."""
    head = words.each(
        ("channel", "通道"), ("coherence", "相干系数"), ("at Hz", "频率Hz"), ("p-value", "p值"), ("lag s", "滞后s"),
        ("correlation", "相关系数"),
    )  # fmt: skip
    rows = [
        (each.channel, f"{each.coherence:.2f}", number(each.frequency_hz), f"{each.p_value:.2g}",
         f"{each.lag_s:g}", f"{each.correlation:.2f}")
        for each in found[:_MOST_CHANNELS]
    ]  # fmt: skip
    title = words.of(
        "Coherence of the remaining residual with the channels (p-values for all frequencies and channels)",
        "剩余残差与各通道的相干（p值已计入全部频率与通道）",
    )
    return TextTable(title, head, tuple(rows))


def recovery_sentences(found: Mapping[str, Recovery], words: Wording) -> list[str]:
    """How often effects of the sizes found are found again."""
    return [
        words.of(
            f"An effect like {words.name(name)} of this size, planted in these data, is found in {each.share:.0%} "
            f"(95 %: {each.lo:.0%} … {each.hi:.0%}) of {each.tries} tries: {each.alone} times alone, "
            f"{each.in_set} times in a set that the data cannot separate.",
            f"在这些数据中植入同样大小的{words.name(name)}，{each.tries}次中有{each.share:.0%}（95 %：{each.lo:.0%} … "
            f"{each.hi:.0%}）被检出：单独检出{each.alone}次，在不可区分的集合中{each.in_set}次。",
        )
        for name, each in found.items()
    ]


def provenance_rows(found: Provenance, words: Wording) -> TextTable:
    """Who asked, when, with which version, and the hash of each run's reduced data."""
    head = words.each(("run", "试验"), ("SHA-256 of the reduced data", "归约数据的SHA-256"))
    title = words.of(
        f"Asked by {found.by} at {found.at}, gyrofleet {found.version}",
        f"{found.by}于{found.at}询问，gyrofleet {found.version}",
    )
    return TextTable(title, head, tuple(found.sha256.items()))
