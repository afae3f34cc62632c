"""The command `gyrofleet attitude`: compensated angles of an attitude unit, and the errors of its attitude."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from analytics.commands.evaluation.metrics import language_option, opened_catalog
from storage.commands.stored_names import RUN, UNIT
from stream.terminal.console import counted, notes, print_json, reporting, results, store_option
from stream.terminal.result_table import ResultTable

if TYPE_CHECKING:
    from analytics.attitude.accuracy import AttitudeErrors, StepAccuracy

_TITLES = {
    "en": ("step", "position", "s", "errors of heading, pitch, roll (deg): as given", "compensated", "U (k = 2)"),
    "zh": ("步骤", "位置", "时长 s", "航向、俯仰、横滚误差(°)：补偿前", "补偿后", "U (k = 2)"),
}
_NONE = "\N{EN DASH}"


@click.command("attitude")
@store_option
@click.option("--unit", type=UNIT, required=True, help="The attitude unit.")
@click.option("--run", type=RUN, required=True, help="The run that is compensated.")
@click.option(
    "--calibration", "calibrated_in", type=RUN, multiple=True,
    help="Take K, B and L from these runs only; by default the last of each that the store has.",
)  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Rates and angles: FILE.parquet or .csv.")
@language_option
@reporting
def attitude(
    folder: Path, unit: str, run: str, calibrated_in: tuple[str, ...], out: Path | None, language: str, *,
    as_json: bool,
) -> None:  # fmt: skip
    """Compensate an attitude unit (JJF 1536), and state the errors of its attitude.

    A = inv(L)(N - B T): K, B and L are those that the procedures attitude_unit_* have measured. Of each step: what the
    axes turned, as given and compensated, against the table and the Earth; heading, pitch and roll at its end (annex
    B), their errors before and after compensation, and U of these.

    \b
    gyrofleet attitude --unit AHRS-1 --run 2026-11-21-A
    gyrofleet attitude --unit AHRS-1 --run 2026-11-21-A --out rates.parquet
    """  # noqa: D301  click's mark for lines that are not to be joined
    from analytics.attitude.accuracy import CompensatedStep, accuracy_of, compensated_steps
    from analytics.attitude.calibration import attitude_calibration
    from analytics.attitude.writing import write_compensated

    with opened_catalog(folder, quiet=as_json) as catalog:
        calibration = attitude_calibration(catalog, unit, calibrated_in)
        steps = compensated_steps(catalog, run, calibration)
    found = accuracy_of(steps, calibration)
    if out is not None:
        rows = write_compensated(
            [each for _, each in steps if isinstance(each, CompensatedStep)], calibration.axes, out
        )
        notes().print(f"{counted(rows, 'row')} written to {out}", soft_wrap=True)
    if as_json:
        print_json({"unit": unit, "run": run, "calibration": calibration, "steps": found})
        return
    table = ResultTable(*_TITLES[language], title=f"{unit}  {run}")
    for each in found:
        table.add_row(*_cells(each, language))
    results().print(table)


def _cells(found: "StepAccuracy", language: str) -> tuple[str, ...]:
    from analytics.evaluation.reasons import in_chinese

    head = (f"{found.index} {found.step}", found.position or "", f"{found.duration_s:.1f}")
    if found.compensated_error is None:
        reason = found.reason or ""
        return (*head, in_chinese(reason) if language == "zh" else reason, "", "")
    return (*head, *(_three(each) for each in (found.raw_error, found.compensated_error, found.expanded_deg)))


def _three(errors: "AttitudeErrors | None") -> str:
    if errors is None:
        return _NONE
    angles = errors.heading_deg, errors.pitch_deg, errors.roll_deg
    return "  ".join(_NONE if each is None else f"{each:.4f}" for each in angles)
