"""Budgets printed in JJF 2014-2022 annex B and JJF 1536-2015 annex A, to the digit, with their errata."""

import math

import pytest

from analytics.uncertainty.budget import Budget
from analytics.uncertainty.component import Component
from analytics.uncertainty.distribution import Distribution
from analytics.uncertainty.rounding import round_up

STEP = 2.0**-12


def certificate(en: str, zh: str, expanded: float) -> Component:
    return Component.from_certificate(en, zh, expanded, 2, "1")


def scatter(u: float) -> Component:
    return Component.type_a("repeatability", "测量重复性", u, math.inf, "1")


def alike(u: float, count: int) -> tuple[Component, ...]:
    """The printed plain sum of equal terms: fully correlated ones."""
    return tuple(
        Component.type_a(f"output {i}", f"输出 {i}", u, math.inf, "1", group="outputs") for i in range(1, count + 1)
    )


def budget(*components: Component) -> Budget:
    return Budget(en="measurand", zh="被测量", value=1.0, unit="1", components=components)


JJF2014_SCALE_FACTOR = budget(
    certificate("rate table", "速率转台", 1e-4), certificate("voltmeter", "6位半数字电压表", 6e-5), scatter(1.54e-4)
)
TABLE_1536 = certificate("table", "位置速率转台", 2e-4)
# delta/sqrt(3) as printed, rounded to 1.41e-4 (erratum: delta is the width of the distribution, not its half)
ACQUISITION_1536 = Component.from_half_width(
    "acquisition", "数据采集系统", 1.41e-4 * math.sqrt(3), Distribution.UNIFORM, "1"
)


@pytest.mark.parametrize(
    ("found", "u", "digits", "expanded", "printed"),
    [
        pytest.param(JJF2014_SCALE_FACTOR, 1.65e-4, 3, 3.29339e-4, 3.3e-4, id="JJF2014-B.1-scale_factor"),
        pytest.param(
            budget(TABLE_1536, ACQUISITION_1536, scatter(1.22e-4)), 2.116e-4, 4, 4.23155e-4, 4.3e-4,
            id="JJF1536-A.1-scale_factor",
        ),
        pytest.param(
            budget(TABLE_1536, ACQUISITION_1536, *alike(3.41e-5, 4)), 2.20e-4, 3, 4.40391e-4, 4.4e-4,
            id="JJF1536-A.2-bias",
        ),
        pytest.param(
            budget(TABLE_1536, ACQUISITION_1536, *alike(2.51e-3, 2)), 5.023e-3, 4, 1.004596e-2, 1.1e-2,
            id="JJF1536-A.3-misalignment",
        ),
    ],
)  # fmt: skip
def test_a_printed_budget_is_reproduced(found: Budget, u: float, digits: int, expanded: float, printed: float) -> None:
    result = found.expand(k=2)
    assert float(f"{result.u:.{digits - 1}e}") == u
    assert result.expanded == pytest.approx(expanded, rel=2e-6)
    assert result.rounded == printed
    assert result.method == "JCGM 100"


def test_bias_of_jjf_2014_needs_the_rounded_uncertainty_of_its_scale_factor() -> None:
    """B.2: 1.65e-4 is rounded; the unrounded one gives 1.674e-4 and U = 3.35e-4."""
    voltmeter = certificate("voltmeter", "6位半数字电压表", 6e-5)

    def bias(u_scale_factor: float) -> Budget:
        scale_factor = Component.from_certificate("scale factor", "标度因数", u_scale_factor, 1, "1")
        return budget(voltmeter, scale_factor)

    printed = bias(1.65e-4).expand(k=2)
    assert float(f"{printed.u:.2e}") == 1.68e-4
    assert round_up(printed.expanded, digits=3) == 3.36e-4
    exact = bias(JJF2014_SCALE_FACTOR.standard_uncertainty()).expand(k=2)
    assert float(f"{exact.u:.3e}") == 1.674e-4
    assert round_up(exact.expanded, digits=3) == 3.35e-4


def test_a_quantisation_step_of_jjf_1536_contributes_its_width_over_root_12() -> None:
    """Erratum of A.1.2.2 2): with delta/sqrt(12), u = 1.728e-4 and U = 3.46e-4."""
    step = Component.from_step("quantisation", "量化", STEP, "1")
    result = budget(TABLE_1536, step, scatter(1.22e-4)).expand(k=2)
    assert step.u == pytest.approx(ACQUISITION_1536.u / 2, rel=1e-3)
    assert float(f"{result.u:.3e}") == 1.728e-4
    assert round_up(result.expanded, digits=3) == 3.46e-4


def test_the_sensitivity_of_the_bias_of_jjf_1536_is_1_over_7200_per_position() -> None:
    """Erratum of (A.5): it names 450 and then takes 1; B = sum(N)/(4 T) with T = 1800 s."""
    outputs = tuple(
        Component.type_a(
            f"output {i}", f"输出 {i}", 3.41e-5, math.inf, "deg", sensitivity=1 / (4 * 1800.0),
            sensitivity_unit="1/s", group="outputs",
        )
        for i in range(1, 5)
    )  # fmt: skip
    assert budget(*outputs).standard_uncertainty() == pytest.approx(4 * 3.41e-5 / 7200)
