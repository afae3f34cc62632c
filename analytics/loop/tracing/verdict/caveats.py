"""Caveats of a verdict, from the data and from the held-out runs."""

from collections.abc import Iterator, Sequence
from itertools import combinations
from operator import methodcaller

import numpy as np

from analytics.loop.bilingual import Bilingual
from analytics.loop.effects import registry
from analytics.loop.model.error_model import ErrorModel
from analytics.loop.model.model_text import BIAS
from analytics.loop.tracing.case import FEWEST_BLOCKS_TO_SPLIT, FEWEST_REPLICATES, Case
from analytics.loop.tracing.result.diagnosis_result import FoundEffect
from analytics.loop.tracing.result.holdout import ErrorTable, Holdout
from analytics.loop.tracing.search.differing_terms import differing_terms
from analytics.loop.tracing.search.fitted_candidates import JUMP, LINE
from analytics.loop.tracing.verdict.held_out_caveats import holdout_caveats
from analytics.loop.tracing.verdict.jump_rivals import coincidences
from analytics.loop.tracing.whitening.joint_fit import JointFit
from analytics.loop.tracing.whitening.stack import UnitRecord
from stream.batch import FloatArray

FAR_ABOVE_NOISE = 3.0  # ratio to the noise within runs, which has no such limit
COPY = 1 - 1e-9  # correlation above which channels are copies, perhaps in other units
DERIVED_PAIRS = frozenset({frozenset({"input_rate", "table_rate"}), frozenset({"day", "time_since_power_on"})})
"""Pairs of which one is derived from the other if it is not recorded; the reduction reports it."""
_MOST_NAMED = 3
_COLLINEAR = 1e-6  # length of what a column adds to the others, over its own
_MUCH_INFLATED = 1e4  # variance by what it is where the columns are orthogonal: the column adds a hundredth
_NO_NOISE = Bilingual(
    "no noise was declared: it was estimated from these runs, so that excess noise cannot be detected",
    "未声明噪声：噪声由这些试验估计，因此无法判定噪声是否过大",
)
_EXCESS = Bilingual(
    "more noise at averages of 300 to 3600 s than declared, or else than the unit's own Allan curves have, and no "
    "channel explains it",
    "在300至3600 s的平均时间上噪声大于声明值（未声明时为产品自身Allan曲线的值），各通道均不能解释",
)


def caveats(
    case: Case,
    undetermined: Sequence[Bilingual],
    effects: Sequence[FoundEffect],
    holdout: Holdout | None,
    error: ErrorTable,
    *,
    noise_is_declared: bool,
    is_excess: bool,
) -> tuple[Bilingual, ...]:
    """All caveats of a verdict, the parts of the record that were left out first."""
    found = [
        *(each.sentence for each in case.report.left_out if each.is_grave),
        *case.report.limits,
        *_channel_caveats(case.training),
        *undetermined,
    ]
    found += [text for text in (unexplained_error(error) if case.held_out else None, _gain_caveat(error)) if text]
    found += _replication_caveats(case)
    if not noise_is_declared:
        found.append(_NO_NOISE)
    if is_excess:
        found.append(_EXCESS)
    found += _shape_caveats(effects)
    found += _end_caveats(case, effects)
    block_s = case.training.noise_model.block_s
    events = _event_caveats([each.name for each in effects], block_s)
    return (*found, *holdout_caveats(holdout, effects), *events, *coincidences(effects))


def _shape_caveats(effects: Sequence[FoundEffect]) -> Iterator[Bilingual]:
    """Effects whose coefficients depend on a parameter that is searched over a grid."""
    every = [(found, registry.effect(found.name).parameters) for found in effects if found.name not in {JUMP, LINE}]
    shaped = [(found, parameters) for found, parameters in every if parameters]
    for found, (parameter, *_) in shaped:
        name = registry.effect_name(found.name)
        for low, high in found.parameter_bounds.values():
            yield Bilingual(
                f"{name}: {parameter.en} {low:.4g} to {high:.4g}; the bounds of the coefficient contain that",
                f"{name.zh}：{parameter.zh}为{low:.4g}至{high:.4g}，系数的区间已含其不确定度",
            )
    shaped = [(found, parameters) for found, parameters in shaped if not found.parameter_bounds]
    if not shaped:
        return
    names = [(registry.effect_name(found.name), parameters) for found, parameters in shaped]
    listing = ", ".join(f"{name} ({', '.join(each.en for each in parameters)})" for name, parameters in names)
    listing_zh = "、".join(f"{name.zh}（{'、'.join(each.zh for each in parameters)}）" for name, parameters in names)
    yield Bilingual(
        f"bounds of coefficients hold for the parameters as given, whose own uncertainty is not in them: {listing}",
        f"系数的区间以所给参数为前提，不含参数本身的不确定度：{listing_zh}",
    )


def _end_caveats(case: Case, effects: Sequence[FoundEffect]) -> Iterator[Bilingual]:
    """Effects whose shape parameter is at an end of the values that were tried: it may be beyond."""
    for found in effects:
        own = registry.effect(found.name)
        if len(own.parameters) != 1 or found.parameter_bounds or found.name in {JUMP, LINE}:
            continue
        (parameter,) = own.parameters
        tried = [each.get(parameter.name) for each in own.shapes(case.training.stack.runs)]
        known, value = [each for each in tried if isinstance(each, int | float)], found.parameters[parameter.name]
        if len(known) < 2 or value not in (min(known), max(known)):
            continue
        name, size = registry.effect_name(found.name), f"{value:g}"
        end = Bilingual("smallest", "最小") if value == min(known) else Bilingual("largest", "最大")
        way = Bilingual("smaller", "更小") if value == min(known) else Bilingual("larger", "更大")
        yield Bilingual(
            f"{name}: {parameter.en} {size} is the {end} value tried; it may be {way}, and the coefficient another one",
            f"{name.zh}：{parameter.zh}{size}为所试的{end.zh}值，实际可能{way.zh}，系数也将不同",
        )


def hidden_delay_caveat(found: FoundEffect) -> Bilingual:
    """An effect that may be what is left of joining a gyro and a rate reference of two sample rates."""
    name = registry.effect_name(found.name)
    return Bilingual(
        f"{name} is not confirmed: its bounds contain what the sample rates of gyro and rate reference cannot "
        "tell of a delay, and zero; record both at one rate",
        f"{name.zh}未获证实：其区间含陀螺与速率基准两种采样率所不能分辨的延时，且含零；请以同一采样率记录两者",
    )


def no_size_caveat(found: FoundEffect) -> Bilingual:
    """An effect of which the training runs may have none, though the held-out runs go with what was found."""
    name = registry.effect_name(found.name)
    return Bilingual(
        f"{name} is not confirmed: its bounds contain zero, beside the other effects that were found",
        f"{name.zh}未获证实：在与所发现的其他效应并存时，其区间含零",
    )


def seen_once_caveat(found: FoundEffect) -> Bilingual:
    """What one training run shows beside the effects that were found: it is in the noise."""
    name = registry.effect_name(found.name)
    return Bilingual(
        f"{name}: one training run alone shows it, beside the effects that were found; it is not in the model, so that "
        "the noise stands for it: measure more runs that excite it",
        f"{name.zh}：在所发现的效应之外，仅一次训练试验显示该效应；模型不含它，噪声中包含其影响：请补测能激励它的试验",
    )


def _event_caveats(names: Sequence[str], block_s: float) -> Iterator[Bilingual]:
    if JUMP in names:
        yield Bilingual("a jump happens once: held-out runs cannot confirm it", "跳变只发生一次：留出试验不能予以证实")
    if LINE in names:
        yield Bilingual(
            f"a line faster than two blocks of {block_s:g} s is folded into this band: examine the spectrum at the "
            "full sampling rate",
            f"比两个{block_s:g} s数据块更快的谱线会折叠到本频带内：用全采样率的频谱判别",
        )
        yield Bilingual(
            "the phase of a line differs from run to run: no model predicts it, so that it remains in the errors "
            "before and after, and in the noise floor",
            "谱线的相位随试验而异：没有模型能预测，因此前后误差以及“仅噪声”中都含有它",
        )


def _replication_caveats(case: Case) -> Iterator[Bilingual]:
    count, blocks = len(case.stack.replicates), len(case.stack)
    is_single = case.replication == "within_run"
    if is_single:
        yield Bilingual(
            "one run only: its segments serve as replicates, so that anything specific to this run appears as an "
            "effect",
            "只有一次试验：以其分段代替重复试验，凡与这次试验相关的变化都会表现为效应",
        )
    elif len(case.training.stack.replicates) == 1:
        yield Bilingual(
            "the model was fitted to one run only: its terms include anything specific to that run, and no other "
            "run confirms them",
            "模型只由一次试验拟合：与该次试验相关的变化包含在各项中，没有其他试验予以证实",
        )
    if not is_single and count >= FEWEST_REPLICATES and not all(run.is_date_known for run in case.stack.runs):
        names = case.stack.runs[0].run, case.stack.runs[-1].run
        yield Bilingual(
            f"no dates are known: the runs are taken in the order of their names, {names[0]} to {names[1]}, for what "
            "is held out and what changes from run to run; import them with --start, or name others with --holdout",
            f"日期未知：留出试验及各次试验间的变化均按试验名称的顺序（{names[0]}至{names[1]}）处理；"
            "请用--start导入日期，或用--holdout指定留出试验",
        )
    if case.held_out:
        return
    if is_single:
        least, runs = FEWEST_BLOCKS_TO_SPLIT, FEWEST_REPLICATES
        why = Bilingual(
            f"one run of {blocks} blocks; {least} blocks or {runs} runs are needed",
            f"只有一次试验，共{blocks}个数据块；需要{least}个数据块或{runs}次试验",
        )
    elif count < FEWEST_REPLICATES:
        why = Bilingual(f"{count} runs; {FEWEST_REPLICATES} are needed", f"{count}次试验，需要{FEWEST_REPLICATES}次")
    else:
        why = Bilingual("no run was held out", "没有留出任何试验")
    yield Bilingual(f"no held-out set: {why}", f"无留出数据：{why.zh}")


def _channel_caveats(record: UnitRecord) -> list[Bilingual]:
    names = sorted(set.intersection(*(set(run.channels) for run in record.stack.runs)))
    values = {name: record.stack.column(methodcaller("mean", name)) for name in names}
    known = {name: each for name, each in values.items() if np.isfinite(each).all()}
    moving = {name: each for name, each in known.items() if np.ptp(each) > 0}
    return [
        Bilingual(f"channel {name} is constant: its effects cannot be tested", f"通道{name}为常值：无法检验其效应")
        for name in sorted(known.keys() - moving.keys())
    ] + [
        Bilingual(
            f"channels {one} and {other} are copies: their effects cannot be separated",
            f"通道{one}与{other}互为副本：其效应无法区分",
        )
        for one, other in _copies(moving)
    ]


def _copies(values: dict[str, FloatArray]) -> list[tuple[str, str]]:
    if len(values) < 2:
        return []
    correlation = np.abs(np.corrcoef(np.array(list(values.values()))))
    pairs = combinations(enumerate(values), 2)
    alike = [(first, second) for (i, first), (j, second) in pairs if correlation[i, j] > COPY]
    return [pair for pair in alike if frozenset(pair) not in DERIVED_PAIRS]


def undetermined_terms(case: Case, labels: Sequence[str]) -> tuple[Bilingual, ...]:
    """Terms of the declared model, by label, that are collinear with the preceding terms in the training runs."""
    basis = np.empty((len(case.training), 0))
    blind = []
    for label, column in zip(labels, case.training.design.T, strict=True):
        length = float(np.linalg.norm(column))
        rest = column - basis @ (basis.T @ column)
        if length == 0 or np.linalg.norm(rest) < _COLLINEAR * length:
            blind.append(label)
        else:
            basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
    training = case.training.stack.replicates
    is_short = len(training) <= _MOST_NAMED
    runs = Bilingual(*((", ".join(training),) * 2 if is_short else (f"{len(training)} runs", f"{len(training)}次")))
    advice = Bilingual("measure runs that excite it", "请测量激励该项的试验")
    if case.held_out:
        advice = Bilingual("hold out other runs with --holdout runs=A,B", "用--holdout runs=A,B留出其他试验")
    return tuple(
        Bilingual(
            f"term {label} of the declared model cannot be determined from the fitted runs ({runs}): {advice}, or "
            "remove the term from the model",
            f"由所拟合的试验（{runs.zh}）无法确定声明模型的{label}项：{advice.zh}，或从模型中去掉该项",
        )
        for label in blind
    )


def weak_terms(case: Case, model: ErrorModel) -> list[Bilingual]:
    """Declared terms that hardly vary beside the others, and whose coefficient may be 0: what they do to the bias."""
    design, covariance, labels = case.training.design, np.asarray(model.covariance), model.labels()
    if BIAS not in labels or covariance.shape != (len(labels),) * 2:
        return []
    scaled = design / np.where((length := np.linalg.norm(design, axis=0)) > 0, length, 1.0)
    inflation = np.diag(np.linalg.pinv(scaled.T @ scaled, rcond=_COLLINEAR**2, hermitian=True))
    errors = np.sqrt(np.diag(covariance))
    units = model.units or ("",) * len(labels)
    bias = f"{errors[labels.index(BIAS)]:.2g} {units[labels.index(BIAS)]}"
    return [
        Bilingual(
            f"term {label} of the declared model hardly varies in the fitted runs: its coefficient is {value:.3g} ± "
            f"{error:.2g} {unit}, and beside it the bias is uncertain by {bias}: measure runs that excite it, or "
            "remove the term",
            f"声明模型的{label}项在所拟合的试验中几乎不变：系数为{value:.3g} ± {error:.2g} {unit}，"
            f"致使零偏不确定度为{bias}：请测量激励该项的试验，或去掉该项",
        )
        for label, value, error, unit, by in zip(labels, model.coefficients, errors, units, inflation, strict=True)
        if label != BIAS and by > _MUCH_INFLATED and abs(value) < 2.0 * error
    ]


def differing_caveats(joint: JointFit, model: ErrorModel) -> list[Bilingual]:
    """Declared terms whose coefficients differ from run to run: what follows of it for them."""
    return [
        Bilingual(
            f"the coefficient of {label}, which the model declares, differs from run to run by {size} (one standard "
            f"deviation over {each.runs} runs, p = {each.p_value:.2g}): it does not repeat, or another effect changes "
            "it; its interval, which is that of the noise, is too narrow",
            f"声明项{label}的系数在各次试验间相差{size}（{each.runs}次试验的标准差，p = {each.p_value:.2g}）："
            "该系数不重复，或受其他效应影响；其区间仅由噪声得出，偏窄",
        )
        for each in differing_terms(joint)
        for label, unit in [(model.labels()[each.column], model.units[each.column] if model.units else "")]
        for size in [f"{each.spread:.3g} {unit}".strip()]
    ]


def unexplained_error(table: ErrorTable) -> Bilingual | None:
    """By how much the error of the model found exceeds the noise; None if it is not far above."""
    where = Bilingual("the held-out runs", "留出试验") if table.is_held_out else Bilingual("the runs", "试验")
    within = Bilingual(" about the mean of each run", "去除各次试验均值后")
    for row in sorted(table.rows, key=lambda row: -row.averaging_s):
        for error, most, about in (
            (row.after, row.allowed, Bilingual("", "")),
            (row.after_within, FAR_ABOVE_NOISE * row.floor_within, within),
        ):
            if 0 < most < error:
                size, allowed = f"{error:.4g} {table.unit_of_measure}", f"{most:.4g}"
                seconds = f"{row.averaging_s:g} s"
                return Bilingual(
                    f"the RMS error of {where} over {seconds}{about} is {size}, but noise and the errors of the "
                    f"coefficients allow {allowed} at most: the model does not hold there",
                    f"{where.zh}在{seconds}平均时间上{about.zh}均方根误差为{size}，而噪声与系数误差最多允许{allowed}：模型在该处不成立",
                )
    return None


def _gain_caveat(table: ErrorTable) -> Bilingual | None:
    """The error does not fall significantly; None if it does or nothing was found."""
    row = table.reference
    if row is None or row.gain is None or row.gain_within is None or row.gain.lo is None:
        return None
    if row.gain.is_significant or row.gain_within.is_significant:
        return None
    change = Bilingual("does not change significantly", "无显著变化")
    if row.gain_within.is_loss:
        change = Bilingual("rises", "上升")
    before, after = f"{row.before:.3g}", f"{row.after:.3g}"
    within = f"{row.before_within:.3g}", f"{row.after_within:.3g}"
    return Bilingual(
        f"the RMS error over {row.averaging_s:g} s in {row.gain.runs} runs {change}: {before} before and {after} "
        f"{table.unit_of_measure} after; about the mean of each run {within[0]} and {within[1]}",
        f"{row.gain.runs}次试验在{row.averaging_s:g} s平均时间上的均方根误差{change.zh}：之前{before}，之后{after} "
        f"{table.unit_of_measure}；去除各次试验均值后为{within[0]}和{within[1]}",
    )
