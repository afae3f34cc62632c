"""What an act does that two persons are needed for, in a few words."""

from typing import NamedTuple

from stream.events import (
    AnyDocument,
    ApprovedAct,
    CertificateIssued,
    ModelActivated,
    SpecificationAction,
    SpecificationEntered,
)

_ACTIONS = {
    SpecificationAction.ADDED: ("add", "添加"), SpecificationAction.REVISED: ("revise to", "修订为"),
    SpecificationAction.WITHDRAWN: ("withdraw", "撤销"), SpecificationAction.SETTLED: ("settle", "了结"),
}  # fmt: skip
_STAGES = {"live": "启用", "shadow": "影子运行", "off": "停用"}


class ActTitle(NamedTuple):
    """The same words in English and Chinese."""

    en: str
    zh: str


def act_title(act: ApprovedAct | AnyDocument) -> ActTitle:
    """What an act does.

    >>> act_title(ModelActivated(run="", t_ns=1, unit="U1", model="hash", version=3, stage="off")).en
    'unit U1, rate: version 3 of its error model off'
    """
    if isinstance(act, ModelActivated):
        return ActTitle(
            f"unit {act.unit}, {act.signal}: version {act.version} of its error model {act.stage}",
            f"产品 {act.unit}，{act.signal}：误差模型第 {act.version} 版{_STAGES.get(act.stage, act.stage)}",
        )
    if isinstance(act, CertificateIssued):
        instead = (f" in place of {act.supersedes}", f"，替代 {act.supersedes}") if act.supersedes else ("", "")
        return ActTitle(
            f"issue certificate {act.number} of unit {act.unit}{instead[0]}",
            f"为产品 {act.unit} 签发证书 {act.number}{instead[1]}",
        )
    assert isinstance(act, SpecificationEntered)
    en, zh = _ACTIONS[act.action]
    if not act.name:
        return ActTitle(f"{en} the chain of specifications", f"{zh}产品规范链")
    label = f"{act.name}-{act.revision}"
    return ActTitle(f"{en} specification {label}", f"{zh}产品规范 {label}")
