"""A picture as data: axes, curves and marks with their names in two languages; pages draw it and list it as a table."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, Literal

import msgspec

# `alarm`: points that need somebody; `limit` of a specification, `control` limit and `centre` of a chart
Style = Literal["line", "points", "both", "bars", "alarm", "limit", "control", "centre"]


class Label(msgspec.Struct, frozen=True):
    """A text in English and Chinese."""

    en: str
    zh: str

    @classmethod
    def same(cls, text: str) -> "Label":
        """A name, which is the same in both."""
        return cls(text, text)


class Axis(msgspec.Struct, frozen=True, kw_only=True):
    """An axis; `unit` is the unit of measure of its numbers, seconds since 1970-01-01 UTC if `scale` is ``time``.

    With the scale ``names`` its numbers are places in `names`, from 0 on.
    """

    label: Label
    unit: str = ""
    scale: Literal["linear", "log", "time", "names"] = "linear"
    names: list[Label] = []


class Curve(msgspec.Struct, frozen=True, kw_only=True):
    """A curve; `lo` and `hi` are bounds of y, `texts` say what each point is, `links` are the pages behind points.

    `verdicts` are those of its points, as ``PASS``.
    """

    name: Label
    x: Sequence[float]
    y: Sequence[float | None]
    style: Style = "line"
    lo: Sequence[float | None] | None = None
    hi: Sequence[float | None] | None = None
    texts: Sequence[str] | None = None
    links: Sequence[str | None] | None = None
    verdicts: Sequence[str | None] | None = None


class Mark(msgspec.Struct, frozen=True):
    """A place on the x axis with its meaning."""

    x: float
    label: Label


class Picture(msgspec.Struct, frozen=True, kw_only=True):
    """Curves over one pair of axes; `note` says how to read them, `reason` why there is none."""

    title: Label
    x: Axis
    y: Axis
    curves: list[Curve] = []
    marks: list[Mark] = []
    note: Label | None = None
    reason: Label | None = None

    def columns(self) -> Mapping[str, Sequence[Any]]:
        """Its table in long form, for Arrow, Parquet and CSV: one row for each point of each curve."""
        rows = [
            (curve.name.en, _point(curve, i), self.place(x), curve.y[i], at(curve.lo, i), at(curve.hi, i))
            for curve in self.curves
            for i, x in enumerate(curve.x)
        ]
        names = ("curve", "point", "time" if self.x.scale == "time" else "x", "y", "lo", "hi")
        return {name: [row[i] for row in rows] for i, name in enumerate(names)}

    def column_types(self) -> Mapping[str, type]:
        """What the values of its table are."""
        x = {"time": str} if self.x.scale == "time" else {"x": str if self.x.scale == "names" else float}
        return {"curve": str, "point": str, **x, "y": float, "lo": float, "hi": float}

    def place(self, x: float) -> float | str:
        """A number of the x axis for people: a moment, a name, or itself.

        >>> axis = Axis(label=Label.same("t"), scale="time")
        >>> Picture(title=Label.same(""), x=axis, y=axis).place(1_795_255_200.0)
        '2026-11-21T10:00:00Z'
        """
        if self.x.scale == "time":
            return datetime.fromtimestamp(x, UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
        if self.x.scale == "names":
            return self.x.names[round(x)].en
        return x


def _point(curve: Curve, index: int) -> str:
    return " ".join(filter(None, (at(curve.texts, index), at(curve.verdicts, index))))


def at(values: Sequence[Any] | None, index: int) -> Any:
    """One of some values, None if there are none."""
    return None if values is None else values[index]
