"""Names of metrics: which there are, and what looks like them."""

import difflib
from collections.abc import Collection, Iterable

from analytics.metrics.registry import metrics
from stream.errors import BadInput


def check_metrics(names: Iterable[str], where: str = "") -> None:
    """Refuse what is no metric.

    Raises
    ------
    BadInput: The message names metrics that look alike.

    Examples
    --------
    >>> check_metrics(["biass"], "spec.toml: $.limit[0]")
    Traceback (most recent call last):
    stream.errors.BadInput: spec.toml: $.limit[0]: there is no metric 'biass'; did you mean bias?
    """
    for name in names:
        if name not in metrics():
            place = f"{where}: " if where else ""
            raise BadInput(f"{place}there is no metric {name!r}; {alike(name, metrics(), 'metrics are')}")


def alike(name: str, known: Collection[str], else_: str) -> str:
    """What might have been meant: names that look alike, or, where none does, some that are known.

    Examples
    --------
    >>> alike("FOG-O231", ["FOG-0230", "FOG-0231"], "there are")
    'did you mean FOG-0231?'
    """
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.6)
    folded = [each for each in known if each.casefold() == name.casefold()]
    if folded or near:
        return f"did you mean {(folded or near)[0]}?"
    names = sorted(known)
    return f"{else_} {', '.join(names[:20])}{', ...' if len(names) > 20 else ''}" if names else "there is none"
