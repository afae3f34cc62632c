"""Curves of a certificate: deviations from the scale factor's line, bias over temperature, Allan deviation."""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from analytics.certificate.statement.results import ResultRow
from analytics.certificate.statement.words import Words
from analytics.curves.allan_curve import allan_curve
from analytics.plots.allan_plot import plot_allan
from analytics.plots.figure_file import in_both
from analytics.plots.points_plot import Axis, plot_points
from storage.sql.catalog import Catalog

_POINTS = "select signal, points from internal.scale_sets where unit = $unit and list_contains($runs, run) order by run"
_TEMPERATURES = """
select signal, temperature, bias, standard_uncertainty from temperature_curve
where unit = $unit and list_contains($runs, run) and temperature is not null order by signal, temperature
"""
_K = 2.0
_LEAST_POINTS = 3
_NOISE = ("angle_random_walk", "bias_stability_averaged", "bias")


class Figure(NamedTuple):
    """A curve as an SVG file."""

    name: str
    caption: Words
    svg: bytes


def figures_of(catalog: Catalog, unit: str, rows: Sequence[ResultRow]) -> list[Figure]:
    """The curves behind the results of a unit: those whose data there are."""
    runs_of = {row.metric: sorted({run for each in row.results for run in each.runs}) for row in rows if row.results}
    return [
        *_scale_factors(catalog, unit, runs_of.get("scale_factor", [])),
        *_temperatures(catalog, unit, runs_of.get("bias_temperature_sensitivity", [])),
        *_allan(catalog, unit, rows),
    ]


def _scale_factors(catalog: Catalog, unit: str, runs: list[str]) -> Iterator[Figure]:
    for signal, points in catalog.rows(_POINTS, {"unit": unit, "runs": runs}):
        rate = np.array([point["rate"] for point in points])
        output = np.array([point["output"] for point in points])
        if len(rate) < _LEAST_POINTS:
            continue
        slope, zero = np.polyfit(rate, output, 1)
        # of the span, as the nonlinearity of JJF 2014 is
        span = abs(slope) * float(np.ptp(rate))
        deviation_ppm = (output - slope * rate - zero) / span * 1e6
        bars = [None if point["u"] is None else _K * point["u"] / span * 1e6 for point in points]
        x = Axis(rate.tolist(), in_both("Input rate (°/s)", "输入角速率"))
        y = Axis(deviation_ppm.tolist(), in_both("Deviation (ppm of the span)", "残差"))
        caption = Words(f"Deviation from the line of the scale factor, {signal}", f"标度因数拟合残差，{signal}")
        yield _points(f"scale_factor-{signal}.svg", caption, f"{unit} {signal}", x, y, bars)


def _temperatures(catalog: Catalog, unit: str, runs: list[str]) -> Iterator[Figure]:
    found = catalog.rows(_TEMPERATURES, {"unit": unit, "runs": runs})
    for signal in dict.fromkeys(name for name, *_ in found):
        points = [(t, bias, u) for name, t, bias, u in found if name == signal and bias is not None]
        if not points:
            continue
        x = Axis([t for t, _, _ in points], in_both("Temperature (°C)", "温度"))
        y = Axis([bias for _, bias, _ in points], in_both("Bias (°/h)", "零偏"))
        bars = [None if u is None else _K * u for _, _, u in points]
        caption = Words(f"Bias over temperature, {signal}", f"零偏-温度曲线，{signal}")
        yield _points(f"temperature-{signal}.svg", caption, f"{unit} {signal}", x, y, bars)


def _allan(catalog: Catalog, unit: str, rows: Sequence[ResultRow]) -> Iterator[Figure]:
    records: dict[str, str] = {}
    for metric in _NOISE:
        for result in (each for row in rows if row.metric == metric for each in row.results):
            records.setdefault(result.signal, result.runs[-1])
    for signal, run in records.items():
        curve = allan_curve(catalog, unit, signal, run)
        caption = Words(f"Allan deviation, {signal}, run {run}", f"Allan 标准差，{signal}，试验 {run}")
        yield _drawn(f"allan-{signal}.svg", caption, partial(plot_allan, [curve]))


def _points(name: str, caption: Words, title: str, x: Axis, y: Axis, bars: Sequence[float | None]) -> Figure:
    what = in_both(caption.en, caption.zh, "  ·  ")
    return _drawn(name, caption, lambda path: plot_points(x, y, bars, path, title=title, what=what))


def _drawn(name: str, caption: Words, draw: Callable[[Path], None]) -> Figure:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "figure.svg"
        draw(path)
        return Figure(name.replace("/", "_"), caption, path.read_bytes())
