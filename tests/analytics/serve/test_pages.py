"""Pages: whole in both languages, without scripts in them, and every link of a page leads somewhere."""

import re
from html import unescape
from html.parser import HTMLParser
from typing import get_args

import httpx
import pytest

from analytics.evaluation.reasons import in_chinese
from analytics.evaluation.table import format_number
from analytics.plots.picture import Axis, Label
from analytics.serve.pages.frame.language import LANGUAGES, Texts
from analytics.serve.pages.frame.render import compiled
from stream.events import AnyDocument
from tests.analytics.serve.conftest import Served
from tests.analytics.serve.served_store import START_NS

PAGES = (
    "/", "/runs", "/runs/run-1", "/units", "/units/FOG-0001", "/signals/FOG-0001/run-1/rate", "/trends",
    "/trends?metric=bias&by=unit", "/verdicts?verdict=PASS", "/diagnosis", "/diagnosis/FOG-0001",
    "/sql", "/sql?sql=select%201", "/events?kind=RunStarted", "/store",
    "/proposals?which=all",
)  # fmt: skip
HEADINGS = {
    "/": ("Floor", "车间"),
    "/runs": ("Runs", "试验"),
    "/units": ("Units", "产品"),
    "/trends": ("Trends", "趋势"),
}


class Found(HTMLParser):
    """Links, tags and attributes of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.tags: list[str] = []
        self.attributes: list[str] = []
        self.labels: dict[str, bool] = {}
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += [name for name, _ in attrs]
        given = dict(attrs)
        if tag == "a" and given.get("href"):
            self.links.append(given["href"] or "")


@pytest.mark.parametrize("path", PAGES)
@pytest.mark.in_gate(
    "/diagnosis/FOG-0001",
    "/events?kind=RunStarted",
    "/proposals?which=all",
    "/store",
    "/trends",
    "/trends?metric=bias&by=unit",
    "/units/FOG-0001",
    "/verdicts?verdict=PASS",
)
def test_a_page_is_whole_in_both_languages(api: httpx.Client, path: str) -> None:
    for language, code in (("en", "en"), ("zh", "zh-CN")):
        answer = api.get(path, headers={"Accept-Language": f"fr, {code};q=0.9", "Accept": "text/html"})
        assert answer.status_code == 200, answer.text
        assert answer.headers["content-language"] == language
        assert f'<html lang="{code}">' in answer.text
        for heading in HEADINGS.get(path, ("", ""))[language == "zh" :][:1]:
            assert f"<h1>{heading}" in answer.text
        found = Found(answer.text)
        # the policy allows neither, and scripts are modules in static/
        assert not [each for each in found.attributes if each == "style" or each.startswith("on")]
        assert "style" not in found.tags
        assert not re.search(r"<script(?![^>]*src=\"/static/)", answer.text)
        assert found.tags.count("h1") == 1
        assert "{{" not in answer.text.replace("{{7-7}}", "")


@pytest.mark.long
@pytest.mark.parametrize("each", [3, pytest.param(1000, marks=pytest.mark.long)])
def test_every_link_of_the_pages_leads_somewhere(api: httpx.Client, each: int) -> None:
    seen: set[str] = set()
    for path in PAGES:
        links = Found(api.get(path, headers={"Accept": "text/html"}).text).links
        fresh = [link for link in dict.fromkeys(links) if not link.startswith(("#", "?")) and link not in seen]
        for link in fresh[:each]:
            seen.add(link)
            answer = api.get(link, headers={"Accept": "text/html"})
            assert answer.status_code == 200, (path, link, answer.text)
    assert len(seen) > 20


def test_the_language_is_asked_for_and_remembered(served: Served) -> None:
    with served.browser("vera") as browser:
        assert '<html lang="zh-CN">' in browser.get("/units?lang=zh").text
        assert '<html lang="zh-CN">' in browser.get("/units").text
        assert '<html lang="en">' in browser.get("/units?lang=en").text


@pytest.mark.long
def test_figures_on_a_page_are_those_of_the_api(api: httpx.Client) -> None:
    text = unescape(api.get("/units/FOG-0001").text)
    found = api.get("/api/units/FOG-0001").json()
    for row in found["verdicts"]:
        assert row["metric"] in text
        assert f"{row['upper']:.6g}" in text
        if row["value"] is not None:  # as the command shows it: to two digits of its uncertainty
            u = None if row["hi"] is None or row["lo"] is None else (row["hi"] - row["lo"]) / 4
            assert f">{format_number(row['value'], u)}<" in text
    assert "Bias" in text
    rows = api.get("/api/signals/FOG-0001/run-1/rate", params={"points": 100}).json()
    assert f"{max(rows['max']):.6g}" in api.get("/signals/FOG-0001/run-1/rate").text


def test_values_of_a_characteristic_are_told_apart_and_reasons_are_translated(served: Served) -> None:
    with served.program() as own:  # which remembers the language
        rows = own.get("/api/units/FOG-0001").json()["metrics"]
        english, chinese = (unescape(own.get(f"/units/FOG-0001?lang={language}").text) for language in ("en", "zh"))
    for text in (english, chinese):
        assert "earth_rate = none" in text
        assert "earth_rate = removed" in text
    reasons = {row["reason"] for row in rows if row["reason"]}
    assert reasons
    for reason in reasons:
        assert reason in english
        assert reason not in chinese
        assert in_chinese(reason) in chinese


def test_times_are_typed_in_the_zone_of_the_page(api: httpx.Client) -> None:
    path, typed = "/signals/FOG-0001/run-1/rate", {"from": "2026-11-21 10:02:00", "to": "2026-11-21T10:03:00.5"}
    text = api.get(path, params=typed).text
    assert 'value="2026-11-21 10:02:00"' in text
    assert 'value="2026-11-21 10:03:00.500000"' in text
    seconds = int(START_NS // 10**9) + 120
    assert f'data-from="{seconds}000000000" data-to="{seconds + 60}500000000"' in text
    close = api.get(path, params={"from": "2026-11-21 10:02:00", "to": "2026-11-21 10:02:00.5"}).text
    assert ">2026-11-21 10:02:00.1 <" in close  # samples that are closer than a second differ in the table
    assert "they reach from <time" in api.get(path).text
    assert "&lt;time" not in text + api.get(path).text
    shown = {"from": "2026-11-21 10:02:00 UTC", "to": " "}  # as the page shows moments
    assert f'data-from="{seconds}000000000"' in api.get(path, params=shown).text
    assert "cannot be shown" not in api.get(path, params=shown).text
    assert api.get(f"/api{path}", params=typed).status_code == 400  # programs state their zone
    assert api.get("/events", params=typed).status_code == 200


@pytest.mark.parametrize(
    ("typed", "why"),
    [
        ({"from": "noon"}, "from 'noon'"),
        ({"from": "2026-11-21 10:03", "to": "2026-11-21 10:02"}, "ends (2026-11-21T10:02:00+00:00) before it begins"),
    ],
)
def test_a_stretch_that_cannot_be_shown_keeps_the_form_and_what_was_typed(
    api: httpx.Client, typed: dict[str, str], why: str
) -> None:
    answer = api.get("/signals/FOG-0001/run-1/rate", params=typed)
    text = unescape(answer.text)
    assert answer.status_code == 200
    assert "This stretch cannot be shown" in text
    assert why in text
    assert 'data-asked="all"' in text
    assert f'data-from="{START_NS}"' in text
    for value in typed.values():
        assert f'value="{value}"' in text


def test_events_between_times_that_are_none_are_all_of_them(api: httpx.Client) -> None:
    answer = api.get("/events", params={"from": "noon", "kind": "RunStarted"})
    text = unescape(answer.text)
    assert answer.status_code == 200
    assert "These times are left out: from 'noon'" in text
    assert 'value="noon"' in text
    assert "run-1" in text


def test_the_page_of_trends_says_in_which_zone_its_times_are(api: httpx.Client) -> None:
    text = api.get("/trends?metric=bias", headers={"Accept": "text/html"}).text
    assert "Dates and times in sentences and charts are in UTC; tables name their zone." in text
    charts = text.partition('id="charts-title"')[2].partition("</section>")[0]
    assert re.search(r'<tr><td><time datetime="[^"]+Z">[-0-9 :]+ <span class="zone">[^<]+</span></time></td>', charts)


def test_the_table_of_a_picture_names_the_zone_of_its_times() -> None:
    axis = Axis(label=Label("time (UTC)", "时间（UTC）"), scale="time")
    parts = compiled("frame/parts.html.jinja").make_module({"zone": "Asia/Shanghai"})
    name = vars(parts)["axis_name"]
    shown = [str(name(axis, Texts(language))).strip() for language in LANGUAGES]
    assert shown == ["time (Asia/Shanghai)", "时间（Asia/Shanghai）"]


def test_a_statement_is_answered_without_scripts(served: Served) -> None:
    with served.browser("vera") as browser:
        fields = {"sql": "select 6 * 7 as answer, '<b>' as text", "csrf": browser.csrf}
        text = browser.post("/sql", data=fields).text
        assert ">42<" in text
        assert "&lt;b&gt;" in text
        apart = browser.post("/sql", data=fields | {"sql": "select null as a, '' as b, 'nan'::double as c"}).text
        assert '<td class="soft">NULL</td><td></td><td>NaN</td>' in apart
        wrong = browser.post("/sql", data=fields | {"sql": "copy (select 1) to 'x'"}).text
        assert 'role="alert"' in wrong
        assert "COPY is refused" in wrong


@pytest.mark.parametrize(
    ("path", "status", "chinese"),
    [
        ("/units/FOG-9", 404, "数据库中没有产品"),
        ("/units?limit=x", 400, "参数不符合要求"),
        ("/nothing", 404, "/nothing 不存在"),
        ("/runs/nothing", 404, "数据库中没有试验"),
    ],
)
def test_a_problem_is_a_page_with_a_sentence(api: httpx.Client, path: str, status: int, chinese: str) -> None:
    answer = api.get(path, headers={"Accept": "text/html"})
    assert answer.status_code == status
    assert 'role="alert" lang="en"' in answer.text
    assert chinese in api.get(path, headers={"Accept": "text/html", "Accept-Language": "zh"}).text
    assert api.get(path).headers["content-type"] == "application/json"


@pytest.mark.parametrize(("form", "begin"), [("csv", b"answer"), ("parquet", b"PAR1"), ("json", b'{"columns"')])
def test_the_result_of_a_statement_is_a_file(served: Served, form: str, begin: bytes) -> None:
    with served.browser("vera") as browser:
        fields = {"sql": "select 42 as answer", "csrf": browser.csrf, "format": form}
        answer = browser.post("/sql", data=fields)
        assert answer.status_code == 200
        assert answer.headers["content-disposition"] == f'attachment; filename="result.{form}"'
        assert answer.content.startswith(begin)
        assert browser.post("/sql", data=fields | {"format": "exe"}).status_code == 400


def test_changes_are_offered_to_those_who_may(served: Served) -> None:
    with served.browser("vera") as viewer, served.browser("eva") as engineer:
        assert "/act/diagnose_unit" not in viewer.get("/diagnosis/FOG-0001").text
        assert "/act/diagnose_unit" in engineer.get("/diagnosis/FOG-0001").text
        assert "/act/verify_store" not in viewer.get("/store").text
        assert "/act/verify_store" in engineer.get("/store").text


def test_every_kind_of_document_has_a_name_in_both_languages() -> None:
    english, chinese = Texts("en"), Texts("zh")
    kinds = {each.__name__ for each in get_args(AnyDocument)} - {"EstimatePublished"}
    assert len(kinds) > 30
    for kind in kinds:
        assert english.word(kind, "kind") != kind
        assert re.search("[一-鿿]", chinese.word(kind, "kind")), kind
