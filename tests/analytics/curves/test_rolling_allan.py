"""The rolling Allan deviation of a stored signal, and its picture."""

from pathlib import Path

import numpy as np
import pytest

from analytics.curves.rolling_allan import RollingAllan, rolling_allan
from analytics.plots.rolling_plot import plot_rolling
from stream.errors import BadInput, NotEnoughData
from tests.analytics.conftest import START_NS, TestedUnits

HOUR_NS = 3600 * 10**9


def surface(rows: int = 6, columns: int = 9, scale: float = 1.0) -> RollingAllan:
    tau_s = 0.1 * 2.0 ** np.arange(columns)
    values = scale * np.outer(np.linspace(1.0, 2.0, rows), 1.0 / np.sqrt(tau_s))
    cells = tuple(tuple(row) for row in values.tolist())
    return RollingAllan(
        unit="FOG-1",
        signal="rate",
        run="r1",
        unit_of_measure="deg/h",
        window_s=3600.0,
        step_s=900.0,
        start_h=tuple(0.25 * i for i in range(rows)),
        samples=(36_000,) * rows,
        missing=(0,) * rows,
        tau_s=tuple(tau_s.tolist()),
        adev=(*cells[:-1], (*cells[-1][:-1], None)),
        lo=cells,
        hi=cells,
    )


@pytest.mark.long
@pytest.mark.parametrize("shape", [(6, 9), (1, 9), (6, 1), (300, 30)])
@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_it_is_drawn(tmp_path: Path, shape: tuple[int, int], suffix: str) -> None:
    path = tmp_path / f"rolling{suffix}"
    plot_rolling(surface(*shape), path)
    drawn = path.read_bytes()
    assert drawn.startswith(b"\x89PNG" if suffix == ".png" else b"<?xml")
    if suffix == ".svg":
        assert b"mathdefault" not in drawn


def test_a_constant_signal_and_another_suffix_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="no deviation above 0 to draw"):
        plot_rolling(surface(scale=0.0), tmp_path / "a.png")
    with pytest.raises(BadInput, match=r"written as \.png or \.svg"):
        plot_rolling(surface(), tmp_path / "a.pdf")
    with pytest.raises(BadInput, match="cannot be written"):
        plot_rolling(surface(), tmp_path / "nowhere" / "a.png")


def test_the_table_leaves_out_and_says_so() -> None:
    small, large = surface().table(), surface(300, 30).table()
    assert "--json" in str(large.caption)
    assert small.row_count == 6
    assert large.row_count <= 40
    assert len(large.columns) <= 9


@pytest.mark.long
def test_the_run_is_the_longest_one(tested: TestedUnits) -> None:
    rng = np.random.default_rng(31)
    for run, start_h, samples in (("long", 10, 3000), ("early", 1, 3000), ("short", 20, 500)):
        t0_ns = START_NS + start_h * HOUR_NS
        tested.run(run, t_ns=t0_ns)
        tested.step(run, "U1", rng.normal(size=samples), t0_ns=t0_ns, dt_ns=10**9)
    with tested.catalog() as catalog:

        def run_of(window_s: float) -> str:
            return rolling_allan(catalog, "U1", "rate", window_s=window_s, step_s=window_s / 2).run

        assert [run_of(1000.0), run_of(3000.0), run_of(500.0)] == ["long", "long", "long"]
        too_long = "run long: no Allan deviation of a window of 4000 s: the record has 2999 s"
        with pytest.raises(NotEnoughData, match=too_long):
            run_of(4000.0)
