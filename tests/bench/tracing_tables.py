"""One table for each row of what the trace must show, from the lines of its campaigns.

A target on a rate fails only where the one-sided 99.9 % binomial bound of the count, corrected for the number of
checks made together, excludes it.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from scipy import stats

from analytics.loop.effects.base import Role
from analytics.loop.effects.registry import effect
from tests.bench.tracing_peers import PEERS

Line = dict[str, Any]
LEVEL = 0.001
CHECKS = 24
"""How many rates are judged together."""
ACHIEVABLE = 0.9
RIGHT = ("exact", "in_set")


def at_most(count: int, n: int, rate: float) -> bool:
    """Whether a count is compatible with a rate of at most `rate`.

    Examples
    --------
    >>> at_most(2, 40, 0.03), at_most(9, 40, 0.03)
    (True, False)
    """
    return float(stats.binom.sf(count - 1, n, rate)) >= LEVEL / CHECKS


def at_least(count: int, n: int, rate: float) -> bool:
    """Whether a count is compatible with a rate of at least `rate`."""
    return at_most(n - count, n, 1.0 - rate)


def judged(what: str, count: int, n: int, rate: float, *, most: bool) -> tuple[str, bool]:
    """A line of a table, and whether the target stands."""
    if not n:
        return f"{what:58s} did not run", True
    kept = (at_most if most else at_least)(count, n, rate)
    sign = "<=" if most else ">="
    return f"{what:58s} {count:5d} of {n:5d} = {count / n:7.2%}   {sign} {rate:.0%} {'' if kept else 'FAILS'}", kept


def tables(lines: Sequence[Line]) -> tuple[list[str], bool]:
    """All tables as text, and whether every target stands."""
    text, kept = [], True
    makers: Sequence[Callable[[Sequence[Line]], Iterator[str | tuple[str, bool]]]] = (
        null_table,
        excess_table,
        planted_table,
        two_table,
        design_table,
        error_table,
        peer_table,
    )
    for maker in makers:
        for row in maker(lines):
            if isinstance(row, str):
                text.append(row)
            else:
                text.append("  " + row[0])
                kept &= row[1]
    return text, kept


def null_table(lines: Sequence[Line]) -> Iterator[str | tuple[str, bool]]:
    """False effects where nothing is planted."""
    own = [each for each in lines if each["row"] == "null"]
    yield "\nNothing planted, noise not as declared: an effect named"
    for name in sorted({each["name"] for each in own}):
        of_name = [each for each in own if each["name"] == name]
        before, after = _false(of_name)
        once = sum(bool(each["seen_once"]) for each in of_name)
        verdicts = _counted(Counter(each["verdict"] for each in of_name))
        counts = f"n {len(of_name):3d}  before {before:2d}  after {after:2d}  seen once {once:2d}"
        yield f"    {name:22s} {counts}  {verdicts}"
    before, after = _false(own)
    yield judged("before the held-out set", before, len(own), 0.03, most=True)
    yield judged("after the held-out set", after, len(own), 0.01, most=True)


def excess_table(lines: Sequence[Line]) -> Iterator[str | tuple[str, bool]]:
    """Noise that is far from the declared one."""
    own = [each for each in lines if each["row"] == "excess"]
    for name in sorted({each["name"] for each in own}):
        of_name = [each for each in own if each["name"] == name]
        verdicts = Counter(each["verdict"] for each in of_name)
        yield f"\nNothing planted, {name}: {_counted(verdicts)}"
        for each in of_name:
            if each["verdict"] != "unexplained":
                yield f"    seed {each['seed']}: {_said(each)}"
        yield judged("unexplained", verdicts["unexplained"], len(of_name), 0.95, most=False)


def _false(lines: Sequence[Line]) -> tuple[int, int]:
    """Campaigns with an effect before the held-out set, and after it; a jump never counts as confirmed."""
    confirmed = sum(any(found["replicates"] for found in each["found"]) for each in lines)
    return sum(bool(each["found"] or each["refused"]) for each in lines), confirmed


_LARGE_Z = 10.0


def planted_table(lines: Sequence[Line]) -> Iterator[str | tuple[str, bool]]:
    """Single effects by size."""
    planted = [each for each in lines if each["row"] == "planted"]
    for z in sorted({each["z"] for each in planted}):
        hit, wrong = (0.97, 0.0) if z >= _LARGE_Z else (0.90, 0.01)
        own = [each for each in planted if each["z"] == z]
        counts = Counter(each["outcome"] for each in own)
        yield f"\nOne effect planted, z = {z:g}: {_counted(counts)}"
        for each in own:
            if each["outcome"] not in RIGHT:
                yield f"    {each['outcome']:20s} {each['name']} seed {each['seed']}: {_said(each)}"
        causes = [each for each in own if effect(each["name"]).role is not Role.PROXY]
        yield judged("exact or in the confounded set", _right(own), len(own), hit, most=False)
        yield judged("the same but for proxies", _right(causes), len(causes), hit, most=False)
        yield judged("wrong name", counts["wrong"], len(own), max(wrong, 1e-3), most=True)
        yield f"    the truth and an effect that is not there: {counts['beside']}"


def two_table(lines: Sequence[Line]) -> Iterator[str | tuple[str, bool]]:
    """Two effects at once."""
    own = [each for each in lines if each["row"] == "two"]
    yield f"\nTwo effects, z = 12 each: {_counted(Counter(each['outcome'] for each in own))}"
    for each in own:
        if each["outcome"] not in RIGHT:
            yield f"    {each['outcome']:20s} {each['name']} seed {each['seed']}: {_said(each)}"
    yield judged("both and nothing else", _right(own), len(own), 0.9, most=False)


def design_table(lines: Sequence[Line]) -> Iterator[str | tuple[str, bool]]:
    """Designs that hide the truth."""
    right: dict[str, tuple[str, Callable[[Line], bool]]] = {
        "ramp": (
            "one ramp in every run: the truth in the set",
            lambda each: each["outcome"] == "in_set" or each["outcome"] in ("exact", "unreplicated"),
        ),
        "once": (
            "type of test run once: unreplicated",
            lambda each: each["verdict"] == "unreplicated" and each["outcome"] in ("unreplicated", "unreplicated_form"),
        ),
        "outside": (
            "outside the library: unknown function, unexplained",
            lambda each: each["outcome"] in ("exact", "unexplained"),
        ),
        "removed": (
            "removed after promotion: rolled back, and only then",
            lambda each: "watch" in each and each["watch"]["removed"] is not None and each["watch"]["kept"] is None,
        ),
    }
    for row, (what, is_right) in right.items():
        own = [each for each in lines if each["row"] == row]
        if not own:
            continue
        yield f"\n{what}: {_counted(Counter(each['outcome'] for each in own))}"
        for each in own:
            if not is_right(each):
                reported = f"{_said(each)} {each.get('watch') or ''}"
                yield f"    {each['outcome']:20s} {each['name']} seed {each['seed']}: {reported}"
        yield judged("right verdict", sum(map(is_right, own)), len(own), 0.9, most=False)
        wrong = sum(each["verdict"] == "effect_found" and each["outcome"] in ("wrong", "wrong_form") for each in own)
        yield judged("wrong single name", wrong, len(own), 1e-3, most=True)


def error_table(lines: Sequence[Line]) -> Iterator[str | tuple[str, bool]]:
    """Error before, after and floor on the held-out set, z >= 10, where the effect was named."""
    own = [each for each in lines if each["row"] == "planted" and each["z"] >= 10 and each["outcome"] in RIGHT]
    own = [each for each in own if each["error"] and each["found"][0]["replicates"]]
    whole = [each["error"]["fraction"] for each in own if each["error"]["fraction"] is not None]
    excited = [each["error"]["fraction_excited"] for each in own if each["error"]["fraction_excited"] is not None]
    yield "\nError on the held-out set at 1800 s, z >= 10: part of what could be won that was won"
    for what, values in (("all averages", whole), ("averages in which the effect is excited", excited)):
        if values:
            low, middle, high = np.quantile(values, (0.05, 0.5, 0.95))
            yield f"    {what:42s} n {len(values):4d}  5 % {low:6.3f}  median {middle:6.3f}  95 % {high:6.3f}"
    for z in sorted({each["z"] for each in own}):
        errors = [each["error"]["excited"] for each in own if each["z"] == z and None not in each["error"]["excited"]]
        if errors:
            before, after, floor = (np.sum(np.square(column)) for column in zip(*errors, strict=True))
            won = float((before - after) / (before - floor))
            row = f"z = {z:g}: all campaigns together, {len(errors)}"
            yield f"{row:58s} {won:7.3f}   >= {ACHIEVABLE} {'' if won >= ACHIEVABLE else 'FAILS'}", won >= ACHIEVABLE


def peer_table(lines: Sequence[Line]) -> Iterator[str | tuple[str, bool]]:
    """Side by side with what is ordinarily done."""
    own = [each for each in lines if "peers" in each]
    null, planted = ([each for each in own if each["row"] == row] for row in ("null", "planted"))
    if not own:
        return
    yield f"\nSide by side: {len(null)} campaigns with nothing planted, {len(planted)} with one effect"
    yield f"    {'':22s} {'false effect':>14s} {'exact or set':>14s} {'truth + others':>15s} {'truth missed':>14s}"
    _, false = _false(null)
    hit, beside = _right(planted), sum(each["outcome"] == "beside" for each in planted)
    yield _peer_row("gyrofleet diagnose", (false, len(null)), hit, beside, len(planted))
    for peer in PEERS:
        false = sum(bool(each["peers"][peer]) for each in null)
        hit = sum(each["peers"][peer] == [each["name"]] for each in planted)
        beside = sum(each["name"] in each["peers"][peer] for each in planted) - hit
        yield _peer_row(peer, (false, len(null)), hit, beside, len(planted))


def _peer_row(name: str, false: tuple[int, int], hit: int, beside: int, n: int) -> str:
    parts = (false, (hit, n), (beside, n), (n - hit - beside, n))
    return f"    {name:22s} " + " ".join(f"{count / size if size else float('nan'):14.1%}" for count, size in parts)


def _right(lines: Sequence[Line]) -> int:
    return sum(each["outcome"] in RIGHT for each in lines)


def _counted(counts: Counter[str]) -> str:
    return ", ".join(f"{count} {name}" for name, count in counts.most_common())


def _said(line: Line) -> str:
    found = [
        each["name"] + (f" ({', '.join(each['confounded'])})" if each["confounded"] else "") for each in line["found"]
    ]
    refused = [each["name"] for each in line["refused"]]
    return (
        f"{line['verdict']}: {'; '.join(found) or 'nothing'}; refused {refused or '-'}; once {line['seen_once'] or '-'}"
    )
