"""What a site may ask for, and what an alert says: who is silent, and why."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from analytics.alerts.conditions.unit_silent import UnitSilentCondition
from analytics.alerts.conditions.verdict import EarlyDecisionCondition
from analytics.alerts.finding import AlertView
from analytics.alerts.rules import load_rules
from stream.errors import BadInput
from stream.events import EarlyDecision, Limit

S = 10**9
TARGET = '[targets.desk]\nkind = "webhook"\nurl = "http://127.0.0.1:1/"\n'
LIMIT = Limit(characteristic="bias_stability", signal="rate", tau_s=10.0, upper=1.0, unit_of_measure="deg/h")


@pytest.mark.parametrize(
    ("rule", "said"),
    [
        ('kind = "verdict"\nverdicts = ["FALL"]', "FALL"), ('kind = "early_decision"\noutcomes = ["fail"]', "fail"),
        ('kind = "unit_silent"\nsilent_s = -5', "silent_s"), ('kind = "role"\nroles = ["recorder"]', "recorder"),
        ('kind = "role"\nconditions = ["dead"]', "dead"), ('kind = "disk"\nfree_percent = 120', "free_percent"),
        ('kind = "level_change"\nmetric = "bais"', "did you mean bias"),
        ('kind = "control_chart"\nmetric = "bias"\nby = "unti"', "did you mean unit"),
        ('kind = "level_change"\nmetric = "bias"\nfalse_alarm = 0.0', "false_alarm"),
        ('kind = "unit_verdict"\nverdicts = ["FALL"]', "did you mean FAIL"),
        ('kind = "off_set_point"\nwithin_deg_c = 0', "within_deg_c"), ('kind = "disk"\nafter_s = -1', "after_s"),
    ],
)  # fmt: skip
def test_a_rule_that_could_never_be_met_is_refused(tmp_path: Path, rule: str, said: str) -> None:
    path = tmp_path / "rules.toml"
    path.write_text(f"{TARGET}[[rules]]\n{rule}\n")
    with pytest.raises(BadInput) as refused:
        load_rules(path)
    assert said in str(refused.value)
    assert "rule 1" in str(refused.value)


def test_a_port_that_is_none_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "rules.toml"
    mail = 'kind = "email"\nhost = "h"\nsender = "a@b.c"\nto = ["d@e.f"]\nport = 80250\n'
    path.write_text(f'[targets.mail]\n{mail}[[rules]]\nkind = "verdict"\n')
    with pytest.raises(BadInput, match=r"targets\.mail.*65535"):
        load_rules(path)


def view(heard_s: dict[str, float], now_s: float = 100.0) -> AlertView:
    """Units of run r by when they were heard last; none is in the hands of a role of this computer."""
    units = {name: SimpleNamespace(run=SimpleNamespace(run="r"), is_at_work=True) for name in heard_s}
    found: Any = SimpleNamespace(
        units=units, last_sample_ns={("r", name): round(at * S) for name, at in heard_s.items()},
        now_ns=round(now_s * S), began_ns=0, status=SimpleNamespace(roles=()),
    )  # fmt: skip
    return cast("AlertView", found)


@pytest.mark.parametrize(
    ("heard_s", "silent", "asks_for_wiring"),
    [
        ({"A": 94.0, "B": 99.9, "chamber": 99.0}, {"A"}, True),
        ({"A": 94.0, "B": 94.1, "chamber": 93.0}, {"A", "B", "chamber"}, False),
        ({"A": 94.0}, {"A"}, True),
    ],
)
def test_units_that_fall_silent_together_have_a_common_cause(
    heard_s: dict[str, float], silent: set[str], asks_for_wiring: bool
) -> None:
    found = list(UnitSilentCondition(silent_s=5.0).findings(view(heard_s)))
    assert {each.unit for each in found} == silent
    for each in found:
        assert ("check its power and wiring" in str(each.text)) == asks_for_wiring
        assert ("see that recorder, bus and station are at work" in str(each.text)) != asks_for_wiring


@pytest.mark.parametrize(
    ("run", "outcome", "heard_s", "is_off", "ending"),
    [
        ("r", "open", 90, False, None), ("r", "completed", 90, False, None), ("r2", "open", 90, False, None),
        ("r", "completed", 10, False, "the run ended while the unit was silent"),
        ("r2", "open", 0, False, "the run ended while the unit was silent"),
        ("r", "open", 10, True, "the unit was switched off while it was silent"),
    ],
)  # fmt: skip
def test_a_silence_that_ends_with_its_run_is_no_recovery(
    run: str, outcome: str, heard_s: int, is_off: bool, ending: str | None
) -> None:
    of_run = SimpleNamespace(run=run, outcome=outcome)
    unit = SimpleNamespace(run=of_run, arrival_ns=heard_s * S, is_off=is_off)
    found: Any = SimpleNamespace(units={"A": unit})
    assert UnitSilentCondition().ending("r/A", 50 * S, cast("AlertView", found)) == ending
    assert UnitSilentCondition().ending("r/B", 50 * S, cast("AlertView", found)) is not None


def test_a_decision_at_the_end_of_the_record_is_not_early() -> None:
    def decision(fraction: float) -> EarlyDecision:
        return EarlyDecision(
            run="r", t_ns=1, unit="A", signal="rate", limit=LIMIT, outcome="FAIL", rule="r", error_probability=None,
            reason="x", reason_zh="x", looked_at_fraction=fraction,
        )  # fmt: skip

    seen: Any = SimpleNamespace(documents=[decision(0.5), decision(1.0)])
    found = list(EarlyDecisionCondition().findings(cast("AlertView", seen)))
    assert len(found) == 1
