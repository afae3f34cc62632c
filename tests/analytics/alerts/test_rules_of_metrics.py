"""Rules about metrics and verdicts, over a store that was imported from files."""

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analytics.alerts.conditions.control_chart import ControlChartCondition
from analytics.alerts.conditions.level_change import LevelChangeCondition
from analytics.alerts.finding import AlertView, Finding
from analytics.alerts.kept_alerts import raised_alerts
from analytics.alerts.metric_condition import MetricCondition
from analytics.alerts.rules import load_rules
from analytics.alerts.service import AlertService
from storage.store import Store
from stream.errors import NotFound

RULES = """
[targets.line]
kind = "webhook"
url = "http://127.0.0.1:1/"
[[rules]]
kind = "unit_verdict"
every_h = 1e-9
clear_after_s = 0
"""
LIMITS = """
name = "S"
revision = "A"
valid_from = 2026-01-01
[[limit]]
metric = "bias"
parameters = { earth_rate = "none" }
lower = -10.0
upper = 10.0
unit_of_measure = "deg/h"
"""
Run = Callable[..., Any]


def test_a_unit_that_fails_in_a_file_is_reported_until_its_run_is_excluded(run_command: Run, tmp_path: Path) -> None:
    (tmp_path / "rules.toml").write_text(RULES)
    (tmp_path / "limits.toml").write_text(LIMITS)
    rng = np.random.default_rng(8)
    for unit, bias in (("G1", 2.0), ("G2", 40.0)):
        rows = "".join(f"{at},{bias + 0.5 * rng.standard_normal():.4f}\n" for at in range(300))
        (tmp_path / f"{unit}.csv").write_text(f"time[s],rate[deg/h]\n{rows}")

    def done(*words: str) -> None:
        found = run_command(*words, "--store", "S", cwd=tmp_path)
        assert found.code == 0, found.err

    done("limits", "add", "limits.toml")
    reported: list[str] = []
    with AlertService(Store.open(tmp_path / "S"), tmp_path / "rules.toml", reported.append) as service:
        service.look()
        assert raised_alerts(Store.open(tmp_path / "S")) == []
        for unit in ("G1", "G2"):
            words = ("--run", f"of-{unit}", "--start", "2026-03-01T08:00:00Z", "--procedure", "static_bias")
            done("import", f"{unit}.csv", "--unit", unit, *words, "--position", "IRA_up")
        service.look()
        (alert,) = raised_alerts(Store.open(tmp_path / "S"))
        assert (alert.subject, alert.text) == ("G2", "unit G2 fails its specifications: Bias")
        assert alert.text_zh == "产品G2按规范判定为不合格：零偏"
        done("runs", "exclude", "of-G2", "--reason", "kicked")
        service.look()
        service.look()
        (alert,) = raised_alerts(Store.open(tmp_path / "S"))
        assert alert.cleared_ns is not None
    assert reported == [] or all("line" in each for each in reported)  # nobody listens at the target


@pytest.fixture(scope="module")
def two_positions(run_command: Run, tmp_path_factory: pytest.TempPathFactory) -> AlertView:
    """A record a day in each of two positions; the bias changes in the second one alone, which has fewer records."""
    folder = tmp_path_factory.mktemp("positions")
    rng = np.random.default_rng(20261201)
    for position, days in (("IRA_up", 40), ("IRA_down", 36)):
        lines = ["run,time,rate[deg/h]"]
        for day in range(days):
            start = datetime(2026, 1, 1, 8, tzinfo=UTC) + timedelta(days=day, hours=12 * (position == "IRA_down"))
            level = 0.5 + 0.05 * rng.standard_normal() + (0.4 if position == "IRA_down" and day >= 24 else 0.0)
            for at, noise in enumerate(rng.standard_normal(30)):
                moment = (start + timedelta(seconds=at)).isoformat()
                lines.append(f"{position}-{day:02},{moment},{level + 0.1 * noise:.5f}")
        (folder / f"{position}.csv").write_text("\n".join(lines))
        words = ("--unit", "G1", "--procedure", "static_bias", "--position", position, "--latitude", "30")
        done = run_command("import", f"{position}.csv", *words, "--store", "S", cwd=folder)
        assert done.code == 0, done.err
    nothing: Any = None
    return AlertView(
        now_ns=1, began_ns=0, documents=(), units={}, last_sample_ns={}, status=nothing, damaged_bytes={},
        store=Store.open(folder / "S"), kept={},
    )  # fmt: skip


@pytest.mark.parametrize("kind", [LevelChangeCondition, ControlChartCondition])
def test_each_kind_of_value_is_watched(two_positions: AlertView, kind: type[MetricCondition]) -> None:
    found = list(kind(metric="bias").findings(two_positions))
    changed = [each for each in found if "2026-01-2" in each.text]
    assert len(changed) == 1, [str(each.text) for each in found]
    assert "position=IRA_down" in changed[0].text
    assert "position=IRA_down" in changed[0].text.zh
    assert "零偏" in changed[0].text.zh
    of_one = kind(metric="bias", parameters={"position": "IRA_up"})
    assert not [each for each in of_one.findings(two_positions) if "IRA_down" in each.text]


@pytest.mark.parametrize(("units", "count"), [("G*", 1), ("Z*", 0)])
@pytest.mark.parametrize("kind", ["level_change", "control_chart"])
def test_the_units_of_a_rule_are_those_whose_values_are_watched(
    two_positions: AlertView, tmp_path: Path, kind: str, units: str, count: int
) -> None:
    rule = f'[[rules]]\nkind = "{kind}"\nmetric = "bias"\nunits = "{units}"\n'
    (tmp_path / "rules.toml").write_text(rule + 'parameters = { position = "IRA_down" }\n')
    (made,) = load_rules(tmp_path / "rules.toml").rules
    found = list(made.condition.findings(two_positions))
    assert len([each for each in found if made.concerns(each)]) == count
    assert all(each.unit == "G1" for each in found) or kind == "control_chart"


def test_an_error_is_computed_again_after_a_minute_not_at_every_look(two_positions: AlertView) -> None:
    view, asked = replace(two_positions, kept={}), list[int]()

    def compute() -> list[Finding]:
        asked.append(view.now_ns)
        raise NotFound("none")

    for second in range(0, 130, 10):
        view.now_ns = second * 10**9
        with pytest.raises(NotFound):
            view.every(1.0, "key", compute)
    assert asked == [0, 60 * 10**9, 120 * 10**9]


@pytest.mark.parametrize(
    ("rule", "why"),
    [
        ('kind = "unit_verdict"\nverdicts = ["ABORTED"]', "there are PASS, FAIL, MARGINAL, NO_DATA"),
        ('kind = "store_noted"\nwhat = ["disk_lo"]', "the store notes no 'disk_lo', did you mean disk_low?"),
        ('kind = "unit_verdict"\nverdicts = ["pass"]', "did you mean PASS?"),
        ('kind = "level_change"\nmetric = "Bias"', "there is no metric 'Bias'; did you mean bias?"),
        ('kind = "level_change"\nmetric = "bias"\nevery_h = inf', "every_h"),
        ('kind = "control_chart"\nmetric = "bias"\nevery_h = nan', "every_h"),
    ],
)
def test_a_word_that_can_never_be_is_refused(tmp_path: Path, run_command: Run, rule: str, why: str) -> None:
    (tmp_path / "rules.toml").write_text(f"[[rules]]\n{rule}\n")
    done = run_command("alert", "check", "--rules", "rules.toml", cwd=tmp_path)
    assert done.code == 1
    assert why in done.err


def test_a_choice_that_nothing_is_of_is_an_error(two_positions: AlertView) -> None:
    condition = LevelChangeCondition(metric="bias", signal="rate_z")
    with pytest.raises(NotFound, match="none of 152 values is of signal rate_z"):
        list(condition.findings(two_positions))
    assert list(LevelChangeCondition(metric="scale_factor").findings(two_positions)) == []  # none yet
