"""The rules of a site: which conditions are alerts, after how long, and to whom they are reported (TOML)."""

import datetime as dt
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from pkgutil import iter_modules
from typing import Annotated, Any
from zoneinfo import ZoneInfo

import msgspec

import analytics.alerts.conditions
from analytics.alerts.email_target import EmailTarget
from analytics.alerts.finding import Condition, Finding
from analytics.alerts.targets import Target
from analytics.alerts.webhook_target import WebhookTarget
from stream.decoding import converted
from stream.errors import BadInput
from stream.files.own_files import imported
from stream.files.toml_text import decode_toml
from stream.mistakes import collected, listed, mistakes

ALARM = "alarm"
WARNING = "warning"
_OWN = ("name", "severity", "to", "after_s", "clear_after_s", "units")


class QuietHours(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Hours of the day in which only alarms are sent; other messages wait until they end."""

    begin: str
    end: str
    time_zone: str = "UTC"
    holds_alarms: bool = False

    def covers(self, t_ns: int) -> bool:
        """Whether a moment is in them.

        >>> night = QuietHours(begin="22:00", end="06:00")
        >>> [night.covers(hour * 3600 * 10**9) for hour in (5, 6, 12, 22)]
        [True, False, False, True]
        """
        now = dt.datetime.fromtimestamp(t_ns / 1e9, ZoneInfo(self.time_zone)).time()
        begin, end = dt.time.fromisoformat(self.begin), dt.time.fromisoformat(self.end)
        return begin <= now < end if begin <= end else now >= begin or now < end


class Rule(msgspec.Struct, frozen=True, kw_only=True):
    """A condition, how long it lasts before it is an alert, and its targets."""

    name: str
    condition: Condition
    to: tuple[str, ...]
    severity: str = WARNING
    after_s: float = 0.0
    clear_after_s: float = 60.0
    units: str = "*"

    def concerns(self, finding: Finding) -> bool:
        """Whether the rule is for the unit of a finding."""
        return finding.unit is None or fnmatchcase(finding.unit, self.units)


class Rules(msgspec.Struct, frozen=True, kw_only=True):
    """Rules, targets by name, and their quiet hours."""

    rules: tuple[Rule, ...]
    targets: dict[str, Target]
    quiet: dict[str, QuietHours]


class _File(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    rules: list[dict[str, Any]]
    targets: dict[str, dict[str, Any]] = {}


def condition_kinds() -> dict[str, type[Condition]]:
    """The installed conditions by the `kind` of their rules.

    >>> sorted(condition_kinds())[:3]
    ['certificate', 'control_chart', 'damaged_segment']
    """
    for module in iter_modules(analytics.alerts.conditions.__path__):
        imported(analytics.alerts.conditions.__name__, module.name)
    return {str(kind.__struct_config__.tag): kind for kind in _without_subclasses(Condition)}


def _without_subclasses(kind: type[Condition]) -> list[type[Condition]]:
    below = kind.__subclasses__()
    return [leaf for each in below for leaf in _without_subclasses(each)] if below else [kind]


def load_rules(path: Path) -> Rules:
    """Read a file of rules; raises BadInput, with the rule or target, if it cannot be read or is wrong."""
    try:
        file = decode_toml(path.read_bytes(), _File)
    except OSError as error:
        raise BadInput(f"the rules {path} cannot be read: {error.strerror}") from error
    except msgspec.MsgspecError as error:
        raise BadInput(f"{path}: {error}") from error
    quiet: dict[str, QuietHours] = {}
    targets: dict[str, Target] = {}
    wrong: list[str] = []
    for name, table in file.targets.items():
        where = f"targets.{name}"
        hours = table.pop("quiet", None)
        with collected(wrong):
            if hours is not None:
                quiet[name] = _converted(where, hours, QuietHours)
                _check_hours(where, quiet[name])
        with collected(wrong):
            targets[name] = _target(where, table)
    made: list[Rule] = []
    for number, each in enumerate(file.rules, start=1):
        with collected(wrong):
            made.append(_rule(number, each, list(file.targets)))
    if wrong:
        raise BadInput(f"{path}: {listed(wrong)}")
    rules = tuple(made)
    names = [rule.name for rule in rules]
    if twice := {name for name in names if names.count(name) > 1}:
        raise BadInput(f"{path}: two rules are named {min(twice)!r}; give each a name of its own")
    return Rules(rules=rules, targets=targets, quiet=quiet)


def _target(where: str, table: dict[str, Any]) -> Target:
    kinds: dict[str, type[Target]] = {"email": EmailTarget, "webhook": WebhookTarget}
    kind = table.pop("kind", None)
    if not isinstance(kind, str) or kind not in kinds:
        raise BadInput(f"{where}.kind is {kind!r}; there are {', '.join(kinds)}")
    found: Target = _converted(where, table, kinds[kind])
    return found


def _rule(number: int, table: dict[str, Any], targets: Sequence[str]) -> Rule:
    kinds = condition_kinds()
    kind = table.pop("kind", None)
    where = f"rule {number} ({kind})"
    if not isinstance(kind, str) or kind not in kinds:
        raise BadInput(f"rule {number}: kind is {kind!r}; there are {', '.join(sorted(kinds))}")
    own = {name: table.pop(name) for name in _OWN if name in table}
    shared = {name: own[name] for name in kinds[kind].__struct_fields__ if name in own}
    condition = _converted(where, {"kind": kind, **table, **shared}, kinds[kind])
    try:
        condition.check()
    except BadInput as error:
        raise BadInput(f"{where}: {error}") from error
    rule = _converted(where, {"name": kind, "to": list(targets), **own, "condition": None}, _RuleTable)
    if unknown := set(rule.to) - set(targets):
        raise BadInput(f"{where}: to names {min(unknown)!r}; the file has the targets {', '.join(targets) or 'none'}")
    if rule.severity not in {ALARM, WARNING}:
        raise BadInput(f"{where}: severity is {rule.severity!r}; it is {ALARM} or {WARNING}")
    return Rule(
        name=rule.name, condition=condition, to=rule.to, severity=rule.severity, after_s=rule.after_s,
        clear_after_s=rule.clear_after_s, units=rule.units,
    )  # fmt: skip


class _RuleTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    name: str
    to: tuple[str, ...]
    condition: None = None
    severity: str = WARNING
    after_s: Annotated[float, msgspec.Meta(ge=0.0)] = 0.0
    clear_after_s: Annotated[float, msgspec.Meta(ge=0.0)] = 60.0
    units: str = "*"


def _converted(where: str, table: dict[str, Any], kind: type[Any]) -> Any:
    try:
        return converted(table, kind)
    except msgspec.ValidationError as error:
        raise BadInput(*(f"{where}: {each}" for each in list(mistakes(table, kind)) or [str(error)])) from error


def _check_hours(where: str, hours: QuietHours) -> None:
    try:
        hours.covers(0)
        is_local = all(dt.time.fromisoformat(each).tzinfo is None for each in (hours.begin, hours.end))
    except (ValueError, KeyError, OSError, TypeError) as error:
        raise BadInput(
            f'{where}.quiet: {error}; write begin = "22:00", end = "06:00", time_zone = "Asia/Shanghai"'
        ) from error
    if not is_local or hours.begin == hours.end:
        raise BadInput(f'{where}.quiet: begin and end are two times of the day, as "22:00" and "06:00"')
