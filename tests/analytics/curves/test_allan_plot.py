"""The Allan plot: files that open, nothing unreadable, and refusals a person can act on."""

import itertools
import re
import struct
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.text import Text

from analytics.curves.allan_curve import AllanCurve
from analytics.demo.demo import demo_limits
from analytics.plots import allan_plot, plot_fonts
from analytics.plots.allan_marks import limit_marks, spread
from analytics.plots.allan_plot import plot_allan, shortened
from stream.errors import BadInput
from stream.events import Limit


def curve(unit: str, white: float = 1.2, floor: float = 0.07, *, points: int = 20, run: str = "r1") -> AllanCurve:
    tau_s = 0.005 * 2.0 ** np.arange(points)
    adev = np.hypot(white / np.sqrt(tau_s), floor)
    edf = 20_000 / tau_s
    relative = 1 / np.sqrt(2 * edf)
    return AllanCurve(
        unit=unit,
        signal="rate",
        run=run,
        unit_of_measure="deg/h",
        sample_interval_s=0.005,
        samples=4_320_000,
        missing=12,
        tau_s=tuple(tau_s.tolist()),
        adev=tuple(adev.tolist()),
        lo=tuple((adev / (1 + 2 * relative)).tolist()),
        hi=tuple((adev * (1 + 2 * relative)).tolist()),
        edf=tuple(edf.tolist()),
    )


FLEET = [curve(f"FOG-{231 + i:04d}", 1 + 0.1 * i, 0.05 + 0.005 * i) for i in range(8)]


def texts(curves: list[AllanCurve], **options: object) -> list[str]:
    settings = {"limits": [], "title": None, "chosen": None, "language": "en"} | options
    figure = allan_plot._figure(allan_plot._checked(curves, settings["chosen"]), **settings)  # type: ignore[arg-type]
    return [text.get_text() for text in figure.findobj(Text) if text.get_text()]


@pytest.mark.long
@pytest.mark.parametrize("name", ["fleet.png", "fleet.PNG"])
def test_png_is_written(tmp_path: Path, name: str) -> None:
    plot_allan(FLEET, tmp_path / name, limits=demo_limits().live)
    head = (tmp_path / name).read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = struct.unpack(">II", head[16:])
    assert (width, height) == (1640, 1080)


def test_svg_is_written_and_has_no_date(tmp_path: Path) -> None:
    plot_allan(FLEET, tmp_path / "fleet.svg")
    assert ET.parse(tmp_path / "fleet.svg").getroot().tag.endswith("svg")
    assert "dc:date" not in (tmp_path / "fleet.svg").read_text(encoding="utf-8")


def test_names_units_and_limits_are_written() -> None:
    written = texts(FLEET, limits=list(demo_limits().live))
    assert {c.unit for c in FLEET} <= set(written)
    assert "Averaging time τ (s)" in written
    assert "Allan deviation (deg/h)" in written
    assert "8 units  ·  rate  ·  run r1" in written
    assert "limit 0.03 deg/√h" in written
    assert "limit 0.2 deg/h" in written
    assert not any("0.45" in text for text in written)
    assert "6 h at 0.005 s; 34,560,000 samples, 96 missing" in written


def test_one_unit_stands_out_from_the_fleet() -> None:
    written = texts(FLEET, chosen="FOG-0234")
    assert "FOG-0234" in written
    assert "7 other units" in written
    assert "FOG-0231" not in written
    assert "6 h at 0.005 s; 4,320,000 samples, 12 missing" in written


def test_curves_of_one_unit_are_told_apart_by_run() -> None:
    assert {"FOG-1 a", "FOG-1 b"} <= set(texts([curve("FOG-1", run="a"), curve("FOG-1", 2.0, run="b")]))
    long = "SERIAL-2026-LOT-17-00231"
    assert "SERIA…T-17-00231" in texts([curve(long)])


def test_limits_are_marked_in_the_unit_of_the_curves() -> None:
    walk, allan = demo_limits().live[:2]
    marks = limit_marks([walk, allan], {"rate"}, "deg/s")
    assert [mark.tau_s for mark in marks] == [1.0, 100.0]
    assert [mark.deviation * 3600 for mark in marks] == pytest.approx([1.8, 0.2])
    assert limit_marks([walk], {"temperature"}, "degC") == []
    warm = Limit(characteristic="allan_deviation", signal="rate", tau_s=1.0, upper=1.0, unit_of_measure="degC")
    with pytest.raises(BadInput, match="limit on allan_deviation of signal rate: 'degC' cannot be converted"):
        limit_marks([warm], {"rate"}, "deg/h")


@given(st.lists(st.floats(-0.5, 1.5), max_size=24))
def test_names_never_touch_and_stay_inside(heights: list[float]) -> None:
    placed = spread(sorted(heights), 0.04)
    assert len(placed) == len(heights)
    assert all(b - a >= 0.04 - 1e-9 for a, b in itertools.pairwise(placed))
    assert all(-1e-9 <= height <= 1 + 1e-9 for height in placed)


@pytest.mark.long
def test_strange_characters_are_drawn_as_squares_and_dollars_as_dollars(tmp_path: Path) -> None:
    written = texts(FLEET[:1], title="lot $x_ \x01\ud800")
    assert "lot $x_ □□" in written
    plot_allan([replace(FLEET[0], unit="\U000e0001$^"), *FLEET], tmp_path / "a.svg", title="\x0b<&> 陀螺 $_{")
    ET.parse(tmp_path / "a.svg")


def test_labels_are_english_where_no_chinese_font_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (allan_plot, plot_fonts):
        monkeypatch.setattr(module, "chinese_font", lambda: None)
    for language in ("en+zh", "zh", "en"):
        written = texts(FLEET, language=language)
        assert "Averaging time τ (s)" in written
        assert "Overlapping Allan deviation; bands: 95 % confidence" in written


@pytest.mark.long
@pytest.mark.skipif(plot_fonts.chinese_font() is None, reason="no font with Chinese characters is installed")
def test_labels_are_chinese_where_asked_for(tmp_path: Path) -> None:
    written = texts(FLEET, language="zh")
    assert "平均时间 τ (s)" in written
    assert not any("□" in text for text in written)
    assert any(re.search("confidence.*置信区间", text) for text in texts(FLEET, language="en+zh"))
    plot_allan(FLEET, tmp_path / "a.png", language="zh", title="陀螺")


@pytest.mark.long
@pytest.mark.parametrize("points", [1, 2])
def test_few_points_are_drawn(tmp_path: Path, points: int) -> None:
    plot_allan([curve("FOG-1", points=points)], tmp_path / "a.png")
    (axes,) = allan_plot._figure([curve("FOG-1", points=points)], [], None, None, "en").axes
    for ticks, (low, high) in ((axes.get_xticks(), axes.get_xlim()), (axes.get_yticks(), axes.get_ylim())):
        assert any(low <= tick <= high for tick in ticks)


def test_points_without_a_logarithm_are_left_out() -> None:
    tilted = replace(FLEET[0], adev=(0.0, *FLEET[0].adev[1:]), hi=(*FLEET[0].hi[:-1], float("inf")))
    assert tilted.drawable().tau_s == FLEET[0].tau_s[1:-1]


@pytest.mark.long
def test_many_curves_are_drawn_in_several_threads(tmp_path: Path) -> None:
    curves = [curve(f"FOG-{i}", 1 + 0.02 * i) for i in range(40)]
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda i: plot_allan(curves, tmp_path / f"{i}.png", chosen=f"FOG-{i % 2}"), range(8)))
    images = [(tmp_path / f"{i}.png").read_bytes() for i in range(8)]
    assert len(set(images)) == 2


@pytest.mark.long
def test_what_cannot_be_drawn_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    with pytest.raises(BadInput, match=r"a\.pdf: plots are written as \.png or \.svg"):
        plot_allan(FLEET, tmp_path / "a.pdf")
    with pytest.raises(BadInput, match=r"cannot be written \(No such file or directory\)"):
        plot_allan(FLEET, tmp_path / "none" / "a.png")
    with pytest.raises(BadInput, match="no Allan curve has a point"):
        plot_allan([], path)
    with pytest.raises(BadInput, match=r"in deg/h, rad/s cannot share one axis"):
        plot_allan([FLEET[0], replace(FLEET[1], unit_of_measure="rad/s")], path)
    with pytest.raises(BadInput, match="no Allan curve of unit FOG-9 to draw; there are FOG-0231"):
        plot_allan(FLEET, path, chosen="FOG-9")
    with pytest.raises(BadInput, match="its columns differ in length"):
        replace(FLEET[0], edf=())
    assert not path.exists()


@pytest.mark.parametrize(
    ("unit", "name"),
    [
        ("陀螺-001", "陀螺-001"),
        ("光纤陀螺样机二号-001", "光纤…机二号-001"),
        ("ABCDEFGHIJKLMNOPQRST", "ABCDE…KLMNOPQRST"),
    ],
)
def test_a_name_beside_a_curve_is_short_enough_also_in_chinese(unit: str, name: str) -> None:
    assert shortened(unit) == name
