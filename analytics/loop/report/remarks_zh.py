"""Limits of a verdict, notes on the reduction, and reasons, in Chinese: what they say is made in English."""

import re
from collections.abc import Mapping
from functools import cache
from typing import Final

_SENTENCES: Final[Mapping[str, str]] = {
    # limits of a verdict
    "one run only: its segments stand for replicates, so that what is tied to this run shows as an effect":
        "只有一次试验：以其分段代替重复试验，凡与这次试验相关的变化都会表现为效应",
    "no held-out set: one run of {blocks} blocks; {least} or {runs} runs are needed":
        "无留出数据：只有一次试验，共{blocks}个数据块；需要{least}个数据块或{runs}次试验",
    "no held-out set: {count} runs, {needed} are needed": "无留出数据：{count}次试验，需要{needed}次",
    "no held-out set: none of the runs was held out": "无留出数据：没有留出任何试验",
    "no noise was declared: it was guessed from these runs, so that an excess of noise cannot be told":
        "未声明噪声：噪声由这些试验估计，因此无法判定噪声是否过大",
    "more noise than declared at averages of 300 to 3600 s, and nothing in the channels explains it":
        "在300至3600 s的平均时间上噪声大于声明值，各通道均不能解释",
    "{effect}: the held-out runs show {slope} times what was predicted, more than chance: its form is not exact, or it "
    "changes from run to run":
        "{effect}：留出试验所示为预测值的{slope}倍，超出偶然范围：其形式不精确，或随试验而变",
    "a jump happens once: runs that were held out cannot confirm it": "跳变只发生一次：留出试验不能予以证实",
    "a line faster than two blocks of {block} s shows at a frequency folded into this band: the spectrum at the full "
    "sampling rate tells":
        "比两个{block} s数据块更快的谱线会折叠到本频带内：用全采样率的频谱判别",
    "the phase of a line is that of each run: no model predicts it, so that it is in the errors after as in those "
    "before, and in what is told as noise alone":
        "谱线的相位随试验而异：没有模型能预测，因此前后误差以及“仅噪声”中都含有它",
    "the runs differ by {scatter} (one standard deviation), {ratio} times the noise within them: {causes} differ "
    "between them, and {runs} runs cannot tell which it is":
        "各次试验相差{scatter}（一倍标准差），为试验内噪声的{ratio}倍：其间{causes}均不同，{runs}次试验无法区分",
    "the runs differ by {scatter} (one standard deviation), {ratio} times the noise within them: it was taken for "
    "turn-on scatter, which was not declared, so that what differs between runs alone can hide in it":
        "各次试验相差{scatter}（一倍标准差），为试验内噪声的{ratio}倍：已视为逐次启动散布（未声明），"
        "仅在试验之间变化的效应可能隐藏其中",
    "white noise N was declared as {declared} and is {measured} in these runs: declared and measured noise disagree":
        "白噪声N声明为{declared}，而这些试验中为{measured}：声明值与实测值不符",
    "less noise than declared at averages of 300 to 3600 s: its variance is {ratio} times the declared one, so that "
    "small effects may have been taken for noise":
        "在300至3600 s的平均时间上噪声小于声明值：其方差为声明值的{ratio}倍，较小的效应可能被当作噪声",
    "turn-on scatter was declared as {declared} and the runs scatter by {measured}: declared and measured noise "
    "disagree":
        "逐次启动散布声明为{declared}，而各次试验的散布为{measured}：声明值与实测值不符",
    "channel {name} is constant: its effects cannot be looked for": "通道{name}为常值：无法查找其效应",
    "channels {first} and {second} are copies of each other: their effects cannot be told apart":
        "通道{first}与{second}互为副本：其效应无法区分",
    "term {label} of the declared model cannot be determined from the fitted runs ({runs}): hold out other runs "
    "with --holdout runs=A,B, or leave the term out of the model":
        "由所拟合的试验（{runs}）无法确定声明模型的{label}项：用--holdout runs=A,B留出其他试验，或从模型中去掉该项",
    "term {label} of the declared model cannot be determined from the fitted runs ({runs}): measure runs that "
    "excite it, or leave the term out of the model":
        "由所拟合的试验（{runs}）无法确定声明模型的{label}项：请测量激励该项的试验，或从模型中去掉该项",
    "the held-out runs leave about the mean of each run {error} RMS over {seconds} s, where noise allows {noise}: the "
    "model does not hold there":
        "留出试验在{seconds} s平均时间上去除各次试验均值后均方根误差为{error}，而噪声仅允许{noise}：模型在该处不成立",
    "the held-out runs leave {error} RMS over {seconds} s, where noise allows {noise}: the model does not hold there":
        "留出试验在{seconds} s平均时间上均方根误差为{error}，而噪声仅允许{noise}：模型在该处不成立",
    "{effect}: the held-out runs do not excite it and can neither confirm nor refuse it (slope {slope}); hold out runs "
    "that do, as --holdout runs={runs}":
        "{effect}：留出试验未激励该效应，既不能证实也不能否定（斜率{slope}）；"
        "请留出能激励它的试验，如--holdout runs={runs}",
    "{effect}: the held-out runs do not excite it and can neither confirm nor refuse it (slope {slope}); measure more "
    "runs that excite it":
        "{effect}：留出试验未激励该效应，既不能证实也不能否定（斜率{slope}）；请测量更多激励它的试验",
    "{effect}: the held-out runs show {slope} times what was predicted: its form is likely not exact, or it changes "
    "from run to run":
        "{effect}：留出试验所示为预测值的{slope}倍：其形式可能不精确，或随试验而变",
    "the RMS error over {seconds} s in {runs} runs rises: {before} before and {after} after, about the mean of each "
    "run {mean_before} and {mean_after}":
        "{runs}次试验在{seconds} s平均时间上的均方根误差上升：之前{before}，之后{after}；去除各次试验均值后为"
        "{mean_before}和{mean_after}",
    "the RMS error over {seconds} s in {runs} runs does not change significantly: {before} before and {after} "
    "after, about the mean of each run {mean_before} and {mean_after}":
        "{runs}次试验在{seconds} s平均时间上的均方根误差无显著变化：之前{before}，之后{after}；去除各次试验均值后为"
        "{mean_before}和{mean_after}",
    "{gone} of {blocks} blocks left out: a channel of the declared model has no value there":
        "略去{blocks}个数据块中的{gone}个：声明模型所需的某通道在该处无值",
    "{gone} of {blocks} blocks left out: a channel has no value there":
        "略去{blocks}个数据块中的{gone}个：某通道在该处无值",
    "channel {name} not used: {reason}": "未使用通道{name}：{reason}",
    # reasons
    "unit {unit}, signal {signal}: none of {runs} runs has an Allan fit that describes it; noise is estimated from "
    "these runs alone, or give --noise":
        "产品{unit}，信号{signal}：{runs}次试验均无可用的Allan拟合；噪声仅由这些试验估计，或用--noise给出",
    "unit {unit}, signal {signal}: it was turned in all runs, whose Allan fits are of the motion; noise is "
    "estimated from these runs alone, or give --noise":
        "产品{unit}，信号{signal}：各次试验均在转动，其Allan拟合反映的是运动；噪声仅由这些试验估计，或用--noise给出",
    "unit {unit}: {reason}": "产品{unit}：{reason}",
    "{blocks} blocks with signal and channels of the model are there, {needed} are needed":
        "有信号及模型所需通道的数据块有{blocks}个，需要{needed}个",
    "the signal is {value} throughout, as of an output that is dead or stuck": "信号始终为{value}，如同输出失效或卡死",
    "without the runs held out: {reason}": "除去留出试验：{reason}",
    "no value in {bad} of {blocks} blocks of unit {unit}": "产品{unit}的{blocks}个数据块中有{bad}个无值",
    "no value in {bad} of {blocks} blocks": "{blocks}个数据块中有{bad}个无值",
    "{channels} does not vary in these runs": "{channels}在这些试验中不变化",
    "it moves by {spread} in these runs, too little to look for it": "在这些试验中其变化仅为{spread}，过小而无法查找",
    "channel {name} is not recorded there": "该处未记录通道{name}",
    "{lacking} lack channel {channels}: this diagnosis is of the other {runs} runs":
        "{lacking}缺少通道{channels}：本诊断只针对其余{runs}次试验",
    "it has no shape to try here": "此处没有可试的形状",
    "these runs cannot tell it from the terms of the model": "这些试验无法将其与模型的项区分",
    "channel {name} is missing in {missing} of {runs} runs": "{runs}次试验中有{missing}次缺少通道{name}",
    "channel {name} has no readings in these runs": "通道{name}在这些试验中没有读数",
    "channel {name} stays at {value} in these runs": "通道{name}在这些试验中保持为{value}",
    "channel {name} is nowhere frozen while it should move in these runs": "通道{name}在应当变化时从未停滞",
    "as given": "用户给定",
    "as given; turn-on scatter estimated from these runs": "用户给定；逐次启动散布由这些试验估计",
    "the unit's own Allan fits": "产品自身的Allan拟合",
    "the unit's own Allan fits; turn-on scatter estimated from these runs":
        "产品自身的Allan拟合；逐次启动散布由这些试验估计",
    # notes on the reduction
    "signal {name} never changes {where}: its output is dead or stuck; exclude such runs with --run":
        "信号{name}{where}从不变化，如同输出失效或卡死：用--run略去这些试验",
    "runs have the same samples ({runs}) and do not confirm each other; exclude one of each with --run":
        "试验的采样相同（{runs}）：不能互相证实；用--run各略去一次",
    "channel {name} is missing {where}: effects that need it are not searched for":
        "{where}缺少通道{name}：不查找需要它的效应",
    "channel {name} has no reading near {bad} of {blocks} blocks, {where}":
        "{where}，通道{name}在{blocks}个数据块中的{bad}个附近没有读数",
    "channel {name} never changes: its effects cannot be distinguished from the bias":
        "通道{name}从不变化：与它相关的效应看不到，也无法与零偏区分",
    "channel {name} is in {units}, depending on the run: import it in one unit of measure":
        "通道{name}的单位因试验而异（{units}）：请以同一单位导入",
    "channel {name} is in {unit}: coefficients are per {same}": "通道{name}的单位为{unit}：系数按每{same}计",
    "channels {first} and {second} are copies of each other: their effects cannot be distinguished":
        "通道{first}与{second}互为副本：二者的效应无法区分",
    "the clock of {one} is {seconds} s off that of {other} in run {runs}: its channels are joined by their own "
    "clock":
        "在试验{runs}中，{one}的时钟与{other}相差{seconds} s：其通道按自身时钟对齐",
    "{samples} samples are not finite {where}: left out": "{where}有{samples}个采样不是有限数：已略去",
    "{count} blocks or readings of {name} are left out {where}: outliers of up to {value}, as from a fill value, a "
    "transmission error or a shock":
        "{where}略去{name}的{count}个数据块或读数：离群值（最大为{value}），如填充值、传输误码或冲击所致",
    "samples are up to {apart} s apart {where}, blocks are {block} s long: most are empty, and the noise N is "
    "estimated too low; give blocks from {least} s on":
        "{where}采样间隔达{apart} s，而数据块长{block} s：多数数据块为空，噪声N偏低；数据块请取{least} s以上",
    "{count} blocks are left out {where}: they hold less than {share} of the usual number of samples":
        "{where}略去{count}个数据块：采样数不足通常的{share}",
    "no power-on is recorded in any of {runs} runs: time_since_power_on counts from the first sample":
        "{runs}次试验均无上电记录：time_since_power_on从首个采样起计",
    "no power-on is recorded in run {run}: time_since_power_on counts from the first sample":
        "试验{run}无上电记录：time_since_power_on从首个采样起计",
    "no power-on is recorded in {some} of {all} runs ({runs}): time_since_power_on counts from the first sample":
        "{all}次试验中有{some}次（{runs}）无上电记录：time_since_power_on从首个采样起计",
    "no power-on is recorded in {runs}: time_since_power_on counts from the first sample":
        "{runs}无上电记录：time_since_power_on从首个采样起计",
    "{count} blocks are left out {where}: the reference rate changes within them faster than its readings show; "
    "shorter blocks or more readings keep more":
        "{where}略去{count}个数据块：其中参考角速率的变化快于其读数所示；缩短数据块或增加读数可保留更多",
    "the unit was powered on several times {where}: each power-on counts as a run, RUN#1, RUN#2, ...":
        "{where}产品多次上电：每次上电计为一次试验，记作RUN#1、RUN#2……",
    "channel position stands for: {words}; positions differ by gravity, earth rate, magnetic field and mounting: only "
    "positions that were remounted several times show by which":
        "通道position代表：{words}；位置之间的差别可能是重力、地球自转与磁场或安装本身：只有多次重新安装的位置才能判别",
    "channel position stands for: {words}": "通道position代表：{words}",
    "blocks of {block} s hold {what}: the noise is estimated from the residual of the model alone":
        "{block} s数据块内没有离散（{what}）：噪声仅由模型残差估计",
    "{names} of {unit} are outputs like {signal} and not channels; import a reference under a standard name, such as "
    "gravity_i":
        "{unit}的{names}与{signal}同为产品输出：不作为通道；参考量请以标准名导入，如gravity_i",
    "channel {name} is taken from {of}; {others} have a channel of that name as well":
        "通道{name}取自{of}；{others}也给出同名通道",
    "no input_rate is recorded, and the axes {words} do not define the direction of the input axis: record or "
    "import channel input_rate":
        "未记录input_rate，转动轴{words}也未说明输入轴方向：没有输入角速率；请记录或以通道input_rate导入",
    "no input_rate is recorded, and the positions {words} do not define the direction of the input axis: record "
    "or import channel input_rate":
        "未记录input_rate，位置{words}也未说明输入轴方向：没有输入角速率；请记录或以通道input_rate导入",
    "input_rate is taken from {source} {where}: the table's axis is assumed to be the input axis unless the axis "
    "or position of a step says otherwise":
        "{where}input_rate取自{source}：除非步骤的转动轴或位置另有说明，假定转台轴沿输入轴",
    "{where} {names} is missing, which the model needs: left out": "{where}缺少模型所需的{names}：已略去",
    "signal {signal} is in {unit}: the noise terms are those of an angular rate":
        "信号{signal}的单位为{unit}：噪声各项是针对角速率的",
    "{count} units with enough data, {needed} are needed to pool": "数据足够的产品有{count}个，合并分析需要{needed}个",
    "the model was fitted to one run alone: what is tied to that run is in its terms, and no other run bears it out":
        "模型只由一次试验拟合：与该次试验相关的变化包含在各项中，没有其他试验予以证实",
    "{count} blocks are left out {where}: the reference rate changes within them faster than its readings show; "
    "record it more often than once in {interval}, or as means over the same times as the signal":
        "{where}有{count}个数据块因基准角速率变化快于其读数而略去；请以高于每{interval}一次的频度记录基准，或记录与信号同时段的均值",
    "{count} samples of {signal} are isolated outliers {where}, up to {times} times the noise: they raise N by up to "
    "{share}":
        "{where}，{signal}有{count}个孤立离群采样，最大为噪声的{times}倍：使N最多偏大{share}",
    "{signal} is {size} {name} {where}, both in the units they are labelled with, {how}: correct the label and "
    "import again, else every coefficient of {same} is wrong by this factor":
        "{where}，按所标单位，{signal}与{name}之比为{size}，疑为单位标注有误：请改正标注后重新导入，否则{name}的系数均差此倍数",
    # what was left out, and why
    "they hold but a few samples": "采样过少",
    "it has no value there; effects that read it are looked for where it has":
        "该处无值；在有值处查找读取该通道的效应",
    "channel {channels} has gaps: this diagnosis is of the blocks in which it has a value":
        "通道{channels}有缺段：本诊断只针对其有值的数据块",
    "where channel {channels} has a value, {effects} stands out as well": "在通道{channels}有值处，{effects}亦显著",
    "a reading of the signal lies far outside of those before and after it": "信号有读数远离其前后读数",
    "the reference rate changes within them faster than its readings show": "基准角速率在块内的变化快于其读数所能反映",
    "a channel of the declared model has no value there": "声明模型所需的某通道在该处无值",
    "a channel has no value there": "某通道在该处无值",
    # what is more general comes last
    "{share} of {what} left out: {reason}": "略去{what}的{share}：{reason}",
    "channel {name}: {reason}": "通道{name}：{reason}",
}  # fmt: skip

_WHERE: Final[Mapping[str, str]] = {
    "in run {run}": "在试验{run}中",
    "in {some} of {all} runs ({runs})": "在{all}次试验中的{some}次（{runs}）中",
    "in all {all} runs": "在全部{all}次试验中",
}

_WHAT: Final[Mapping[str, str]] = {
    "{count} blocks": "{count}个数据块",
    "all runs": "全部试验",
    "runs '{kind}'": "“{kind}”类试验",
    "runs {run} and the like": "{run}一类试验",
    "the excitation of {name}": "{name}的激励",
    "step {step} of run {run}": "试验{run}的步骤{step}",
    "the blocks of channel {channels}": "通道{channels}的数据块",
    "run {run}": "试验{run}",
}

_ANY_WHERE = r"in run \S+|in \d+ of \d+ runs \(.+?\)|in all \d+ runs"


def in_chinese(text: str) -> str:
    """A limit, a note or a reason in Chinese; as it is where it is not known.

    Examples
    --------
    >>> in_chinese("channel humidity is missing in 2 of 9 runs")
    '9次试验中有2次缺少通道humidity'
    >>> in_chinese("3 samples are not finite in run r1: left out")
    '在试验r1中有3个采样不是有限数：已略去'
    >>> in_chinese("something else")
    'something else'
    """
    return _translated(text, _SENTENCES) or text


def _translated(text: str, known: Mapping[str, str]) -> str | None:
    for english, chinese in known.items():
        if (match := _pattern(english).fullmatch(text)) is not None:
            parts = match.groupdict()
            if "where" in parts:
                parts["where"] = _translated(parts["where"], _WHERE)
            if "what" in parts:
                parts["what"] = _translated(parts["what"], _WHAT) or parts["what"]
            if "reason" in parts:
                parts["reason"] = in_chinese(parts["reason"])
            return chinese.format(**parts)
    return None


@cache
def _pattern(english: str) -> re.Pattern[str]:
    def part(name: re.Match[str]) -> str:
        return f"(?P<{name[1]}>{_ANY_WHERE if name[1] == 'where' else '.+?'})"

    return re.compile(re.sub(r"\\\{(\w+)\\\}", part, re.escape(english)))
