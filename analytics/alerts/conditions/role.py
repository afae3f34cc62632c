"""A role of the system is paused, has failed, was killed, is silent or lags, or the disk runs full."""

from collections.abc import Iterator
from typing import Annotated, Literal

import msgspec

from analytics.alerts.finding import AlertView, Condition, Finding
from analytics.loop.bilingual import Bilingual
from stream.status.role_status import Role

_ZH = {"paused": "已暂停", "failed": "已失败", "interrupted": "已中断", "killed": "已被终止", "silent": "无响应"}
_UNKNOWN = "not heard, as no recorder is at work", "状态未知（记录器未运行）"


class RoleCondition(Condition, frozen=True, kw_only=True, tag="role"):
    """A recorder, estimator, builder of the lake or run is in one of `conditions`."""

    roles: tuple[Role, ...] = (Role.RECORD, Role.ESTIMATE, Role.LAKE, Role.RUN)
    conditions: tuple[Literal["paused", "failed", "interrupted", "killed", "silent", "ended"], ...] = (
        "paused", "failed", "interrupted", "killed", "silent"
    )  # fmt: skip

    def findings(self, view: AlertView) -> Iterator[Finding]:
        """Roles in trouble now."""
        for each in view.status.roles:
            role, condition = each.status.role.value, each.condition
            # of one that reports through the recorder nobody knows more than that it is silent
            if role in self.roles and ("silent" if condition == "unknown" else condition) in self.conditions:
                name = f"`gyrofleet {role}` ({each.status.name})"
                why = f": {each.status.trouble}" if each.status.trouble else ""
                en, zh = _UNKNOWN if condition == "unknown" else (condition, _ZH.get(condition, condition))
                text = Bilingual(f"{name} is {en}{why}", f"{name}{zh}{why}")
                yield Finding(f"{each.status.file_name}/{condition}", name, text)


class DiskCondition(Condition, frozen=True, kw_only=True, tag="disk"):
    """Less than `free_gb` gigabytes, or less than `free_percent` of the store's disk, are free."""

    free_gb: Annotated[float, msgspec.Meta(ge=0.0)] = 10.0
    free_percent: Annotated[float, msgspec.Meta(ge=0.0, le=100.0)] = 5.0

    def findings(self, view: AlertView) -> Iterator[Finding]:
        """The disk, if it runs full."""
        free, size = view.status.free_bytes, view.status.disk_bytes
        if free < self.free_gb * 1e9 or free < self.free_percent / 100.0 * size:
            text = Bilingual(
                f"{free / 1e9:,.1f} GB of {size / 1e9:,.1f} GB are free on the disk of the store {view.status.store}",
                f"存储{view.status.store}所在磁盘剩余{free / 1e9:,.1f} GB，共{size / 1e9:,.1f} GB",
            )
            yield Finding("disk", view.status.store, text)
