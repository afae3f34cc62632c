"""What is at work and alerts, over the API and on the page."""

import httpx
import pytest

from analytics.alerts.book import AlertBook
from analytics.alerts.conditions.verdict import VerdictCondition
from analytics.alerts.finding import Finding
from analytics.alerts.kept_alerts import raised_alerts
from analytics.alerts.rules import Rule
from analytics.loop.bilingual import Bilingual
from analytics.serve.pages.frame.language import Texts
from storage.store import Store
from stream.status.role_status import Role
from tests.analytics.serve.conftest import Served


def raised(served: Served, key: str) -> str:
    """An alert in the book of the store, as `gyrofleet alert run` puts it there."""
    now_ns = 1_795_255_200 * 10**9
    rule = Rule(name="verdict", condition=VerdictCondition(), to=())
    finding = Finding(key, "FOG-0001", Bilingual("unit FOG-0001 has FAIL", "产品FOG-0001判定为FAIL"), is_event=True)
    with AlertBook(Store.open(served.store), now_ns) as book:
        book.see(rule, finding, now_ns, now_ns)
        book.save()
    return next(each.id for each in raised_alerts(Store.open(served.store)) if each.key == key)


def test_the_status_of_a_store_at_rest(api: httpx.Client) -> None:
    found = api.get("/api/status").json()
    assert found["troubles"] == []
    assert found["segments"] >= 1


def test_an_alert_is_seen_by_all_and_acknowledged_by_an_operator(served: Served, api: httpx.Client) -> None:
    alert = raised(served, "of the API")
    assert alert in {each["id"] for each in api.get("/api/alerts").json()["alerts"]}
    with served.program("viewer") as viewer:
        assert viewer.post(f"/api/alerts/{alert}/acknowledge", json={}).status_code == 403
    assert api.post("/api/alerts/nothing/acknowledge", json={}).status_code == 404
    with served.program("operator") as operator:
        done = operator.post(f"/api/alerts/{alert}/acknowledge", json={"note": "supply replaced"})
    assert done.status_code == 200, done.text
    assert done.json()["document"]["by"] == "operator-program"
    rows = api.post(
        "/api/sql", json={"sql": "select document->>'$.note' as note from events where kind = 'AlertAcknowledged'"}
    )
    assert {"note": "supply replaced"} in rows.json()["rows"]


def test_the_page_shows_alerts_in_both_languages(served: Served) -> None:
    raised(served, "of the page")
    with served.browser("vera") as viewer:
        english, chinese = (viewer.get(f"/work?lang={lang}").text for lang in ("en", "zh"))
    assert "unit FOG-0001 has FAIL" in english
    assert "产品FOG-0001判定为FAIL" in chinese
    assert "/act/acknowledge_alert" not in english  # a viewer may not


def test_the_floor_links_to_the_open_alerts_of_a_severity(served: Served, api: httpx.Client) -> None:
    raised(served, "of the floor")
    warnings = api.get("/api/alerts", params={"severity": "warning"}).json()["alerts"]
    assert warnings
    assert api.get("/api/alerts", params={"severity": "alarm"}).json()["alerts"] == []
    with served.browser("vera") as viewer:
        assert f'<a href="/work?severity=warning">warning {len(warnings)}</a>' in viewer.get("/?lang=en").text
        assert f'<a href="/work?severity=warning">警告 {len(warnings)}</a>' in viewer.get("/?lang=zh").text
        assert "unit FOG-0001 has FAIL" in viewer.get("/work?severity=warning&lang=en").text
        assert "unit FOG-0001 has FAIL" not in viewer.get("/work?severity=alarm&lang=en").text


@pytest.mark.parametrize("role", Role)
def test_every_role_has_a_name_on_the_page(role: Role) -> None:
    assert Texts("zh").word(role.value, "program") != role.value
