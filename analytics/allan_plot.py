"""A plot of Allan deviations, for a data sheet or a report: PNG or SVG."""

import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, fontManager, get_font
from matplotlib.text import Text
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

from analytics.limits import ALLAN_DEVIATION, ANGLE_RANDOM_WALK, ANGLE_RANDOM_WALK_TAU_S, SQRT_SECONDS_PER_SQRT_HOUR
from stream.errors import BadInput, UnknownUnit
from stream.events import Limit
from stream.quantities import conversion

Language = Literal["en", "zh", "en+zh"]

_SUFFIXES = (".png", ".svg")
_INK, _SOFT, _GRID, _FLEET = "#1a1a1a", "#5f6b76", "#dfe3e8", "#a9b4be"
_LIMIT = "#a40000"
# Okabe and Ito's colours for all kinds of colour vision, without their yellow, which is lost on white
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#1a1a1a", "#7a4fa3")
_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "h")
_CJK_FONTS = (
    "Noto Sans CJK SC",
    "Noto Sans SC",
    "Source Han Sans SC",
    "WenQuanYi Micro Hei",
    "WenQuanYi Zen Hei",
    "Droid Sans Fallback",
    "Microsoft YaHei",
    "SimHei",
    "PingFang SC",
)
_LATIN_FONT = "DejaVu Sans"
_WORDS = {
    "en": {
        "tau": "Averaging time τ (s)",
        "deviation": "Allan deviation ({unit})",
        "what": "Overlapping Allan deviation; bands: 95 % confidence",
        "limit": "limit",
        "others": "{n} other units",
    },
    "zh": {
        "tau": "平均时间 τ (s)",
        "deviation": "Allan 标准差 ({unit})",
        "what": "重叠 Allan 标准差；色带：95 % 置信区间",
        "limit": "限值",
        "others": "其余 {n} 只",
    },
}
_NAMED_AT_MOST = 24


@dataclass(frozen=True)
class AllanCurve:
    """Allan deviation of one signal over averaging time.

    Parameters
    ----------
    unit, signal, run : str
        Whose curve it is.
    unit_of_measure : str
        Of `adev`, `lo` and `hi`.
    sample_interval_s : float
        Sample interval of the record, seconds.
    samples, missing : int
        Samples in the record, and missing from it.
    tau_s : tuple of float
        Averaging times, seconds, rising.
    adev, lo, hi : tuple of float
        Deviation and its confidence limits (95 %).
    edf : tuple of float
        Equivalent degrees of freedom.

    Raises
    ------
    BadInput
        If the columns differ in length.
    """

    unit: str
    signal: str
    run: str
    unit_of_measure: str
    sample_interval_s: float
    samples: int
    missing: int
    tau_s: tuple[float, ...]
    adev: tuple[float, ...]
    lo: tuple[float, ...]
    hi: tuple[float, ...]
    edf: tuple[float, ...]

    def __post_init__(self) -> None:
        """Check that the columns fit together."""
        if len({len(column) for column in (self.tau_s, self.adev, self.lo, self.hi, self.edf)}) != 1:
            raise BadInput(f"Allan curve of unit {self.unit}, run {self.run}: its columns differ in length")

    def drawable(self) -> "AllanCurve":
        """Return the curve without the points that a logarithmic axis cannot show."""
        rows = [
            row
            for row in zip(self.tau_s, self.adev, self.lo, self.hi, self.edf, strict=True)
            if all(math.isfinite(x) and x > 0 for x in row[:4])
        ]
        columns = zip(*rows, strict=True) if rows else ((),) * 5
        tau_s, adev, lo, hi, edf = (tuple(column) for column in columns)
        head = (self.unit, self.signal, self.run, self.unit_of_measure, self.sample_interval_s)
        return AllanCurve(*head, self.samples, self.missing, tau_s, adev, lo, hi, edf)


def plot_allan(
    curves: Sequence[AllanCurve],
    path: Path,
    *,
    title: str | None = None,
    limits: Iterable[Limit] = (),
    chosen: str | None = None,
    language: Language = "en+zh",
) -> None:
    """Draw Allan deviations over averaging time into a file.

    Parameters
    ----------
    curves : sequence of AllanCurve
        One or several, all in one unit of measure.
    path : Path
        Where to, ``.png`` or ``.svg``.
    title : str, optional
        Title; by default the unit (or how many), signal and run.
    limits : iterable of Limit
        Those on the Allan deviation and on the angle random walk (at 1 s) are marked, for the signal of the curves;
        others, such as on the bias stability, are no points of this plot and are left out.
    chosen : str, optional
        The unit to draw boldly, with the rest as a grey fleet behind it.
    language : {"en+zh", "en", "zh"}
        Of the labels. Chinese needs a font for it; where none is installed, labels are English.

    Raises
    ------
    BadInput
        If there is nothing to draw, the curves differ in unit of measure, no curve is of the chosen unit, the suffix
        is another one, or the file cannot be written.

    Notes
    -----
    Holds no global state of matplotlib: calls may run in several threads.
    """
    if path.suffix.lower() not in _SUFFIXES:
        raise BadInput(f"plot {path}: plots are written as .png or .svg, choose one of the two")
    figure = _figure(_checked(curves, chosen), list(limits), title, chosen, language)
    image = io.BytesIO()
    kind = path.suffix.lower()[1:]
    figure.savefig(image, format=kind, dpi=200, metadata={"Date": None} if kind == "svg" else None)
    try:
        path.write_bytes(image.getvalue())
    except OSError as error:
        raise BadInput(f"plot {path}: cannot be written ({error.strerror or error})") from error


def _checked(curves: Sequence[AllanCurve], chosen: str | None) -> list[AllanCurve]:
    """Return the curves that can be drawn, the chosen ones last so that they lie on top."""
    if len({curve.unit_of_measure for curve in curves}) > 1:
        units = ", ".join(sorted({curve.unit_of_measure for curve in curves}))
        raise BadInput(f"Allan curves in {units} cannot share one axis: plot them apart")
    drawn = [curve for curve in (curve.drawable() for curve in curves) if curve.tau_s]
    if not drawn:
        raise BadInput("no Allan curve has a point to draw: a longer record, or one that is not constant, is needed")
    if chosen is not None and all(curve.unit != chosen for curve in drawn):
        known = ", ".join(sorted({curve.unit for curve in drawn}))
        raise BadInput(f"no Allan curve of unit {chosen} to draw; there are {known}")
    return sorted(drawn, key=lambda curve: curve.unit == chosen)


def _figure(
    curves: list[AllanCurve], limits: list[Limit], title: str | None, chosen: str | None, language: Language
) -> Figure:
    chinese = _chinese_font()
    languages = [part for part in language.split("+") if part == "en" or chinese is not None] or ["en"]
    words = _WORDS[languages[0]]
    figure = Figure(figsize=(8.2, 5.4), facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.095, 0.115, 0.735, 0.745))
    marks = _limit_marks(curves, limits)
    _scales(axes, curves, marks)
    _slope_key(axes)
    labels = [_curve(axes, curve, i, len(curves), chosen) for i, curve in enumerate(curves)]
    for tau_s, deviation, text in marks:
        _limit(axes, tau_s, deviation, f"{words['limit']} {text}")
    _name_curves(figure, axes, [label for label in labels if label is not None], words["others"])
    unit = "deg/h" if curves[0].unit_of_measure == "deg/h" else curves[0].unit_of_measure
    axes.set_xlabel(words["tau"], color=_INK, fontsize=10)
    axes.set_ylabel(words["deviation"].format(unit=unit), color=_INK, fontsize=10)
    figure.text(0.095, 0.945, title or _title(curves), fontsize=13, fontweight="bold", color=_INK)
    what = "  ·  ".join(_WORDS[part]["what"] for part in languages)
    figure.text(0.095, 0.895, what, fontsize=8.5, color=_SOFT)
    _set_fonts(figure, [_LATIN_FONT] if chinese is None else [_LATIN_FONT, chinese])
    return figure
