"""Group-sequential bounds for the Allan deviation: how far from its limit an unfinished test must be to end.

The table below was made by `table` and is checked against `calibrated`; ``tests/bench/early_decision.py --table``
prints it anew.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from stream.batch import FloatArray
from stream.estimators.confidence import edf

LOOKS = 24
PROMISES = (0.01, 0.05)
AVERAGES = (8, 16, 32, 64, 128, 256, 512, 1024)
RUNS = 200_000
SPENT_SHARE = 0.95
_SEED = 20261121
_STRIDE_PER_TAU = 8
_CHUNK = 1 << 19
_DIGITS = 1e4


class Bounds(NamedTuple):
    """Bounds of (value/limit)**2 at looks 1 .. 24: at or below `passes` it is PASS, at or above `fails` FAIL."""

    passes: tuple[float, ...]
    fails: tuple[float, ...]


NO_BOUNDS = Bounds((0.0,) * LOOKS, (math.inf,) * LOOKS)


@lru_cache(maxsize=256)
def bounds(final_edf: float, error_probability: float) -> Bounds:
    """Bounds for a test whose finished variance has `final_edf` degrees of freedom.

    Parameters
    ----------
    final_edf: Least equivalent degrees of freedom of the Allan variance when the test is finished.
    error_probability: One of `PROMISES`.

    Notes
    -----
    The column b of the table with the next fewer degrees nu0 is drawn in to nu degrees: above the limit b - 1,
    below it ln b, by sqrt(nu0/nu). Both err on the wide side: by Wilson and Hilferty (1931) the quantile z of chi2/nu
    is 1 + z sqrt(2/nu) + (2/3)(z**2 - 1)/nu + ..., hence sqrt(nu)(b - 1) and -sqrt(nu) ln b fall with nu. That holds
    at early looks too, whose degrees, about proportional to T - 2 tau, grow faster with T than those of the end.
    Fewer degrees than those of the first column (T = 8 tau) have no bounds: nothing is decided before the end.

    Examples
    --------
    >>> [round(side[11], 3) for side in bounds(400.0, 0.01)], bounds(2.0, 0.01) == NO_BOUNDS
    ([0.718, 1.342], True)
    """
    fitting = [i for i, column in enumerate(AVERAGES) if column_edf(column) <= final_edf]
    if not fitting:
        return NO_BOUNDS
    column = fitting[-1]
    shrink = math.sqrt(column_edf(AVERAGES[column]) / final_edf)
    passes, fails = _parsed()[error_probability]
    return Bounds(
        tuple(b**shrink for b in passes[:, column].tolist()),
        tuple(1.0 + (b - 1.0) * shrink for b in fails[:, column].tolist()),
    )


@lru_cache(maxsize=len(AVERAGES))
def column_edf(averages: int) -> float:
    """Degrees of freedom at the end of the test that a column of the table was calibrated on."""
    windows = (averages - 2) * _STRIDE_PER_TAU + 1
    return edf(-2, 2, _STRIDE_PER_TAU, windows, _STRIDE_PER_TAU)


def simulated_ratios(averages: int, runs: int = RUNS) -> FloatArray:
    """Allan variance over its true value at the 24 looks, in simulated tests of random walk FM.

    Parameters
    ----------
    averages: T/tau.
    runs: Simulated tests; the first of them do not depend on how many follow.

    Returns
    -------
    ndarray of float, shape (runs, 24)
        NaN where a look comes before the first pair of averages.

    Notes
    -----
    A walk of unit steps, eight to a tau. D is then 1/8 of a sum of steps with the weights 1, 2 .. 8 .. 2, 1, so that
    the true AVAR = E D**2 / 2 = (2 R**2 + 1)/(6 R), R = 8.
    Of the plausible noises random walk FM has the fewest degrees of freedom (`confidence.least_edf`), hence the widest
    scatter of the variance; bounds that keep their promise with it are wide for the others.
    """
    r = _STRIDE_PER_TAU
    samples = averages * r
    ends = np.arange(1, LOOKS + 1) * samples // LOOKS - 2 * r
    seen = ends >= 0
    rng = np.random.default_rng([_SEED, averages])
    ratios = np.full((runs, LOOKS), np.nan)
    chunk = max(1, _CHUNK // samples)
    for start in range(0, runs, chunk):
        part = ratios[start : start + chunk]
        walk = np.cumsum(rng.standard_normal((len(part), samples)), axis=1)
        integral = np.concatenate([np.zeros((len(part), 1)), np.cumsum(walk, axis=1)], axis=1)
        squares = np.square(integral[:, 2 * r :] - 2.0 * integral[:, r:-r] + integral[:, : -2 * r])
        part[:, seen] = np.cumsum(squares, axis=1)[:, ends[seen]] / (ends[seen] + 1.0)
    return ratios / (r * (2.0 * r**2 + 1.0) / 3.0)


def calibrated(ratios: FloatArray, error_probability: float) -> tuple[FloatArray, FloatArray]:
    """Bounds that spend the error probability as the square of the time passed.

    Returns
    -------
    tuple of ndarray
        Bounds for PASS and for FAIL at each look, to four digits behind the point; 0 and inf where nothing may be
        spent yet.

    Notes
    -----
    At look k the most extreme of the tests not yet decided are decided, as many as bring the share of wrong ones up to
    0.95 alpha (k/24)**2 (alpha spending, Lan and DeMets 1983). The twentieth that is never spent pays for
    the scatter of the calibration, 2 % of alpha = 0.01 at 200,000 runs. Sides are calibrated one without the other,
    which can only lower their errors.
    """
    both = []
    for outward in (-1.0, 1.0):
        alive = np.ones(len(ratios), np.bool_)
        side = np.full(LOOKS, math.inf if outward > 0.0 else 0.0)
        for look in range(LOOKS):
            allowed = SPENT_SHARE * error_probability * ((look + 1) / LOOKS) ** 2 * len(ratios)
            more = int(allowed) - int(np.count_nonzero(~alive))
            extreme = np.sort(outward * ratios[alive, look])
            if more <= 0 or np.isnan(extreme[-1]):
                continue
            side[look] = outward * math.ceil(extreme[-more] * _DIGITS) / _DIGITS + 0.0  # no minus zero
            alive &= outward * ratios[:, look] < outward * side[look]
        both.append(side)
    return both[0], both[1]


def table() -> str:
    """The table below, rebuilt: the PASS and FAIL bounds of each promise, looks down, T/tau across; 2 minutes."""
    columns = [simulated_ratios(averages) for averages in AVERAGES]
    lines = []
    for promise in PROMISES:
        for side in (0, 1):
            block = np.column_stack([calibrated(ratios, promise)[side] for ratios in columns])
            lines += [" ".join(f"{bound:8.4f}" for bound in row) for row in block.tolist()]
    return "\n".join(lines)


@lru_cache(maxsize=1)
def _parsed() -> dict[float, FloatArray]:
    numbers = np.array(_TABLE.split(), np.float64).reshape(len(PROMISES), 2, LOOKS, len(AVERAGES))
    return dict(zip(PROMISES, numbers, strict=True))


_TABLE = """
  0.0000   0.0000   0.0000   0.0003   0.0127   0.0588   0.1830   0.3312
  0.0000   0.0000   0.0008   0.0176   0.0899   0.2222   0.3673   0.5009
  0.0000   0.0000   0.0092   0.0581   0.1667   0.3196   0.4757   0.5969
  0.0000   0.0017   0.0232   0.0994   0.2440   0.3970   0.5306   0.6422
  0.0000   0.0048   0.0460   0.1500   0.3022   0.4610   0.5825   0.6898
  0.0000   0.0112   0.0753   0.1954   0.3496   0.5030   0.6216   0.7165
  0.0006   0.0201   0.1031   0.2356   0.3903   0.5307   0.6482   0.7417
  0.0020   0.0309   0.1276   0.2722   0.4320   0.5661   0.6734   0.7627
  0.0046   0.0467   0.1574   0.3061   0.4606   0.5892   0.6914   0.7768
  0.0071   0.0628   0.1794   0.3376   0.4864   0.6059   0.7125   0.7901
  0.0113   0.0780   0.2075   0.3643   0.5068   0.6302   0.7294   0.8019
  0.0163   0.0969   0.2326   0.3898   0.5316   0.6495   0.7434   0.8129
  0.0224   0.1152   0.2572   0.4132   0.5555   0.6683   0.7569   0.8228
  0.0296   0.1306   0.2791   0.4299   0.5714   0.6831   0.7668   0.8310
  0.0382   0.1498   0.2985   0.4506   0.5895   0.6975   0.7779   0.8394
  0.0476   0.1681   0.3200   0.4689   0.6045   0.7092   0.7862   0.8465
  0.0577   0.1840   0.3395   0.4852   0.6151   0.7184   0.7961   0.8518
  0.0681   0.1992   0.3589   0.5027   0.6261   0.7309   0.8029   0.8578
  0.0783   0.2159   0.3749   0.5182   0.6414   0.7367   0.8086   0.8618
  0.0881   0.2323   0.3910   0.5326   0.6531   0.7467   0.8159   0.8670
  0.1027   0.2478   0.4057   0.5442   0.6650   0.7548   0.8232   0.8720
  0.1138   0.2638   0.4203   0.5593   0.6742   0.7612   0.8283   0.8762
  0.1259   0.2775   0.4367   0.5714   0.6832   0.7697   0.8337   0.8803
  0.1374   0.2915   0.4475   0.5827   0.6934   0.7758   0.8386   0.8839
     inf      inf      inf  17.4195   8.7079   4.8169   3.3934   2.2412
     inf      inf  15.2274   7.3271   4.2819   2.8814   2.1823   1.7524
     inf  14.5419   9.3602   5.1454   3.1813   2.3371   1.8758   1.5797
     inf  12.7770   6.5795   3.8551   2.6397   2.0610   1.7010   1.4637
     inf   9.9769   5.1956   3.2480   2.3772   1.8987   1.5868   1.4005
 11.8528   7.6602   4.3399   2.9259   2.1731   1.7693   1.5087   1.3448
 11.2498   6.5290   3.7738   2.6511   2.0458   1.6777   1.4579   1.3072
 10.5264   5.5196   3.4160   2.4502   1.9366   1.6042   1.4107   1.2805
  9.4061   4.8582   3.1229   2.3635   1.8419   1.5622   1.3885   1.2598
  8.3569   4.3568   2.9420   2.2066   1.7812   1.5231   1.3568   1.2396
  7.4654   4.0158   2.7494   2.1015   1.7123   1.4815   1.3323   1.2220
  6.7035   3.6935   2.5822   2.0100   1.6670   1.4462   1.3088   1.2087
  6.0901   3.4383   2.4934   1.9401   1.6250   1.4182   1.2908   1.1970
  5.3882   3.2549   2.3828   1.8867   1.5975   1.3951   1.2755   1.1873
  4.9546   3.0654   2.2889   1.8315   1.5628   1.3744   1.2593   1.1782
  4.5798   2.9255   2.2099   1.7886   1.5218   1.3568   1.2437   1.1708
  4.2696   2.8129   2.1347   1.7377   1.5007   1.3438   1.2330   1.1627
  4.0077   2.7051   2.0696   1.6982   1.4775   1.3245   1.2237   1.1557
  3.7911   2.6059   2.0199   1.6716   1.4590   1.3114   1.2123   1.1501
  3.6484   2.5285   1.9815   1.6415   1.4391   1.2959   1.2044   1.1445
  3.4542   2.4499   1.9354   1.6130   1.4191   1.2853   1.1968   1.1390
  3.2923   2.3670   1.8859   1.5929   1.4015   1.2746   1.1894   1.1350
  3.1700   2.3073   1.8473   1.5712   1.3858   1.2683   1.1837   1.1289
  3.0573   2.2493   1.8185   1.5449   1.3722   1.2577   1.1761   1.1253
  0.0000   0.0000   0.0000   0.0008   0.0193   0.0896   0.2316   0.3718
  0.0000   0.0000   0.0019   0.0276   0.1175   0.2560   0.4031   0.5426
  0.0000   0.0000   0.0140   0.0838   0.2100   0.3631   0.5122   0.6287
  0.0000   0.0035   0.0396   0.1397   0.2917   0.4482   0.5783   0.6840
  0.0000   0.0091   0.0698   0.1982   0.3619   0.5065   0.6262   0.7246
  0.0000   0.0205   0.1049   0.2491   0.4103   0.5498   0.6642   0.7526
  0.0019   0.0358   0.1407   0.2942   0.4532   0.5882   0.6940   0.7755
  0.0046   0.0536   0.1794   0.3376   0.4901   0.6181   0.7164   0.7956
  0.0094   0.0767   0.2134   0.3763   0.5210   0.6432   0.7382   0.8105
  0.0153   0.1011   0.2483   0.4098   0.5513   0.6677   0.7571   0.8240
  0.0232   0.1250   0.2799   0.4407   0.5782   0.6872   0.7744   0.8353
  0.0340   0.1502   0.3101   0.4675   0.5992   0.7054   0.7875   0.8451
  0.0451   0.1735   0.3369   0.4913   0.6188   0.7218   0.7989   0.8549
  0.0580   0.1972   0.3652   0.5138   0.6396   0.7370   0.8091   0.8623
  0.0743   0.2208   0.3893   0.5324   0.6556   0.7484   0.8192   0.8697
  0.0905   0.2449   0.4136   0.5548   0.6713   0.7617   0.8281   0.8764
  0.1067   0.2665   0.4343   0.5722   0.6863   0.7721   0.8364   0.8822
  0.1256   0.2881   0.4537   0.5897   0.6996   0.7825   0.8443   0.8880
  0.1427   0.3092   0.4717   0.6061   0.7126   0.7912   0.8505   0.8928
  0.1602   0.3300   0.4911   0.6217   0.7246   0.8004   0.8567   0.8973
  0.1787   0.3486   0.5080   0.6367   0.7357   0.8079   0.8630   0.9017
  0.1962   0.3673   0.5251   0.6494   0.7466   0.8153   0.8680   0.9059
  0.2134   0.3867   0.5394   0.6623   0.7565   0.8230   0.8730   0.9094
  0.2308   0.4031   0.5546   0.6741   0.7651   0.8296   0.8783   0.9134
     inf      inf      inf  14.6201   7.4755   4.3131   2.9485   2.1673
     inf      inf  11.7635   6.3228   3.6946   2.6467   2.0361   1.6577
     inf  11.3969   7.5078   4.1258   2.7842   2.1216   1.7395   1.5039
     inf   9.7949   5.3809   3.3051   2.3600   1.9137   1.5903   1.3948
     inf   7.9149   4.2108   2.8242   2.1264   1.7491   1.4989   1.3337
  8.9180   6.1742   3.5921   2.5134   1.9599   1.6284   1.4319   1.2872
  8.3737   4.9993   3.1554   2.3043   1.8476   1.5436   1.3810   1.2568
  7.8058   4.3046   2.8554   2.1448   1.7477   1.4949   1.3400   1.2328
  6.9285   3.8050   2.6094   2.0204   1.6738   1.4531   1.3103   1.2134
  6.1241   3.4599   2.4502   1.9214   1.6151   1.4130   1.2841   1.1958
  5.3906   3.1547   2.3016   1.8445   1.5641   1.3806   1.2641   1.1808
  4.7054   2.9292   2.1722   1.7675   1.5162   1.3525   1.2425   1.1675
  4.2596   2.7415   2.0854   1.7112   1.4811   1.3277   1.2265   1.1569
  3.8652   2.5745   2.0038   1.6553   1.4484   1.3048   1.2120   1.1479
  3.5455   2.4551   1.9340   1.6183   1.4200   1.2881   1.1998   1.1403
  3.2997   2.3368   1.8684   1.5747   1.3917   1.2727   1.1879   1.1325
  3.1235   2.2396   1.8102   1.5434   1.3733   1.2583   1.1785   1.1247
  2.9413   2.1670   1.7590   1.5119   1.3522   1.2447   1.1682   1.1185
  2.7699   2.0819   1.7185   1.4876   1.3343   1.2308   1.1598   1.1134
  2.6420   2.0109   1.6787   1.4625   1.3169   1.2193   1.1521   1.1078
  2.5315   1.9588   1.6399   1.4390   1.3012   1.2098   1.1455   1.1030
  2.4160   1.8980   1.6005   1.4173   1.2871   1.2007   1.1389   1.0976
  2.3260   1.8491   1.5734   1.3982   1.2736   1.1899   1.1327   1.0936
  2.2440   1.8071   1.5428   1.3780   1.2603   1.1822   1.1273   1.0898
"""
