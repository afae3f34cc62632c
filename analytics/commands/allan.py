"""The command `gyrofleet allan`: deviations and noise coefficients of a recorded signal, also over a rolling window."""

from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from storage.commands.stored_names import RUN, SIGNAL, UNIT
from stream.errors import BadInput
from stream.terminal.console import notes, print_json, reporting, results, store_option
from stream.terminal.result_table import ResultTable

if TYPE_CHECKING:
    from analytics.curves.allan_curve import AllanCurve, Overlap
    from analytics.curves.noise_coefficients import NoiseCoefficients
    from storage.sql.catalog import Catalog
    from stream.defects.outliers import IsolatedOutliers
    from stream.estimators.base import NoEstimate

_DEVIATIONS = ("adev", "oadev", "mdev", "hdev", "ohdev")


@click.command("allan")
@click.option("--unit", type=UNIT, required=True, help="Which unit.")
@click.option("--signal", type=SIGNAL, required=True, help="Which of its signals, as rate or rate_x.")
@click.option("--run", type=RUN, help="Which run; by default the one with the longest record.")
@store_option
@click.option(
    "--points-per-octave", type=click.Choice(["1", "2", "4", "8"]), default="1", show_default=True,
    help="Averaging times in an octave.",
)  # fmt: skip
@click.option("--tau", "taus", metavar="SECONDS,...", help="These averaging times, as 10,100,1000.")
@click.option(
    "--deviation", "kind", type=click.Choice(_DEVIATIONS), default="oadev", show_default=True,
    help="Allan, overlapping Allan, modified Allan, Hadamard or overlapping Hadamard (blind to a steady drift).",
)  # fmt: skip
@click.option(
    "--overlap",
    type=click.Choice(["full", "strided"]),
    help="Every window, the default up to a million samples, or one every 1/16 of the averaging time, as in live "
    "estimates.",
)
@click.option("--resample", "resample_s", type=float, help="Take means of blocks of so many seconds first.")
@click.option("--plot", "plot_path", type=click.Path(path_type=Path), help="Draw the curve: FILE.png or FILE.svg.")
@click.option(
    "--compare", multiple=True, metavar="UNIT", help="Draw this unit beside it, lightly; 'all' for every one."
)
@click.option(
    "--limits", "limits_path", type=click.Path(path_type=Path), help="Draw the limits of this specification file."
)
@click.option("--fit", is_flag=True, help="Fit the noise coefficients of IEEE 952 to the curve; drawn in with --plot.")
@click.option("--rolling", "window_h", type=float, metavar="HOURS", help="The same over a rolling window.")
@click.option("--step", "step_h", type=float, metavar="HOURS", help="Step of the rolling window, by default 1/8 of it.")
@reporting
def allan(
    unit: str, signal: str, run: str | None, folder: Path, points_per_octave: str, taus: str | None, kind: str,
    overlap: "Overlap | None", resample_s: float | None, plot_path: Path | None, compare: tuple[str, ...],
    limits_path: Path | None, window_h: float | None, step_h: float | None, *, fit: bool, as_json: bool,
) -> None:  # fmt: skip
    """Allan deviation of a recorded signal, or another deviation, with 95 % confidence bounds.

    Drawn limits are those of a specification (`gyrofleet limits --help`) on allan_deviation and angle_random_walk.
    """
    from analytics.curves.allan_curve import allan_curve
    from storage.specifications.live_limits import live_limits
    from storage.specifications.specification import parse_specification, read_specification
    from storage.sql.catalog import Catalog
    from storage.store import Store
    from stream.estimators.full_overlap.deviation_forms import Deviation

    deviation = Deviation(kind)
    if plot_path is None and (compare or limits_path):
        raise BadInput("--compare and --limits are drawn: give --plot FILE.png or FILE.svg as well")
    if deviation is not Deviation.OVERLAPPING_ALLAN and (fit or limits_path or window_h is not None):
        raise BadInput(f"--fit, --limits and --rolling are of the overlapping Allan deviation; leave out {deviation}")
    if step_h is not None and window_h is None:
        raise BadInput("--step is by how much a window rolls: give --rolling HOURS as well")
    if window_h is not None:
        if fit or compare or limits_path or resample_s or overlap or taus:
            raise BadInput("--rolling goes with --step, --points-per-octave and --plot only")
        _rolling(folder, (unit, signal, run), (window_h, step_h), int(points_per_octave), plot_path, as_json=as_json)
        return
    taus_s = _seconds(taus)
    limits = []
    if limits_path is not None:
        specified = parse_specification(read_specification(limits_path), str(limits_path)).limits
        limits = [each for limit in specified for each in live_limits(limit, [signal])]
    with _working(as_json=as_json), Catalog(Store.open(folder)) as catalog:

        def curve_of(unit: str, run: str | None) -> "AllanCurve":
            return allan_curve(
                catalog, unit, signal, run, points_per_octave=int(points_per_octave), resample_s=resample_s,
                deviation=deviation, overlap=overlap, taus_s=taus_s,
            )  # fmt: skip

        curve = curve_of(unit, chosen_run(catalog, unit, signal, run))
        others = [curve_of(each, in_run) for each, in_run in _fleet(catalog, curve, compare)]
        found, outliers = _noise(catalog, curve) if fit else (None, None)
    if plot_path is not None:
        from analytics.plots.allan_plot import plot_allan
        from stream.estimators.base import NoEstimate

        drawn = None if isinstance(found, NoEstimate) or (found is not None and not found.describes) else found
        plot_allan([*others, curve], plot_path, limits=limits, chosen=unit if others else None, found=drawn)
    _show(curve, found, outliers, as_json=as_json)
    if plot_path is not None and not as_json:
        notes().print(f"plot: {plot_path}")


def chosen_run(catalog: "Catalog", unit: str, signal: str, run: str | None) -> str:
    """The run of a signal, by default that of its longest record; a note says which of several was taken."""
    from storage.sql.reading import find_signal

    record = find_signal(catalog, unit, signal, run)
    if record.runs > 1:
        text = f"run {record.run}: the longest record of {record.runs} runs; --run chooses another"
        notes().print(text, soft_wrap=True)
    return record.run


def _seconds(taus: str | None) -> tuple[float, ...]:
    try:
        found = tuple(float(each) for each in (taus or "").split(",") if each.strip())
    except ValueError:
        found = (-1.0,)
    if (taus is not None and not found) or not all(0.0 < each < float("inf") for each in found):
        raise BadInput(f"--tau {taus!r}: averaging times in seconds are expected, as 10,100,1000")
    return found


def _working(*, as_json: bool) -> AbstractContextManager[object]:
    return nullcontext() if as_json else notes().status("evaluating (some seconds longer the first time)")


def _show(
    curve: "AllanCurve", found: "NoiseCoefficients | NoEstimate | None", outliers: "IsolatedOutliers | None", *,
    as_json: bool,
) -> None:  # fmt: skip
    from analytics.curves.noise_coefficients import curve_document, noise_table
    from stream.estimators.base import NoEstimate

    if as_json:
        print_json(curve.document() if found is None else curve_document(curve, found, outliers))
        return
    results().print(_curve_table(curve))
    if curve.remark is not None:
        results().print("warning (警告): " + " ".join(curve.remark), soft_wrap=True)
    if isinstance(found, NoEstimate):
        results().print(f"No noise coefficients (无噪声系数): {found.reason}", soft_wrap=True)
    elif found is not None:
        results().print(noise_table(curve, found))
        if outliers is not None and outliers.is_worth_a_word:
            text = f"warning (警告): {outliers.sentence} (孤立离群值使N偏大)"
            results().print(text, soft_wrap=True)


def _rolling(
    folder: Path, which: tuple[str, str, str | None], hours: tuple[float, float | None], points_per_octave: int,
    plot_path: Path | None, *, as_json: bool,
) -> None:  # fmt: skip
    from analytics.curves.rolling_allan import rolling_allan
    from storage.sql.catalog import Catalog
    from storage.store import Store

    window_h, step_h = hours
    with _working(as_json=as_json), Catalog(Store.open(folder)) as catalog:
        unit, signal, run = which
        surface = rolling_allan(
            catalog, unit, signal, chosen_run(catalog, unit, signal, run), window_s=window_h * 3600,
            step_s=(window_h / 8 if step_h is None else step_h) * 3600,
            points_per_octave=points_per_octave,
        )  # fmt: skip
    if plot_path is not None:
        from analytics.plots.rolling_plot import plot_rolling

        plot_rolling(surface, plot_path)
    if as_json:
        print_json(asdict(surface))
        return
    results().print(surface.table())
    if plot_path is not None:
        notes().print(f"plot: {plot_path}")


def _noise(catalog: "Catalog", curve: "AllanCurve") -> "tuple[NoiseCoefficients | NoEstimate, IsolatedOutliers | None]":
    from analytics.curves.isolated_outliers import isolated_outliers
    from analytics.curves.noise_coefficients import noise_coefficients
    from analytics.curves.normalised_walk import normalised_walk
    from storage.sql.reading import find_signal
    from stream.estimators.base import NoEstimate

    record = find_signal(catalog, curve.unit, curve.signal, curve.run)
    found = noise_coefficients(curve, normalised_walk(catalog, record))
    return found, None if isinstance(found, NoEstimate) else isolated_outliers(catalog, record)


def _fleet(catalog: "Catalog", curve: "AllanCurve", compare: tuple[str, ...]) -> list[tuple[str, str | None]]:
    """Units to draw beside a curve, and of which run: those named, or all that have the signal.

    A unit that was not in the run of the curve, as one imported from its own file, is drawn with its longest record.
    """
    sql = "select unit, bool_or(run = $run) from signals where signal = $signal group by unit order by unit"
    held = {str(unit): bool(both) for unit, both in catalog.rows(sql, {"run": curve.run, "signal": curve.signal})}
    units = list(held) if "all" in compare else list(dict.fromkeys(compare))
    return [(unit, curve.run if held.get(unit) else None) for unit in units if unit != curve.unit]


def _curve_table(curve: "AllanCurve") -> ResultTable:
    table = ResultTable(
        title=f"{curve.names[0]} ({curve.names[1]}) of {curve.unit} {curve.signal}, run {curve.run}",
        caption=f"{curve.samples:,} samples every {curve.sample_interval_s:g} s, {curve.missing:,} missing; "
        f"{curve.overlap} overlap; limits: 95 % confidence, least degrees of freedom of the plausible noises α "
        "(2 quantization, 1 flicker of angle, 0 angle random walk, -1 bias instability, -2 rate random walk)",
    )
    for title in ("tau s", f"deviation {curve.unit_of_measure}", "from", "to", "degrees of freedom", "noise α"):
        table.add_column(title, justify="right")
    noises = [" ".join(map(str, noise)) for noise in curve.plausible] or [""] * len(curve.tau_s)
    for tau_s, *values, edf, noise in zip(curve.tau_s, curve.adev, curve.lo, curve.hi, curve.edf, noises, strict=True):
        table.add_row(f"{tau_s:g}", *(f"{value:.5g}" for value in values), f"{edf:,.1f}", noise)
    return table
