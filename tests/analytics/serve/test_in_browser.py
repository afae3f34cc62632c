"""The pages in a real browser: plots, keys, zoom, statements, theme and width, what a screen reader finds."""

import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import httpx
import numpy as np
import polars as pl
import pytest

from tests.analytics.serve.conftest import TOKEN, Served, start
from tests.analytics.serve.served_store import RATE_HZ, SPIKE_AT, START_NS, STEP_S, STEPS
from tests.browser import IS_THERE, Browser
from tests.forked_commands import CommandServer

pytestmark = pytest.mark.skipif(not IS_THERE, reason="chromium and chromedriver are not installed")
AXE = Path(__file__).parents[2] / "vendor" / "axe.min.js"
SIGNAL = "/signals/FOG-0001/run-1/rate"
PAGES = (
    "/", "/runs", "/runs/run-1", "/units", "/units/FOG-0001", SIGNAL, "/trends?metric=bias", "/verdicts", "/diagnosis",
    "/sql", "/events", "/work", "/store",
)  # fmt: skip
# pixels of the curve in the uppermost fifth of the plot
PIXELS = """(() => {
  const canvas = document.querySelector('#signal-plot canvas'), over = document.querySelector('#signal-plot .u-over');
  const ratio = devicePixelRatio, box = canvas.getBoundingClientRect(), inner = over.getBoundingClientRect();
  const x = (inner.left - box.left) * ratio, y = (inner.top - box.top) * ratio;
  const seen = canvas.getContext('2d').getImageData(x, y, inner.width * ratio, inner.height * ratio / 5).data;
  let count = 0;
  for (let i = 0; i < seen.length; i += 4) count += seen[i + 3] > 128 && seen[i + 2] > seen[i] + 60;
  return count;
})()"""
# the status of the answer that is shown; 202 is a page that says that this one is being computed
NAVIGATED = "performance.getEntriesByType('navigation')[0]?.responseStatus"
# what sticks out of the window, beside what scrolls by itself
BEYOND = """(() => {
  const width = document.documentElement.clientWidth, all = [...document.querySelectorAll('body *')];
  const out = all.filter(each => !each.closest('.wide') && each.getBoundingClientRect().right > width + 1);
  return out.map(each => each.outerHTML.slice(0, 200));
})()"""


@pytest.fixture(scope="module")
def window(served: Served) -> Iterator[Browser]:
    with Browser() as browser:
        browser.open(f"{served.url}/login?token={TOKEN}")
        yield browser


def until(look: Callable[[], Any], timeout_s: float = 30.0) -> Any:
    deadline = time.monotonic() + timeout_s
    while not (found := look()):
        assert time.monotonic() < deadline
        time.sleep(0.1)
    return found


def press(window: Browser, key: str) -> None:
    event = f"new KeyboardEvent('keydown', {{key: {json.dumps(key)}, bubbles: true, cancelable: true}})"
    window.ask(f"document.querySelector('#signal-plot .plot').dispatchEvent({event})")


def reading(window: Browser, section: str = "#signal-plot") -> str:
    return str(window.ask(f"document.querySelector('{section} .reading').textContent"))


def status(window: Browser) -> str:
    return str(window.ask("document.querySelector('#signal-plot [role=status]:not(.reading)').textContent"))


def plotted(window: Browser, url: str, section: str = "#signal-plot") -> None:
    window.open(url)
    until(lambda: window.ask(f"!!document.querySelector('{section} canvas')"))


@pytest.mark.long
@pytest.mark.parametrize("width_s", [600.0, 60.0, 2.0, 0.1])
def test_a_spike_of_one_sample_is_seen_at_every_zoom(window: Browser, served: Served, width_s: float) -> None:
    at_ns = START_NS + SPIKE_AT * 10**9 // RATE_HZ
    half_ns = round(width_s * 0.5e9)
    plotted(window, f"{served.url}{SIGNAL}?from={at_ns - half_ns}&to={at_ns + half_ns}")
    assert "50 deg/s" in until(lambda: status(window))
    assert window.ask(PIXELS) > 0
    assert window.complaints() == []


@pytest.mark.long
def test_keys_read_values_zoom_and_go_back(window: Browser, served: Served) -> None:
    plotted(window, served.url + SIGNAL)
    label = window.ask("document.querySelector('#signal-plot .plot').getAttribute('aria-label')")
    assert "rate in deg/s" in label
    press(window, "Home")
    press(window, "ArrowRight")
    assert "mean" in until(lambda: reading(window))
    press(window, "+")
    until(lambda: "from=" in window.ask("location.search"))
    shown = until(lambda: status(window))
    assert (
        len(window.ask("[...document.querySelectorAll('#signal-buckets tbody tr')].map(row => row.cells.length)")) > 10
    )
    press(window, "0")
    until(lambda: status(window) != shown)
    box = "document.querySelector('#beside input[value=temperature]')"
    if not window.ask(f"{box}.checked"):
        window.ask(f"{box}.click()")
    until(lambda: window.ask("document.querySelectorAll('#signal-plot .panels canvas').length") == 1)
    until(lambda: "temperature / degC" in window.ask("document.querySelector('#signal-buckets thead').textContent"))
    window.ask(f"{box}.click()")
    until(lambda: window.ask("document.querySelectorAll('#signal-plot .panels canvas').length") == 0)
    assert "beside=none" in window.ask("location.search")
    assert window.complaints() == []


def test_what_the_page_says_follows_a_zoom_and_back_leads_to_where_one_was(window: Browser, served: Served) -> None:
    def said() -> tuple[str, str]:
        first = window.ask("document.querySelector('#signal-form [name=from]').value")
        return str(first), str(window.ask("document.getElementById('signal-facts').textContent"))

    plotted(window, served.url + SIGNAL)
    whole = said()
    assert whole[0] == ""
    press(window, "+")
    press(window, "+")
    until(lambda: said()[0] != "")
    assert said()[1] != whole[1]
    assert "from=" in window.ask("location.search")
    window.ask("history.back()")
    until(lambda: window.ask("location.search") == "" and window.ask("document.readyState") == "complete")
    until(lambda: window.ask("!!document.querySelector('#signal-plot canvas')"))
    assert said() == whole
    assert window.complaints() == []


def test_a_statement_is_answered_without_leaving_the_page(window: Browser, served: Served) -> None:
    window.open(f"{served.url}/sql?sql=select+1")
    until(lambda: window.ask("!!document.querySelector('#sql-form select')"))
    sql = "select t_ns, mean from rollup_10s where unit = 'FOG-0001' and run = 'run-1' and signal = 'rate'"
    window.ask(f"document.querySelector('#sql').value = {json.dumps(sql)}")
    window.ask("document.querySelector('#sql-form').requestSubmit()")
    until(lambda: window.ask("document.querySelectorAll('#sql-result .wide tbody tr').length") == STEPS * STEP_S // 10)
    assert window.ask("!!document.querySelector('#sql-result canvas')")
    assert "rollup_10s" in window.ask("location.search")
    window.ask("document.querySelector('#sql').value = 'drop table samples'")
    window.ask("document.querySelector('#sql-form').requestSubmit()")
    assert "only" in until(lambda: window.ask("document.querySelector('#sql-result [role=alert]')?.textContent"))
    first = window.ask("document.querySelector('#sql-form select').options[1].value")
    assert first == "drop table samples"
    assert all("400" in each for each in window.complaints())


@pytest.mark.long
def test_allan_deviation_and_trend_are_drawn_and_read(window: Browser, served: Served) -> None:
    plotted(window, served.url + SIGNAL, "#allan-plot")
    plot = "document.querySelector('#allan-plot .plot')"
    window.ask(f"{plot}.dispatchEvent(new KeyboardEvent('keydown', {{key: 'Home'}}))")
    assert " s: " in until(lambda: reading(window, "#allan-plot"))
    window.open(f"{served.url}/trends?metric=bias")
    until(lambda: window.ask("document.querySelectorAll('[data-figure] canvas').length") >= 2)
    assert window.complaints() == []


@pytest.mark.long
def test_the_pictures_of_a_unit_are_drawn_read_and_lead_on(window: Browser, served: Served) -> None:
    window.open(f"{served.url}/units/FOG-0001")
    drawn = "document.querySelectorAll('[data-figure] canvas').length"
    until(
        lambda: window.ask(drawn) >= 3 and window.ask(f"{drawn} === document.querySelectorAll('[data-figure]').length")
    )
    plot = "document.querySelector('[aria-labelledby=history-1] .plot')"
    window.ask(f"{plot}.dispatchEvent(new KeyboardEvent('keydown', {{key: 'Home', bubbles: true}}))")
    told = until(lambda: reading(window, "[aria-labelledby=history-1]"))
    assert "deg/h" in told
    assert "run-1" in told
    window.ask(f"{plot}.dispatchEvent(new KeyboardEvent('keydown', {{key: 'Enter', bubbles: true}}))")
    until(lambda: window.ask("location.pathname") == "/runs/run-1")
    assert window.complaints() == []


@pytest.mark.long
def test_forms_of_the_pages_are_taken_from_a_browser(window: Browser, served: Served) -> None:
    window.open(f"{served.url}/store")
    until(lambda: window.ask("!!document.querySelector('form[action=\"/act/verify_store\"]')"))
    window.ask("document.querySelector('form[action=\"/act/verify_store\"]').requestSubmit()")
    until(lambda: window.ask("document.querySelectorAll('#job-table tbody tr').length") >= 1)
    assert window.ask("location.pathname") == "/store"
    assert window.complaints() == []


def test_a_result_is_a_file_and_columns_are_chosen(window: Browser, served: Served) -> None:
    sql = "select unit, samples, sample_interval_s from signals"
    window.open(f"{served.url}/sql?{urlencode({'sql': sql, 'up': 'sample_interval_s'})}")
    until(lambda: window.ask("!!document.querySelector('#sql-form select')"))
    window.ask("document.querySelector('#sql-form').requestSubmit()")
    until(lambda: window.ask("!!document.querySelector('#sql-result canvas')"))
    chosen = window.ask("[...document.querySelectorAll('#sql-result select')].map(each => each.value)")
    assert chosen[:2] == ["samples", "sample_interval_s"]
    until(lambda: window.ask("!document.querySelector('#sql-form a').hidden"))
    window.ask("document.querySelector('button.name').click()")
    assert window.ask("document.querySelector('#sql').value.length") > len(sql)
    assert window.complaints() == []


@pytest.mark.long
def test_paper_is_light(window: Browser, served: Served) -> None:
    window.emulate("dark")
    window.open(f"{served.url}/units/FOG-0001")
    until(lambda: window.ask("document.querySelectorAll('[data-figure] canvas').length") >= 3)
    window.command("Emulation.setEmulatedMedia", media="print")
    assert window.ask("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    window.command("Emulation.setEmulatedMedia", media="")
    window.emulate("light")


@pytest.mark.in_gate("/units/FOG-0001-dark-zh", f"{SIGNAL}-light-en")
@pytest.mark.parametrize("lang", ["en", "zh"])
@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("page", PAGES)
def test_axe_finds_nothing(window: Browser, served: Served, page: str, theme: str, lang: str) -> None:
    window.emulate(theme)
    window.open(f"{served.url}{page}{'&' if '?' in page else '?'}lang={lang}")
    # until characteristics are computed another page stands there
    until(lambda: window.ask(f"{NAVIGATED} === 200"), 120.0)
    time.sleep(0.5)  # scripts draw
    window.ask(f"(() => {{ {AXE.read_text()}; return 1 }})()")
    window.ask("axe.run(document).then(found => { window.found = found; }) && 1")
    until(lambda: window.ask("!!window.found"))
    assert window.ask("window.found.violations.map(each => [each.id, each.nodes.map(node => node.html)])") == []
    assert window.ask("window.found.passes.length") > 10
    assert window.complaints() == []


@pytest.mark.parametrize("width", [1280, 390])
@pytest.mark.parametrize("page", PAGES)
@pytest.mark.long
def test_no_page_is_wider_than_the_window(window: Browser, served: Served, page: str, width: int) -> None:
    window.open(served.url + page, width=width)
    time.sleep(0.5)
    assert window.ask(BEYOND) == []


def test_a_name_of_128_letters_breaks(window: Browser, served: Served) -> None:
    window.open(f"{served.url}/units/FOG-0001", width=390)
    window.ask("document.querySelector('h1').textContent = 'N'.repeat(128)")
    assert window.ask(BEYOND) == []


def test_the_page_of_a_run_says_that_the_session_has_ended(window: Browser, served: Served) -> None:
    window.open(f"{served.url}/runs/run-1")
    until(lambda: window.ask("!!document.querySelector('#run-course').dataset.drawn"))
    window.command("Network.clearBrowserCookies")
    window.ask("document.querySelector('#run-course').dispatchEvent(new Event('refresh'))")
    until(lambda: "signed out" in window.ask("document.querySelector('#course-trouble').textContent"))
    window.open(f"{served.url}/login?token={TOKEN}")
    window.complaints()  # of the answer 401


def test_rows_with_parameters_are_no_columns_of_words_on_a_small_screen(window: Browser, served: Served) -> None:
    window.open(served.url + "/units/FOG-0001", width=390)
    rows = "[...document.querySelectorAll('#unit-metrics tbody tr')].map(each => each.offsetHeight)"
    assert max(until(lambda: window.ask(rows), 120.0)) < 150


def test_points_at_one_temperature_have_plain_numbers_below_them(window: Browser, served: Served) -> None:
    """Equal places are set apart in their last digits: the axis had 25.00000000002."""
    window.open(served.url + SIGNAL)
    name = {"en": "", "zh": ""}
    curve = {"name": name, "x": [25.0, 25.0, 25.0], "y": [1.0, 2.0, 3.0], "style": "points"}
    axis = {"label": name, "unit": "degC", "scale": "linear"}
    picture = json.dumps({"title": name, "x": axis, "y": axis, "curves": [curve]})
    window.ask(f"""(() => {{
      const pen = CanvasRenderingContext2D.prototype, write = pen.fillText;
      window.written = [];
      pen.fillText = function (text, ...at) {{ window.written.push(text); return write.call(this, text, ...at); }};
      import("/static/figure.js").then(module => module.draw(document.querySelector("main"), {picture}));
    }})()""")
    until(lambda: "3.0" in window.ask("window.written"))
    numbers = [float(each) for each in window.ask("window.written") if each.replace(".", "").isdigit()]
    assert 25.0 in numbers or {24.0, 26.0} <= set(numbers)
    assert all(len(each) <= 4 for each in window.ask("window.written") if each.startswith(("24", "25", "26")))


def test_what_a_first_visit_loads_is_small(window: Browser, served: Served) -> None:
    plotted(window, served.url + SIGNAL)
    loaded = window.ask(
        "performance.getEntriesByType('resource').concat(performance.getEntriesByType('navigation'))"
        ".reduce((sum, each) => sum + each.encodedBodySize, 0)"
    )
    assert 20_000 < loaded < 300_000


@pytest.mark.long
def test_the_curve_of_a_long_record_comes_after_its_page(
    window: Browser, tmp_path: Path, command_server: CommandServer, run_command: Callable[..., Any]
) -> None:
    samples = 1_100_000
    noise = np.random.default_rng(1).normal(0.0, 2.0, samples)
    pl.DataFrame({"time[s]": np.arange(samples) / 1000, "temperature[degC]": noise}).write_csv(tmp_path / "long.csv")
    done = run_command("import", "long.csv", "--unit", "G-1", "--run", "r", "--store", "S", cwd=tmp_path)
    assert done.code == 0, done.err
    process, ready = start(command_server, "--store", "S", "--port", 0, "--token", TOKEN, cwd=tmp_path)
    try:
        url = f"{ready['url']}/signals/G-1/r/temperature"
        page = httpx.get(url, headers={"Authorization": f"Bearer {TOKEN}", "Accept": "text/html"}).text
        assert "Computed from all samples, which takes a while" in page
        window.open(f"{ready['url']}/login?token={TOKEN}")
        window.open(f"{url}?lang=en")
        until(lambda: window.ask("!!document.querySelector('#allan-plot canvas')"))
        first = window.ask("[...document.querySelector('#allan tbody').rows[0].cells].map(each => each.textContent)")
        # white noise: the deviation at one sample is that of the samples
        assert float(first[0]) == 0.001
        assert float(first[1]) == pytest.approx(2.0, rel=0.01)
        assert window.ask("document.querySelector('#allan-plot > [role=status]').textContent") == (
            "Computed from all samples."
        )
        assert window.complaints() == []
    finally:
        process.terminate()
        _, err = process.communicate(timeout=30)
    assert process.returncode == 0, err
