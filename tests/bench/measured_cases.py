"""Measured recordings, diagnosed as a user would: verdict, effects, error before and after, next test.

    .venv/bin/python -m tests.bench.measured_cases [--data ../shared/data] [--json]

Prints the table of the page on measured recordings. The recordings are not part of this project.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"
HIT_TABLE = Path(__file__).resolve().parents[1] / "golden" / "hit2012_table1.csv"
HIT_MODEL = "rate = bias + channel:table_rate + cross_axis_o + cross_axis_s + fixture_cos + fixture_sin"


class Case(NamedTuple):
    """A unit with its files, and the models that are declared for it."""

    unit: str
    files: str  # a pattern in the folder of the recordings
    models: tuple[str, ...]
    options: tuple[str, ...] = ()


CASES = (
    Case("ADIS16405", "adis16405_static_run*.parquet", ("rate_x = bias", "rate_y = bias", "rate_z = bias")),
    Case("MPU9150-0", "mpu9150_unit0.parquet", ("rate_x = bias",), ("--block", "1s")),
    Case("PSIM", "psim_cold_chamber.parquet", ("rate_x = bias + temperature", "rate_y = bias + temperature")),
    Case("BMI270", "bmi270_*.parquet", ("rate_x = bias", "rate_y = bias"), ("--block", "10s")),
    Case("MPU6050", "mpu6050_set-*.parquet", ("rate_x = bias", "rate_y = bias", "rate_z = bias"), ("--block", "5s")),
    Case("HIT-table-1", str(HIT_TABLE), (HIT_MODEL,)),
)


def asked(*words: object, cwd: Path) -> Any:
    """The JSON answer of a command."""
    command = [sys.executable, "-m", "gyrofleet", *map(str, words), "--json"]
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True)
    if not done.stdout:
        raise SystemExit(f"{' '.join(command)}: {done.stderr}")
    return json.loads(done.stdout)


def diagnosed(data: Path, folder: Path) -> Iterator[tuple[Case, str, dict[str, Any]]]:
    """Each case and model with its diagnosis."""
    for case in CASES:
        files = [case.files] if Path(case.files).is_absolute() else sorted(data.glob(case.files))
        asked("import", *files, "--unit", case.unit, "--store", "S", cwd=folder)
        for model in case.models:
            words = ("--unit", case.unit, "--model", model, "--store", "S", "--next-test", *case.options)
            yield case, model, asked("diagnose", *words, cwd=folder)


def row_of(case: Case, model: str, found: dict[str, Any]) -> tuple[str, ...]:
    """Cells of the table."""
    names = [each["name"] for each in found["effects"]]
    others = [each["name"] for each in found["confounded"]]
    effects = ", ".join(names) + (f"; or {', '.join(others)}" if others else "")
    if found["unreplicated"]:
        effects += f"{'; ' if effects else ''}once: {', '.join(each['name'] for each in found['unreplicated'])}"
    error = ""
    if found["error"] is not None and found["error"]["before"]:
        key = list(found["error"]["before"])[-1]
        parts = [found["error"][part][key] for part in ("before", "after", "floor")]
        error = f"{parts[0]:.3g}, {parts[1]:.3g}, {parts[2]:.3g} {found['error']['unit_of_measure']} ({key[4:]})"
    return case.unit, f"`{model}`", found["verdict"], effects, error, next_of(found["next_test"])


def next_of(asked_next: dict[str, Any] | None) -> str:
    """The cheapest plan, or why there is none."""
    if asked_next is None:
        return ""
    if not asked_next["plans"]:
        return f"none: {asked_next['why_not']}"
    plan = asked_next["plans"][0]
    return f"{plan['runs']} x {plan['what']}: {plan['hours']:g} h, power {plan['power']:.0%}"


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the recordings")
    parser.add_argument("--json", action="store_true", help="one line of JSON for each case")
    given = parser.parse_args(arguments)
    if not given.json:
        print("| unit | declared | verdict | effects | held-out error before, after, noise | next test |")
        print("|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as temporary:
        for case, model, found in diagnosed(given.data, Path(temporary)):
            if given.json:
                print(json.dumps({"unit": case.unit, "model": model} | found), flush=True)
            else:
                print("| " + " | ".join(row_of(case, model, found)) + " |", flush=True)


if __name__ == "__main__":
    main()
