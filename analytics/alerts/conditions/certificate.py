"""The certificate of a role ends soon, or has ended."""

import datetime as dt
import time
from collections.abc import Iterator
from typing import Annotated

import msgspec

from analytics.alerts.finding import AlertView, Condition, Finding
from analytics.loop.bilingual import Bilingual


class CertificateCondition(Condition, frozen=True, kw_only=True, tag="certificate"):
    """The certificate of a recorder, estimator or run ends within `within_h` hours, or has ended."""

    within_h: Annotated[float, msgspec.Meta(ge=0.0)] = 48.0

    def findings(self, view: AlertView) -> Iterator[Finding]:
        """Roles that report such a certificate and are not ended."""
        for each in view.status.roles:
            ends_s = each.status.numbers.get("certificate_ends_seconds")
            if ends_s is None or each.condition == "ended" or ends_s - time.time() > 3600.0 * self.within_h:
                continue
            name = f"`gyrofleet {each.status.role}` ({each.status.name})"
            when = f"{dt.datetime.fromtimestamp(ends_s, dt.UTC):%Y-%m-%d %H:%M} UTC"
            is_over = ends_s <= time.time()
            renew = "`gyrofleet site renew`"
            text = Bilingual(
                f"{name}: its certificate {'ended' if is_over else 'ends'} on {when}; renew it with {renew}",
                f"{name}的证书{'已于' if is_over else '将于'}{when}到期；请用 {renew} 更新",
            )
            yield Finding(f"{each.status.role}/{each.status.name}", name, text)
