"""Why a login by OpenID Connect fails: a reason that pages know in both languages, and a sentence."""

from typing import Literal

from analytics.serve.problems import HttpProblem

Reason = Literal["unreachable", "clock", "no_role", "no_name", "denied", "stale", "token"]
_STATUS: dict[Reason, int] = {"unreachable": 503}


class OidcProblem(HttpProblem):
    """A login that fails; `detail` is for the log, `parts` fill the text of the page."""

    def __init__(self, reason: Reason, detail: str, **parts: str) -> None:
        super().__init__(detail)
        self.reason, self.parts = reason, parts
        self.status = _STATUS.get(reason, 403)
