"""What a reader of a spectrum must know of its record, in English and Chinese."""

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from stream.defects.stillness import remark_on_stillness

if TYPE_CHECKING:
    from analytics.curves.spectrum import SignalSpectrum

LEAST_APART_BINS = 6  # of two lines that are both found: at 5 bins of one with a third of the amplitude in 3 of 20
_LEAST_LEFT_OUT = 0.1  # of the segments
_STEADY_NOISE = 0.7  # share of the degrees of freedom
_WIDE_HUMP = 4.0
_SLOW_BINS = 4  # which sidelobes of slow noise may reach


def remarks_on(found: "SignalSpectrum") -> list[tuple[str, str]]:
    """All remarks: on the samples, on lines, on slow changes."""
    still = remark_on_stillness(found.longest_still, found.samples)
    parts = (_of_samples(found), _of_lines(found), _of_wide_humps(found), _of_slow_changes(found))
    return [*([still] if still else []), *((en, zh) for part in parts for en, zh in part)]


def _of_samples(found: "SignalSpectrum") -> Iterator[tuple[str, str]]:
    if found.repeated:
        share = f"{found.repeated * 100:.2g} %"
        en = (
            f"at least {share} of the samples repeat the one before, which resolution and noise do not explain: as of "
            "a logger that is faster than the gyro, or of lost samples written as the last one; lines above half the "
            "gyro's own rate are images, and humps may be of the repeats"
        )
        zh = (
            f"至少 {share} 的采样与前一采样完全相同，分辨率与噪声不能解释：如记录快于陀螺输出，或丢失的采样以上一值填充"
            "；高于陀螺自身速率一半的谱线为镜像，凸起可能由重复采样造成"
        )
        yield en, zh
    if found.piled:
        at = f"{found.piled_at:.4g} {found.unit_of_measure}"
        en = (
            f"about {found.piled:,} of {found.samples:,} samples are at one value or two, as at {at}: clipped at an "
            "end of the range, or lost samples written as it; lines at multiples of another, and part of the "
            "noise, may be of that"
        )
        zh = (
            f"{found.samples:,} 个采样中约有 {found.piled:,} 个集中于一两个数值（如 {at}）：输出在量程端被限幅，"
            "或丢失的采样以该值填充；倍频谱线和部分噪声可能由此产生"
        )
        yield en, zh
    if found.outliers:
        count, largest = f"{found.outliers:,}", f"{found.largest_outlier:.3g}"
        en = f"isolated outliers are left out: {count}, up to {largest} times the noise"
        yield en, f"已剔除 {count} 个孤立离群值，最大为噪声的 {largest} 倍"
    if found.bridged:
        count, most = f"{found.bridged:,}", f"{found.bridging_correction:.2g}"
        en = (
            f"missing samples in gaps of up to 3, outliers included, are bridged by straight lines: {count}; the "
            f"density is corrected for that, by a share of at most {most}"
        )
        zh = f"{count} 个缺失采样（含离群值，间断不超过 3 个采样）已线性内插；功率谱密度已据此修正，修正比例至多 {most}"
        yield en, zh
    if found.noise_share < _STEADY_NOISE:
        share = f"{found.noise_share:.0%}"
        en = (
            f"the noise or a strong line is not the same all the time: a bin has {share} of the degrees of freedom of "
            "steady noise, which limits and tests for lines and humps take into account"
        )
        yield en, f"噪声或强谱线随时间变化：每个频点的自由度为恒定噪声时的 {share}；界限及谱线、凸起的检验已计入此影响"
    segments, left_out = found.segments + found.segments_left_out, found.segments_left_out
    if left_out > _LEAST_LEFT_OUT * segments:
        share = f"{left_out / segments:.0%}"
        en = (
            f"{left_out:,} of {segments:,} segments ({share}) are left out for missing samples: the spectrum is of the "
            "others"
        )
        yield en, f"{segments:,} 段中有 {left_out:,} 段（{share}）因缺失采样而不计入：频谱仅为其余各段的结果"


def _of_lines(found: "SignalSpectrum") -> Iterator[tuple[str, str]]:
    moving = [line for line in found.lines if line.is_steady is False]
    if moving:
        where = ", ".join(f"{line.frequency_hz:.5g}" for line in moving)
        near = f"{LEAST_APART_BINS * found.bin_width_hz:.3g} Hz"
        en = (
            f"at {where} Hz there is not one steady sinusoid over the record: it moves or changes, or there "
            f"are several within {near}; the frequency is the centre of its power with the span that holds 95 % of "
            "that, the amplitude that of a sinusoid of all power in its band"
        )
        zh = (
            f"{where} Hz 处在整个记录中不是单一稳定正弦：其频率或幅值变化，或 {near} 内有多条谱线；"
            "频率为其功率的中心及含 95 % 功率的范围，幅值为其频带内全部功率对应的正弦幅值"
        )
        yield en, zh
    if any(math.isnan(line.amplitude_lo) for line in moving):
        yield (
            "a line that is not steady has no limits of its amplitude: too few bins beside it show the background",
            "不稳定的谱线没有幅值界限：其两侧显示背景的频点太少",
        )
    if found.narrow_hz:
        where = ", ".join(f"{each:.3g}" for each in found.narrow_hz)
        band = f"{found.searched_lo_hz:.4g}", f"{found.searched_hi_hz:.4g}"
        en = (
            f"near {where} Hz there is a peak as narrow as a line where none can be tested: lines are searched from "
            f"{band[0]} to {band[1]} Hz; a longer record widens that"
        )
        zh = (
            f"{where} Hz 附近有与谱线同样窄的峰，但该处无法检验：谱线搜索范围为 {band[0]} 至 {band[1]} Hz；"
            "更长的记录搜索范围更宽"
        )
        yield en, zh


def _of_wide_humps(found: "SignalSpectrum") -> Iterator[tuple[str, str]]:
    wide = [each for each in found.humps if each.frequency_hi_hz > _WIDE_HUMP * each.frequency_lo_hz]
    if wide:
        where = ", ".join(f"{each.frequency_lo_hz:.3g} .. {each.frequency_hi_hz:.3g}" for each in wide)
        en = (
            f"the hump of {where} Hz is wider than two octaves: no sum of power laws describes the density there, as "
            "where an output filter lowers it beyond the band; it need not be noise in excess"
        )
        zh = (
            f"{where} Hz 的凸起宽于两个倍频程：幂律之和不能描述该处的功率谱密度，如输出滤波器使频带以外的密度下降；"
            "不一定是多余的噪声"
        )
        yield en, zh


def _of_slow_changes(found: "SignalSpectrum") -> Iterator[tuple[str, str]]:
    if found.humps_lo_hz > _SLOW_BINS * found.bin_width_hz:
        below, span = f"{found.humps_lo_hz:.3g} Hz", f"{found.slow_span:.3g} {found.unit_of_measure}"
        en = (
            f"below {below} the density is in part of sidelobes, of slow changes of the output ({span}) or of a strong "
            "line: no hump is looked for there"
        )
        yield en, f"{below} 以下的功率谱密度部分来自旁瓣（输出的缓慢变化 {span}，或强谱线）：该处不搜索凸起"
