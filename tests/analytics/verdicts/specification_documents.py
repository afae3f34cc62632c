"""Documents of specifications, and limits to put into them."""

from collections.abc import Callable
from typing import Any

from stream.events import SpecificationAction, SpecificationEntered

Specify = Callable[..., str]


def entered(name: str, revision: str, previous: str = "", **words: Any) -> SpecificationEntered:
    action = SpecificationAction.ADDED if words.get("content") else SpecificationAction.WITHDRAWN
    given = {"run": "", "t_ns": 0, "by": "Li", "action": action, **words}
    return SpecificationEntered(name=name, revision=revision, previous=previous, **given)


def limit(upper: float, head: str = "", metric: str = "bias") -> str:
    parameters = 'parameters = { earth_rate = "none" }' if metric == "bias" else "parameters = { average_s = 10 }"
    return f'{head}\n[[limit]]\nmetric = "{metric}"\nupper = {upper}\nunit_of_measure = "deg/h"\n{parameters}\n'
