"""What missing samples do to an Allan curve: scattered ones at all averaging times, one gap only at long ones."""

from typing import NamedTuple

from stream.estimators.base import LEAST_SHARE, held_share

_WORTH_A_WORD = 0.01  # of all samples


class Shortfall(NamedTuple):
    """Samples that a record lacks, in numbers of samples."""

    samples: int  # that are there
    missing: int
    longest_gap: int

    @property
    def is_one_gap(self) -> bool:
        """Whether next to nothing is missing beside the longest gap."""
        return self.missing - self.longest_gap < _WORTH_A_WORD * (self.samples + self.missing)

    def remark(self, interval_s: float, longest_tau_s: float) -> tuple[str, str]:
        """What a reader must know, in English and Chinese.

        >>> Shortfall(95, 5, 1).remark(1.0, 16.0)[0].partition(", which")[0]
        '5.0% of the samples are missing: white noise may be shown up to 2.6% too high'
        >>> Shortfall(900, 100, 100).remark(1.0, 256.0)[0].partition(": ")[2]
        'averages that lack more than a tenth are left out, the others are hardly changed'
        """
        share = self.missing / (self.samples + self.missing)
        if self.is_one_gap:
            return self._of_gap(share, self.longest_gap * interval_s, longest_tau_s)
        excess = held_share(self.samples, self.missing) ** -0.5 - 1.0
        return (
            f"{share:.1%} of the samples are missing: white noise may be shown up to {excess:.1%} too high, which the "
            "lower bounds allow for; angle quantisation looks like white noise then, which they do not"
        ), f"缺失 {share:.1%} 的采样：白噪声可能偏高至多 {excess:.1%}，置信下限已计入；角度量化此时形同白噪声，未计入"

    def _of_gap(self, share: float, gap_s: float, longest_tau_s: float) -> tuple[str, str]:
        beyond_s, excess = gap_s / (1.0 - LEAST_SHARE), LEAST_SHARE**-0.5 - 1.0
        where = (
            f"{share:.1%} of the samples are missing, nearly all in one gap of {gap_s:g} s: averages that lack more "
            "than a tenth are left out"
        )
        where_zh = f"缺失 {share:.1%} 的采样，几乎全部在一个 {gap_s:g} s 的间断中：缺失超过十分之一的平均不计入"
        if longest_tau_s < beyond_s:
            return f"{where}, the others are hardly changed", f"{where_zh}，其余几乎不受影响"
        return (
            f"{where}; at averaging times from {beyond_s:g} s on they span the gap, and white noise may be shown up to "
            f"{excess:.1%} too high"
        ), f"{where_zh}；平均时间自 {beyond_s:g} s 起跨越该间断，白噪声可能偏高至多 {excess:.1%}"


def shortfall_of(samples: int, missing: int, longest_gap: int) -> Shortfall | None:
    """The shortfall of a record; None if few samples are missing.

    >>> shortfall_of(999, 1, 1) is None, shortfall_of(95, 5, 5).is_one_gap
    (True, True)
    """
    return Shortfall(samples, missing, longest_gap) if missing >= _WORTH_A_WORD * (samples + missing) else None
