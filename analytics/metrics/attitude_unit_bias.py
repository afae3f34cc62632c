"""Bias of an attitude unit's axis from positions in which the Earth's rate cancels (JJF 1536-2015 7.2)."""

import math
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np

from analytics.methods.attitude.cross_axes import EARTH_DEG_PER_H, Elements, seen_across, vertical_part
from analytics.methods.attitude.positions import (
    EAST,
    NORTH,
    Direction,
    direction_name,
    missing_angles,
    placed,
    triad_of,
)
from analytics.methods.weighted_fit import WeightedFit, weighted_fit
from analytics.metrics.attitude_unit_misalignment import latest_elements
from storage.sql.catalog import Catalog
from stream.batch import FloatArray
from stream.errors import BadInput

_WEST: Direction = (-1, 0, 0)
_SOUTH: Direction = (0, -1, 0)
_PLACES = ((EAST, NORTH), (EAST, _SOUTH), (_WEST, _SOUTH), (_WEST, NORTH))
# 5.3 to 5.5 and annex C; annex B has heading, pitch, roll about z, x, y, so a rotation's own name goes first
_ZERO_OF = {"X": "heading", "Y": "pitch", "Z": "roll", "HEADING": "heading", "PITCH": "pitch", "ROLL": "roll"}
_LEAST_HZ = 10.0
_USUAL_S = {"four positions": 1800.0, "equal angles": 1200.0}
_CLAUSES = {"four positions": "7.2.1, 7.2.3 (16)", "equal angles": "7.2.2"}

Step = Mapping[str, Any]


class Zero(NamedTuple):
    """The bias of an axis, and the amplitude of what it sees of the Earth's rate, deg/h."""

    fit: WeightedFit
    level_rate: float


class Reading(NamedTuple):
    """Mean output of an axis in a position, deg/h."""

    value: float
    u: float
    freedom: float


def compute(catalog: Catalog, sql: str) -> Iterator[dict[str, Any]]:
    """Rows of the metric: a bias of each axis, run, repeat and method, or what its set of positions lacks."""
    steps = catalog.reader(sql).read_all().to_pylist()
    elements = latest_elements(catalog) if steps else {}
    for key, group in groupby(steps, itemgetter("run", "unit", "signal", "repeat")):
        common = dict(zip(("run", "unit", "signal"), key, strict=False))
        rows = list(group)
        own = rows[0]["own"]
        try:
            of_methods = _by_method(rows, own)
        except BadInput as error:
            yield common | _row(rows, "positions", {}) | {"reason": str(error)}
            continue
        for method, chosen in of_methods.items():
            words: dict[str, Any] = {}
            row = common | _row([step for each in chosen.values() for step in each] or rows, method, words)
            try:
                _refuse(rows, chosen, method, own)
                found = _zero(chosen, method, elements)
            except BadInput as error:
                yield row | {"reason": str(error)}
                continue
            words["level_rate_deg_per_h"] = float(f"{found.level_rate:.4g}")
            words["heading_error_deg"] = _heading_error(found.level_rate, rows[0]["latitude_deg"], method)
            value, u = float(found.fit.values[0]), float(found.fit.errors[0])
            if method == "equal angles":
                positions = {step["position"] for steps in chosen.values() for step in steps}
                part = vertical_part(own, positions, rows[0]["unit"], rows[0]["latitude_deg"], elements)
                if isinstance(part, str):
                    words["remark"] = "; ".join(filter(None, (words["remark"], part)))
                else:
                    words["vertical_rate_deg_per_h"] = float(f"{part.value:.4g}")
                    value, u = value - part.value, math.hypot(u, part.u)
            yield row | {"value": value, "standard_uncertainty": u, "freedom": float(found.fit.freedoms[0])}


def _row(steps: Sequence[Step], method: str, words: dict[str, Any]) -> dict[str, Any]:
    own, records = steps[0]["own"], [step["duration_s"] for step in steps]
    words |= {
        "axis": own, "zero_of": _ZERO_OF[own], "method": method, "positions": len({step["position"] for step in steps}),
        "repeat": steps[0]["repeat"], "record_s": round(min(records), 1), "scale_factor": steps[0]["scale_source"],
        "level_rate_deg_per_h": None, "heading_error_deg": None, "vertical_rate_deg_per_h": None,
        "remark": _remark(steps, method),
    }  # fmt: skip
    clause = f"5.{3 + 'XYZ'.find(own)}, " if own in "XYZ" else "5.3-5.5, "
    return {
        "n": sum(step["n"] for step in steps), "steps": sorted(step["index"] for step in steps), "parameters": words,
        "standard": "JJF1536", "clause": clause + _CLAUSES.get(method, "7.2"),
    }  # fmt: skip


def _remark(steps: Sequence[Step], method: str) -> str | None:
    """What departs from the clauses without being refused: its note leaves the time to the user."""
    found = []
    lengths = [step["duration_s"] for step in steps]
    if method in _USUAL_S and min(lengths) < _USUAL_S[method] * 0.99:
        found.append(f"records of {min(lengths):.0f} s: the clause has {_USUAL_S[method]:.0f} s")
    if max(lengths) > 1.01 * min(lengths):
        found.append(f"records of {min(lengths):.0f} to {max(lengths):.0f} s: each position counts alike")
    slowest = min((step["n"] - 1) / step["duration_s"] if step["duration_s"] else 0.0 for step in steps)
    if slowest < _LEAST_HZ * 0.99:
        found.append(f"{slowest:.3g} samples/s: 7.2.1 asks for at least 10")
    if not any(step["sd"] for step in steps):
        found.append("the output never changes within a position: see that the axis answers")
    return "; ".join(found) or None


def _by_method(steps: Sequence[Step], own: str) -> dict[str, dict[Any, list[Step]]]:
    """The steps of each method by position: pairs of directions of the axis and a second one, or angles."""
    oriented: list[tuple[Step, Mapping[str, Direction]]] = []
    angles: defaultdict[float, list[Step]] = defaultdict(list)
    is_turned = False
    for step in steps:
        where = placed(step["position"])
        is_turned |= where is not None and where.angle_deg is not None
        if step["level_axis"] not in {None, own}:
            continue
        if where is not None and where.angle_deg is not None:
            if step["level_axis"] is None:
                raise BadInput(f"position {step['position']}: no word says which axis is level: add a column axis")
            angles[where.angle_deg].append(step)
        elif where is not None and own in where.axes and len(where.axes) == 3:
            oriented.append((step, where.axes))
        elif where is not None and where.axes and own not in where.axes:
            named = ", ".join(sorted(where.axes))
            raise BadInput(
                f"position {step['position']} names {named}, and the output is of {own}: name the axes of positions as "
                f"those of the signals; 5.3 to 5.5 and annex B put heading, pitch and roll on different letters"
            )
    found: dict[str, dict[Any, list[Step]]] = {}
    if is_turned:
        found["equal angles"] = dict(angles)
    if oriented or not is_turned:
        found["four positions"] = _four(oriented, own)
    return found


def _second_axis(oriented: Sequence[tuple[Step, Mapping[str, Direction]]], own: str) -> str:
    """The other axis that is level in most of the positions."""
    triad = triad_of(own)
    usual = triad[(triad.index(own) + 1) % 3]
    level = Counter(
        axis for _, axes in oriented for axis in triad if axis != own and axes[axis] in {NORTH, _SOUTH}
    )  # fmt: skip
    return max(level, key=lambda axis: (level[axis], axis == usual)) if level else usual


def _four(oriented: Sequence[tuple[Step, Mapping[str, Direction]]], own: str) -> dict[Any, list[Step]]:
    level = [(step, axes) for step, axes in oriented if axes[own] in {EAST, _WEST}]
    second = _second_axis(level, own)
    found: dict[Any, list[Step]] = {(own, second): []}
    for step, axes in level:
        if axes[second] in {NORTH, _SOUTH}:
            found.setdefault((axes[own], axes[second]), []).append(step)
    return found


def _refuse(rows: Sequence[Step], chosen: Mapping[Any, Sequence[Step]], method: str, own: str) -> None:
    if rows[0]["no_scale"] is not None:
        raise BadInput(rows[0]["no_scale"])
    if method == "equal angles":
        if (lack := missing_angles(sorted(chosen))) is not None:
            raise BadInput(f"{lack}: in a part of the circle the Earth's rate does not cancel (7.2.2)")
    else:
        (second,) = (key[1] for key in chosen if isinstance(key[0], str))
        lacking = [
            f"{own}_{direction_name(place[0])}_{second}_{direction_name(place[1])}"
            for place in _PLACES
            if place not in chosen
        ]
        if lacking:
            raise BadInput(
                f"not measured in this run: {', '.join(lacking)}; in less than the four positions the Earth's rate "
                f"does not cancel (7.2.1)"
            )
    every = [step for each in chosen.values() for step in each]
    if not any(step["mean"] or step["sd"] for step in every):
        raise BadInput("the output is 0 in every sample of every position: the axis does not answer")


def _reading(steps: Sequence[Step]) -> Reading:
    """The mean of a position's records, which err independently (Welch and Satterthwaite)."""
    u = np.array([math.nan if step["u_deg_per_h"] is None else step["u_deg_per_h"] for step in steps])
    freedom = np.array([1.0 if step["freedom"] is None else max(step["freedom"], 1.0) for step in steps])
    squares = float((u**2).sum())
    fourth = float((u**4 / freedom).sum())
    value = math.fsum(step["mean_deg_per_h"] for step in steps) / len(steps)
    return Reading(value, math.sqrt(squares) / len(steps), squares**2 / fourth if fourth > 0 else 1e9)


def _zero(chosen: Mapping[Any, Sequence[Step]], method: str, elements: Elements) -> Zero:
    places = [key for key, steps in chosen.items() if steps]
    readings = np.array([_reading(chosen[key]) for key in places], dtype=np.float64)
    if method == "four positions":  # it cancels in their mean, and is no scatter
        across = [_across(chosen[key][0], elements) for key in places]
        if None not in across:
            readings[:, 0] -= np.array(across, np.float64)
    design: FloatArray
    if method == "equal angles":
        angle = np.radians(np.array(places, dtype=np.float64))
        design = np.stack([np.ones_like(angle), np.cos(angle), np.sin(angle)], axis=1)
    else:
        side = np.array([1.0 if key[0] == EAST else -1.0 for key in places])
        design = np.stack([np.ones_like(side), side], axis=1)
    fit = weighted_fit(design, *readings.T)
    level = float(fit.values[1]) if method == "four positions" else float(np.hypot(*fit.values[1:]))
    return Zero(fit, level)


def _across(step: Step, elements: Elements) -> float | None:
    where = placed(step["position"])
    return None if where is None else seen_across(
        step["own"], where.axes, step["unit"], step["latitude_deg"], elements
    )  # fmt: skip


def _heading_error(level_rate: float, latitude_deg: float | None, method: str) -> float | None:
    """The angle by which east was missed, deg: the axis then sees Omega_e cos(latitude) sin(angle), west reversed."""
    if latitude_deg is None or method != "four positions":
        return None
    sine = level_rate / (EARTH_DEG_PER_H * math.cos(math.radians(latitude_deg)))
    return round(math.degrees(math.asin(sine)), 4) if abs(sine) <= 1 else None
