"""Templates: every text escaped, numbers and moments in one manner."""

import json
import math
import secrets
from functools import cache
from typing import Any
from urllib.parse import quote

import jinja2
from markupsafe import Markup, escape
from starlette.requests import Request
from starlette.responses import HTMLResponse

from analytics.evaluation.selection import with_year
from analytics.serve.api.operation import link
from analytics.serve.api.rows import iso
from analytics.serve.doors.gate import PERSON
from analytics.serve.doors.roles import Person, Role
from analytics.serve.pages.frame.language import COOKIE, LANGUAGES, Texts, language_of
from analytics.serve.pages.frame.zones import DEFAULT, local, typed
from stream.events import Verdict

_YEAR_S = 365 * 86_400
_MOST_DIGITS = 9
_REMARK = "remark"
# where a page has the name and the secret of its reader; nobody else can write them
_NAME, _SECRET = f"NAME-{secrets.token_hex(16)}", f"SECRET-{secrets.token_hex(16)}"


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("analytics.serve.pages"), autoescape=True, undefined=jinja2.StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.globals |= {
        "link": link,
        "Role": Role,
        "verdicts": _verdicts,
        "runs_of": _runs,
        "kinds_of": _kinds,
        "namesakes": _namesakes,
        "spread": spread,
        "parameters": _parameters,
        "remark_of": _remark_of,
    }
    environment.filters |= {
        "number": number,
        "moment": moment,
        "duration": duration,
        "segment": _segment,
        "bytes": size,
        "typed": typed,
        "with_year": with_year,
    }
    return environment


def compiled(template: str) -> jinja2.Template:
    """A template, compiled once."""
    return _environment().get_template(template)


def templates() -> list[str]:
    """Names of all templates."""
    return _environment().list_templates(extensions=["jinja"])


def page(request: Request, template: str, context: dict[str, Any], status: int = 200) -> HTMLResponse:
    """A page in the language of the request."""
    return page_of(request, rendered(request, template, context), status)


def page_of(request: Request, body: bytes, status: int = 200) -> HTMLResponse:
    """A rendered page, with the name and the secret of who asks."""
    person: Person | None = request.scope.get(PERSON)
    if person is not None:
        for mark, text in ((_NAME, person.name), (_SECRET, person.csrf or "")):
            body = body.replace(mark.encode(), str(escape(text)).encode())
    answer = HTMLResponse(body, status)
    language = language_of(request)
    answer.headers["Content-Language"] = language
    answer.headers["Vary"] = "Accept-Language, Cookie"
    if request.query_params.get("lang") in LANGUAGES:
        answer.set_cookie(COOKIE, language, max_age=_YEAR_S, samesite="strict", path="/")
    return answer


def rendered(request: Request, template: str, context: dict[str, Any]) -> bytes:
    """A page in the language of the request, for everybody of a role: `page_of` puts name and secret in."""
    texts = Texts(language_of(request))
    person: Person | None = request.scope.get(PERSON)
    common = {
        "t": texts,
        "lang": texts.language,
        "other": next(each for each in LANGUAGES if each != texts.language),
        "other_url": str(request.url.include_query_params(lang="zh" if texts.language == "en" else "en").query),
        "path": request.url.path,
        "person": None if person is None else Person(_NAME, person.role, None if person.csrf is None else _SECRET),
        "zone": DEFAULT,
    }
    return compiled(template).render(common | context).encode()


def number(value: object, uncertainty: float | None = None) -> str:
    """A number for people: to two digits of its uncertainty, else six digits; other values as their text.

    >>> number(12.3456789, 0.0123), number(1.2345e-7, 2e-9), number(1234567), number(None), number(True)
    ('12.346', '1.235e-07', '1,234,567', '', 'yes')
    """
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if not isinstance(value, float):
        return str(value)
    if not math.isfinite(value):
        return str(value)
    if uncertainty is None or not 0 < uncertainty < math.inf or value == 0:
        return f"{value:.6g}"
    last = math.floor(math.log10(uncertainty)) - 1  # the decimal place of the uncertainty's second digit
    if 1e-4 <= abs(value) < 1e7:
        return f"{value:.{min(max(-last, 0), _MOST_DIGITS)}f}"
    return f"{value:.{min(max(math.floor(math.log10(abs(value))) - last, 1), _MOST_DIGITS)}e}"


def spread(lo: float | None, hi: float | None) -> float | None:
    """The standard uncertainty that a 95 % interval stands for, near enough to round by.

    >>> spread(1.0, 1.5), spread(1.0, None)
    (0.125, None)
    """
    return None if lo is None or hi is None else (hi - lo) / 4


@jinja2.pass_context
def _parameters(context: jinja2.runtime.Context, row: dict[str, Any]) -> str:
    """What tells values of one characteristic apart, as commands show it."""
    from analytics.evaluation.table import format_parameters

    shown = {name: each for name, each in _parameters_of(row).items() if name != _REMARK}
    return format_parameters(shown, str(context["lang"]))


def _remark_of(row: dict[str, Any]) -> str:
    """What a value's remark says of the record that it rests on."""
    return str(_parameters_of(row).get(_REMARK) or "")


def _parameters_of(row: dict[str, Any]) -> dict[str, Any]:
    found = row["parameters"] or {}
    given: dict[str, Any] = json.loads(found) if isinstance(found, str) else found
    return given


_TO_SECONDS = len("2026-11-21 18:00:00")
_JOINED, _TIME, _SHOWN = Markup(""), Markup('<time datetime="'), Markup('">')
_ZONE, _END = Markup(' <span class="zone">'), Markup("</span></time>")


@jinja2.pass_context
def moment(
    context: jinja2.runtime.Context, t_ns: int | None, zone: str | None = None, *, exact: bool = False
) -> Markup:
    """A moment in a time zone, by default that of the page, as an element that has it in UTC for programs.

    To the second, or `exact`: with all its digits.
    """
    if t_ns is None:
        return Markup("")
    text, named = local(t_ns, zone or str(context["zone"]))
    if exact and (rest := t_ns % 10**9):
        text = f"{text[:_TO_SECONDS]}.{rest:09d}".rstrip("0") + text[_TO_SECONDS:]
    # joined: `Markup.format` takes far longer, and a page has hundreds of moments
    return _JOINED.join((_TIME, str(iso(t_ns)), _SHOWN, text, _ZONE, named, _END))


def duration(seconds: float | None) -> str:
    """A duration for people.

    >>> duration(59.0), duration(7_500.0), duration(200_000.0), duration(None)
    ('59 s', '2 h 05 min', '2 d 7 h', '')
    """
    if seconds is None:
        return ""
    whole = round(seconds)
    if whole < 60:
        return f"{seconds:.3g} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    if whole < 86_400:
        return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
    return f"{whole // 86_400} d {whole % 86_400 // 3600} h"


def size(n: int) -> str:
    """A number of bytes for people.

    >>> size(999), size(19_516_700), size(83_086_300_000)
    ('999 B', '19.5 MB', '83.1 GB')
    """
    for factor, unit in ((10**12, "TB"), (10**9, "GB"), (10**6, "MB"), (10**3, "kB")):
        if n >= factor:
            return f"{n / factor:.3g} {unit}"
    return f"{n} B"


def _verdicts(texts: Texts) -> list[tuple[str, str]]:
    """Verdicts as options of a form."""
    return [(each.value, texts.word(each.value, "verdict")) for each in Verdict]


def _runs(runs: list[dict[str, Any]]) -> list[tuple[str, str]]:
    """Runs as options of a form."""
    return [(run["run"], f"{run['station']}: {run['run']}") for run in runs]


def _kinds(kinds: dict[str, int], texts: Texts) -> list[tuple[str, str]]:
    """Kinds of documents as options of a form."""
    return [(kind, f"{texts.word(kind, 'kind')} ({n:,})") for kind, n in kinds.items()]


def _namesakes(names: list[str]) -> list[tuple[str, str]]:
    """Names as options of a form."""
    return [(name, name) for name in names]


def _segment(text: str) -> str:
    """A name as one segment of a path."""
    return quote(text, safe="")
