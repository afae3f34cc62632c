"""Bounds of a shape parameter that was searched, such as a threshold, and what it adds to those of the coefficients."""

from collections.abc import Sequence

import msgspec
import numpy as np

from analytics.loop.effects.base import Effect, Shape, number
from analytics.loop.tracing.result.diagnosis_result import FoundEffect
from analytics.loop.tracing.search.effect_search import Search, Selected
from analytics.loop.tracing.search.fitted_candidates import CONFIDENCE
from analytics.loop.tracing.search.screening import Candidates
from analytics.loop.tracing.verdict.effect_findings import findings
from analytics.loop.tracing.whitening.joint_fit import normal_equations
from analytics.loop.tracing.whitening.least_squares import solve
from stream.batch import FloatArray
from stream.errors import BadInput

_STEP = 0.01  # of a parameter, over which its slope is taken
_TRIED = np.geomspace(0.4, 2.5, 184)  # of a parameter, one in a hundred apart
_ALIKE = 1e-9  # of a column's square, within which another is the same but for its size
_FAR = 0.2  # of a parameter: a larger correction or bound is beyond what a slope tells


def bounded_findings(candidates: Candidates, found: Search) -> list[FoundEffect]:
    """The findings of a search, see `with_shape_bounds`."""
    selected = {(each.name, str(each.fitted.parameters)): each for each in found.selected}
    return [
        with_shape_bounds(candidates, found, selected[each.name, str(each.parameters)], each)
        for each in findings(candidates, found)
    ]


def _alike(
    candidates: Candidates, effect: Effect, shape: Shape, name: str, value: float
) -> tuple[float, float, float, float] | None:
    """Range of a parameter over which the effect differs by its size alone, and by which factors; None if it is none.

    As of a limit between two rates, of a table that stands at these only: data of any number do not tell it.
    """
    own = np.concatenate([np.ravel(each) for each in candidates.at(effect, shape)])
    found: dict[float, float] = {value: 1.0}
    for side in (_TRIED[_TRIED < 1.0][::-1], _TRIED[_TRIED > 1.0]):
        for factor in side:
            other = np.concatenate(
                [np.ravel(each) for each in candidates.at(effect, _moved(shape, name, value * factor))]
            )
            square = float(other @ other)
            size = float(own @ other) / square if square > 0 else 0.0
            if not size > 0 or float(np.sum((own - size * other) ** 2)) > _ALIKE * float(own @ own):
                break
            found[float(value * factor)] = size
    if len(found) == 1:
        return None
    return min(found), max(found), min(found.values()), max(found.values())


def with_shape_bounds(candidates: Candidates, found: Search, which: Selected, finding: FoundEffect) -> FoundEffect:
    """A finding with bounds of its only shape parameter, and of its coefficients with that of the parameter in them.

    The effect's change with the parameter is fitted beside it (Gauss-Newton). Several parameters, lists, a
    form that does not fit, and a parameter that the data hardly determine stay as they are.
    """
    effect, shape = which.fitted.effect, which.fitted.parameters
    is_formless = bool(finding.unknown_function_of)
    if is_formless or not which.is_common or len(effect.parameters) != 1 or set(shape) != {effect.parameters[0].name}:
        return finding
    name = effect.parameters[0].name
    try:
        value = number(shape, name)
    except BadInput:  # a list, such as knots
        return finding
    alike = _alike(candidates, effect, shape, name, value)
    if alike is not None:
        low, high, least, most = alike
        coefficients = tuple(
            msgspec.structs.replace(
                each, lo=min(each.lo * least, each.lo * most), hi=max(each.hi * least, each.hi * most)
            )
            for each in finding.coefficients
        )
        return msgspec.structs.replace(finding, coefficients=coefficients, parameter_bounds={name: (low, high)})
    at, joint = found.common_columns(which), found.joint
    theta = joint.common.coefficients[at]
    step = _STEP * abs(value)
    columns = [_slope(low, high, theta, step) for low, high in zip(
        *(candidates.at(effect, _moved(shape, name, value + each)) for each in (-step, step)), strict=True
    )] if step > 0 else []  # fmt: skip
    if not columns or not all(np.isfinite(each).all() for each in columns):
        return finding
    normal, right = normal_equations(joint, joint.hypothesis.with_common(columns))
    solution = solve(normal, right)
    reach = CONFIDENCE * np.sqrt(np.diag(solution.covariance))
    moved, width = float(solution.coefficients[-1]), float(reach[-1])
    if not 0.0 < width < _FAR * abs(value) or abs(moved) > _FAR * abs(value):
        return finding
    coefficients = tuple(
        msgspec.structs.replace(
            each,
            lo=min(each.lo, float(min(each.value, own) - half)),
            hi=max(each.hi, float(max(each.value, own) + half)),
        )
        for each, own, half in zip(finding.coefficients, solution.coefficients[at], reach[at], strict=True)
    )
    bounds = value + min(moved, 0.0) - width, value + max(moved, 0.0) + width
    return msgspec.structs.replace(finding, coefficients=coefficients, parameter_bounds={name: bounds})


def _moved(shape: Shape, name: str, value: float) -> Shape:
    return {**shape, name: value}


def _slope(low: FloatArray, high: FloatArray, theta: Sequence[float] | FloatArray, step: float) -> FloatArray:
    return np.asarray((high - low) @ np.asarray(theta) / (2 * step))[:, None]
