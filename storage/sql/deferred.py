"""Definitions of SQL scripts, each run when a statement first names it: binding a view binds all that it stands on.

With a hundred views this takes most of the time of a short statement, which needs a few of them.
"""

import re
from collections.abc import Callable, Collection, Iterable
from functools import cache, lru_cache
from itertools import count
from typing import NamedTuple

_CREATES = re.compile(r'create or replace (view|macro|table) (?:internal\.)?"?(\w+)')
_VIEW = re.compile(r'\s*create or replace view [\w."]+')
_COMMENTS = re.compile(r'comment on (?:view|table) (?:internal\.)?"?(\w+)')
_NAMES = re.compile(
    r'(?:\b(?:from|join|into|table|pivot|unpivot|describe|summarize)\s|,)\s*(?:"?\w+"?\s*\.\s*)*"?(?P<table>\w+)'
    r'|(?P<macro>\w+)"?\s*\('
    r"|'(?:\w+\.)*(?P<text>\w+)'"
)
_PARTS = re.compile(r"(?P<remark>--[^\n]*)|(?P<end>;)|'(?:[^']|'')*'|[^';-]+|-")


class _Statement(NamedTuple):
    name: str
    sql: str
    words: frozenset[str]  # of a comment on a table none: it stands on the table alone
    is_comment: bool
    is_macro: bool


class _Waiting(NamedTuple):
    order: int
    sql: str | Callable[[], str]
    words: frozenset[str]
    is_macro: bool


@lru_cache(maxsize=256)
def words_of(sql: str) -> frozenset[str]:
    """Words of a statement, among them all that it may name.

    >>> sorted(words_of('select count(*) from "Runs"'))
    ['count', 'from', 'runs', 'select']
    """
    return frozenset(re.findall(r"\w+", sql.lower()))


def named_by(sql: str) -> frozenset[str]:
    """Words of one of the project's own statements that stand where tables or macros do; columns are left out.

    A whole text counts as well: it may be the name of a table that a macro reads.

    >>> sorted(named_by("select sum(samples) as samples from f('internal.steps') join units using (run)"))
    ['f', 'steps', 'sum', 'units', 'using']
    """
    return frozenset(found["table"] or found["macro"] or found["text"] for found in _NAMES.finditer(sql.lower()))


@cache
def _statements(script: str) -> tuple[_Statement, ...]:
    """Statements of a script, without its remarks."""
    texts = [""]
    for part in _PARTS.finditer(script):
        if part["end"] is not None:
            texts.append("")
        elif part["remark"] is None:
            texts[-1] += part[0]
    found = []
    for each in texts:
        text = each.strip().lower()
        if (created := _CREATES.match(text)) is not None:
            found.append(_Statement(created[2], each, named_by(each), is_comment=False, is_macro=created[1] == "macro"))
        elif (of := _COMMENTS.match(text)) is not None:
            found.append(_Statement(of[1], each, frozenset(), is_comment=True, is_macro=False))
        elif text:
            raise ValueError(f"a script only defines views, macros and tables, or comments on them: {text[:80]}")
    return tuple(found)


def bound_where_used(sql: str) -> str:
    """The definition of a view that DuckDB does not bind yet; another one as it is.

    >>> bound_where_used("create or replace view internal.a as select 1")
    'create or replace view internal.a with (defer_binding) as select 1'
    """
    return _VIEW.sub(r"\g<0> with (defer_binding)", sql, count=1) if _VIEW.match(sql) else sql


def defined_names(scripts: Iterable[str]) -> list[str]:
    """Names of the views, macros and tables that scripts define."""
    return [each.name for script in scripts for each in _statements(script) if not each.is_comment]


class DeferredDefinitions:
    """Definitions that wait for a statement that names them.

    Parameters
    ----------
    run : Callable[[str], None]
        Runs a statement.

    Examples
    --------
    >>> ran = []
    >>> deferred = DeferredDefinitions(ran.append)
    >>> deferred.add("create or replace view a as select '--;'; create or replace view b as from a;")
    >>> deferred.define({"b"})
    >>> [each.strip() for each in ran]
    ["create or replace view a as select '--;'", 'create or replace view b as from a']
    """

    def __init__(self, run: Callable[[str], None]) -> None:
        self._run = run
        self._waiting: dict[str, _Waiting] = {}
        self._next = count()

    def add(self, script: str) -> None:
        """Add the definitions of a script; what a view or table stands on is added before it."""
        for each in _statements(script):
            before = self._waiting.pop(each.name, None)
            if each.is_comment and before is not None and isinstance(before.sql, str):
                self._waiting[each.name] = before._replace(sql=f"{before.sql};\n{each.sql}")
            else:
                self._waiting[each.name] = _Waiting(next(self._next), each.sql, each.words, each.is_macro)

    def add_macro(self, name: str, words: Collection[str], make: Callable[[], str]) -> None:
        """Add a macro whose definition is made when it is first named, of what it stands on."""
        self._waiting[name] = _Waiting(next(self._next), make, frozenset(words), is_macro=True)

    def define(self, words: Iterable[str]) -> None:
        """Run the definitions of what is named, and before each those that it stands on."""
        for name in self._named(words):
            if (found := self._waiting.pop(name, None)) is None:  # another of them stands on it
                continue
            try:
                self.define(word for word in found.words if self._order(word) < found.order)
                self._run(found.sql if isinstance(found.sql, str) else found.sql())
                if found.is_macro:  # bound where it is used: it may stand on what was added later
                    self.define(found.words)
            except BaseException:
                self._waiting[name] = found
                raise

    def define_all(self) -> None:
        """Run all that wait."""
        self.define(list(self._waiting))

    def discard(self, name: str) -> None:
        """Drop the definition of what is defined otherwise."""
        self._waiting.pop(name, None)

    def _named(self, words: Iterable[str]) -> Collection[str]:
        return sorted(self._waiting.keys() & set(words), key=self._order)

    def _order(self, name: str) -> int:
        return self._waiting[name].order if name in self._waiting else -1
