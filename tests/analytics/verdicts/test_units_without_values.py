"""Units that were mounted and gave no value have a verdict as well, in their lot and in its yield."""

from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from analytics.serve.api.operation import Call
from analytics.serve.api.trend.trends import VerdictsAsked, list_verdicts
from analytics.specifications.verdicts import yield_by
from tests.analytics.conftest import START_NS, TestedUnits
from tests.analytics.verdicts.few_metrics import computing

LIMITS = '[[limit]]\nmetric = "bias"\nlower = -10.0\nupper = 10.0\nunit_of_measure = "deg/h"\nproduct = "FOG"\n'


@pytest.fixture
def lot(tmp_path: Path) -> Iterator[TestedUnits]:
    """A lot of five units, of which one gave ten minutes; those of product MEMS have no limits."""
    units = TestedUnits(tmp_path / "S")
    units.run("r1", procedure="static_bias")
    for unit, product in (
        ("GOOD", "FOG"),
        ("SILENT", "FOG"),
        ("STOPPED", "FOG"),
        ("BARE", "MEMS"),
        ("BARE-SILENT", "MEMS"),
    ):
        units.mount("r1", unit, product=product, lot="L1")
    noise = np.random.default_rng(5).standard_normal((3, 6_000))
    units.step("r1", "GOOD", noise[0], t0_ns=START_NS, procedure="static_bias", step="static")
    units.step("r1", "STOPPED", noise[1], t0_ns=START_NS, outcome="aborted", procedure="static_bias", step="static")
    units.step("r1", "BARE", noise[2], t0_ns=START_NS, procedure="static_bias", step="static")
    units.product(LIMITS)
    yield units
    units.release()


@pytest.mark.parametrize("with_limits", [True, False])
@pytest.mark.in_gate("True")
def test_every_mounted_unit_is_judged_and_counted(lot: TestedUnits, with_limits: bool) -> None:
    if not with_limits:
        lot.product('[[limit]]\nmetric = "bias"\nlower = -1.0\nunit_of_measure = "deg/h"\nproduct = "OTHER"\n')
    # what is judged is the bias; the long form computes all metrics
    with computing("bias") if with_limits else nullcontext(), lot.catalog() as catalog:
        found = dict(catalog.rows("select unit, verdict from unit_verdicts"))
        reasons = dict(catalog.rows("select unit, reason from verdicts where metric = 'bias' and verdict = 'NO_DATA'"))
        (group,) = (each for each in yield_by(catalog, "lot") if each["name"] == "L1")
        listed = list_verdicts.handler(cast("Call", SimpleNamespace(metrics=catalog)), VerdictsAsked(lot="L1")).units
    silent = ("SILENT", "STOPPED", "BARE", "BARE-SILENT")
    expected = {"GOOD": "PASS" if with_limits else "NO_DATA", **dict.fromkeys(silent, "NO_DATA")}
    assert found == expected
    assert {each["unit"]: each["verdict"] for each in listed} == expected
    assert (group["units"], group["no_data"]) == (5, 4 if with_limits else 5)
    if with_limits:
        assert reasons["SILENT"] == "no sample of it came"
        assert reasons["STOPPED"] == "no step of its runs was completed"
