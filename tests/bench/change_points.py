"""False changes of level in noise that wanders, and steps that are found: ``python -m tests.bench.change_points``.

Beside three peers on the same series: Nelson's rules on an individuals chart (any rule met), ruptures' exact search
(``Pelt``, least squares) with the usual penalty of three times the logarithm of the points, which both take the points
as independent, and the likelihood ratio in first-order autoregressive noise, which knows no scatter beside the wander.
Steps are in standard deviations of a point, wander included, in the middle of the series. Asked is: at most 1.5 % false
at each correlation from 0 to 0.8.

``--calibrate`` simulates the quantiles behind the charges of `change_points`. ``--watch`` gives how often a steady
series ever alarms in 150 points, looked at after each second point, and after how many points a step is seen.
"""

import argparse
import sys
from collections.abc import Callable, Iterator

import numpy as np
from scipy.stats import binom

from analytics.trends.charts.control_chart import individuals_chart
from analytics.trends.charts.nelson_rules import rule_flags
from analytics.trends.levels.change_points import Changes, change_points, charge, clipped
from analytics.trends.levels.change_search import ChangeSearch
from analytics.trends.levels.level_watch import LevelWatch, level_watch
from analytics.trends.words import NotComputed
from stream.batch import FloatArray
from tests.bench.ar_ratio import ar_ratio, ar_threshold, autoregressive

CORRELATIONS = (0.0, 0.2, 0.4, 0.6, 0.8)
SLOW = ((0.8, 0.7), (0.9, 1.0), (0.9, 0.7), (0.95, 0.7))
MOST_FALSE = 0.015


def wandering(rng: np.random.Generator, series: int, n: int, correlation: float, share: float = 1.0) -> FloatArray:
    """Series of unit variance, a share of it an autoregressive wander and the rest scatter."""
    wander = autoregressive(rng, series, n, correlation)
    return np.asarray(np.sqrt(share) * wander + np.sqrt(1 - share) * rng.standard_normal((series, n)))


def ours(values: FloatArray) -> bool:
    """Whether `change_points` finds a change."""
    found = change_points(values)
    return isinstance(found, Changes) and bool(found.points)


def nelson(values: FloatArray) -> bool:
    """Whether any of Nelson's rules is met."""
    chart = individuals_chart(values)
    return not isinstance(chart, NotComputed) and bool(rule_flags((values - chart.centre) / chart.sigma).any())


def autoregressive_ratio(values: FloatArray) -> bool:
    """Whether the likelihood ratio of a change in autoregressive noise is beyond its 99 % quantile."""
    return bool(ar_ratio(values[None])[0] > ar_threshold(values.size))


def peers() -> dict[str, Callable[[FloatArray], bool]]:
    """Ways to find a change; ruptures where it is installed."""
    found: dict[str, Callable[[FloatArray], bool]] = {
        "gyrofleet": ours, "AR(1) ratio": autoregressive_ratio, "Nelson's rules": nelson
    }  # fmt: skip
    try:
        import ruptures  # type: ignore[import-not-found, import-untyped, unused-ignore]
    except ImportError:
        print("ruptures is not installed (pip install ruptures): left out")
        return found

    def pelt(values: FloatArray) -> bool:
        sigma = np.median(np.abs(np.diff(values))) / 0.954
        search = ruptures.Pelt(model="l2", min_size=4, jump=1).fit(values / sigma)
        return len(search.predict(pen=3 * np.log(values.size))) > 1

    return found | {"ruptures": pelt}


def compare(series: int) -> bool:
    """False changes and power of each; whether ours are as few as promised."""
    good = True
    ways = peers()
    for n in (30, 90):
        for correlation in CORRELATIONS:
            rng = np.random.default_rng([20261123, n, round(10 * correlation)])
            noise = wandering(rng, series, n, correlation)
            steps = {size: noise[: series // 4] + size * (np.arange(n) >= n // 2) for size in (2, 3, 4)}
            for name, way in ways.items():
                false = sum(way(each) for each in noise)
                power = ", ".join(
                    f"{size} sigma {100 * np.mean([way(each) for each in some]):3.0f} %" for size, some in steps.items()
                )
                share = f"false {100 * false / series:5.1f} %"
                print(f"{n} points, correlation {correlation}: {name:14s} {share}; found: {power}", flush=True)
                if way is ours:
                    good &= bool(false <= binom.isf(0.001 / 10, series, MOST_FALSE))
        for correlation, share_ in SLOW:
            rng = np.random.default_rng([20261124, n, round(100 * correlation), round(10 * share_)])
            noise = wandering(rng, series, n, correlation, share_)
            where = f"{n} points, correlation {correlation}, wander {100 * share_:.0f} % of the variance"
            for name, way in ways.items():
                false = sum(way(each) for each in noise)
                print(f"{where}: {name:14s} false {100 * false / series:5.1f} %", flush=True)
    return good


def quantiles(series: int) -> Iterator[str]:
    """Quantiles of the evidence in noise, and how often it exceeds the charges."""
    for n in (12, 16, 20, 30, 45, 90, 200, 600):
        for correlation, share in ((0.6, 1.0), (0.8, 1.0), (0.8, 0.7), (0.9, 0.7)):
            rng = np.random.default_rng([20261125, n, round(10 * correlation), round(10 * share)])
            found = []
            for values in wandering(rng, max(series * 30 // max(n, 30), 100), n, correlation, share):
                search = ChangeSearch(clipped(values))
                found.append([-np.inf if each is None else each.ratio for each in (search.one(), search.two())])
            evidence = np.array(found)
            exceeded = [
                100 * float(np.mean((evidence > [charge(1, n, a), charge(2, n, a)]).any(axis=1)))
                for a in (0.05, 0.01, 0.001)
            ]
            at = ", ".join(
                f"{each[0]:.1f} {each[1]:.1f}" for each in np.quantile(evidence, (0.95, 0.99, 0.999), axis=0)
            )
            rates = ", ".join(f"{each:.2f} %" for each in exceeded)
            yield (
                f"{n} points, correlation {correlation}, wander {100 * share:.0f} %, {len(evidence)} series: quantiles "
                f"of one and two at 95, 99, 99.9 %: {at}; exceeded at 5, 1, 0.1 %: {rates}"
            )


def alarm(values: FloatArray, start: int) -> int | None:
    """The number of points after which a watch first alarms."""
    for n in range(start, values.size + 1, 2):
        found = level_watch(values[:n])
        if isinstance(found, LevelWatch) and found.alarms(0.01):
            return n
    return None


def watch(series: int) -> Iterator[str]:
    """False alarms ever, and delays, of watches over 150 points."""
    for correlation in (*CORRELATIONS, 0.9, 0.95):
        rng = np.random.default_rng([20261126, round(100 * correlation)])
        noise = wandering(rng, series, 150, correlation)
        false = sum(alarm(each, 8) is not None for each in noise)
        late = [alarm(each + 3 * (np.arange(150) >= 60), 60) for each in noise[: series // 2]]
        delays = np.array([np.inf if each is None else each - 60 for each in late])
        middle, most = np.quantile(delays, [0.5, 0.9], method="higher")
        yield (
            f"correlation {correlation}: ever alarmed {100 * false / series:.1f} %; a step of 3 sigma after 60 points "
            f"is seen after {middle:.0f} points (median), {most:.0f} (90 %)"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--series", type=int, default=2000)
    parser.add_argument("--calibrate", action="store_true")
    parser.add_argument("--watch", action="store_true")
    args = parser.parse_args()
    if args.calibrate or args.watch:
        for line in (quantiles if args.calibrate else watch)(args.series):
            print(line, flush=True)
        return
    if not compare(args.series):
        sys.exit(f"failed: more than {100 * MOST_FALSE:.1f} % false changes")


if __name__ == "__main__":
    main()
