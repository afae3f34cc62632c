"""The closed loop from files to verdict: campaigns written as CSV files of means, imported and diagnosed by commands.

    python -m tests.bench.loop_files [--means 10,30,60] [--rows planted,null] [--count 1] [--first 0] [--z 10]
        [--only gravity_o,...] [--results FILE.jsonl] [--processes 2] [--minutes 600] [--keep FOLDER]

From the root of the checkout. A campaign is fifteen runs of six hours, one file a run: the mean of the gyro over each
interval, the means of all channels, and the angle of the table read once in an interval, from 0 to 360 degrees.
`gyrofleet import` and `gyrofleet diagnose` see nothing but these files and the declared model and noise. Effects are
planted with the size at which the ideal fit sees them with significance z; the row ``null`` has nine misspecified
noises and no effect. Each campaign is one line of JSON in the file of results; those there already do not run again.
"""

import argparse
import json
import multiprocessing
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import polars as pl
from click.testing import CliRunner

from analytics.loop.blocks.run_blocks import RunBlocks
from analytics.loop.effects.registry import effect
from stream.errors import GyrofleetError
from tests.bench.loop_campaign import DECLARED_MODEL, Campaign
from tests.bench.tracing_cases import DECLARED, Case, built, cases
from tests.bench.tracing_tables import judged

NOT_IN_FILES = ("position", "day")
_RIGHT = ("exact", "in_set")
_CONFIRMED = ("effect_found", "confounded")
"""Verdicts that name an effect which held-out runs confirm; what they do not is `unreplicated`."""
_TOLD_LEFT_OUT = 6
_FINE_S = 10.0


class FileCase(NamedTuple):
    """One campaign and the interval of its means, seconds."""

    case: Case
    mean_s: float

    @property
    def key(self) -> str:
        """What tells it from all others."""
        return f"{self.case.key}/{self.mean_s:g}s"


def written(folder: Path, campaign: Campaign, runs: Sequence[RunBlocks], mean_s: float) -> list[Path]:
    """Files of a campaign; the runs' blocks of ten seconds are averaged to the interval."""
    paths = []
    for number, run in enumerate(runs):
        parts = round(mean_s / run.block_s)
        whole = run.value.size // parts * parts

        def mean(values: Any, parts: int = parts, whole: int = whole) -> Any:
            return np.asarray(values)[:whole].reshape(-1, parts).mean(axis=1)

        columns = {"time[s]": run.t0_ns / 1e9 + mean_s * np.arange(whole // parts), "rate[deg/h]": mean(run.value)}
        for name, channel in run.channels.items():
            if name not in NOT_IN_FILES and name != "table_angle":
                columns[f"{name}[{channel.unit_of_measure}]"] = mean(channel.mean)
        drive = campaign.drives[number]
        read_at = np.round(mean_s * np.arange(whole // parts) / campaign.step_s).astype(int)
        columns["table_angle[deg]"] = drive.read["table_angle"][read_at] % 360.0
        path = folder / f"{run.run}.csv"
        pl.DataFrame(columns).write_csv(path, float_precision=7)
        paths.append(path)
    return paths


def answered(folder: Path, paths: Sequence[Path], block_s: float) -> dict[str, Any]:
    """What `gyrofleet diagnose` says of the files, once they are imported."""
    from gyrofleet import main

    noise = f"N={DECLARED.N},B={DECLARED.B},K={DECLARED.K},turn_on={DECLARED.turn_on}"
    ask = ("--model", f"rate = {DECLARED_MODEL}", "--noise", noise, "--block", f"{block_s:g}s", "--json")
    store = ("--store", str(folder / "store"))
    _done(main, ["import", *map(str, paths), "--unit", "FOG-0231", *store])
    answer: dict[str, Any] = json.loads(_done(main, ["diagnose", "--unit", "FOG-0231", *ask, *store]))
    return answer


def _done(command: Any, words: list[str]) -> str:
    done = CliRunner().invoke(command, words)
    if done.exit_code != 0:
        raise RuntimeError(f"{' '.join(words[:1])}: {done.stderr[-2000:]} {done.exception!r}")
    return done.stdout


def traced(which: FileCase) -> dict[str, Any]:
    """Write, import and diagnose one campaign, and judge what was said."""
    began = time.perf_counter()
    made = built(which.case)
    fine = Campaign(which.case.seed, block_s=_FINE_S)  # the same drives
    noise = which.case.name if which.case.row == "null" else ""
    runs = fine.runs(made.planted, misspecified=noise, noise_seed=which.case.noise_seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        paths = written(folder, fine, runs, which.mean_s)
        said = answered(folder, paths, max(30.0, which.mean_s))
    truth = [each.effect for each in made.planted]
    return {
        "key": which.key,
        "row": which.case.row,
        "name": which.case.name,
        "mean_s": which.mean_s,
        "truth": truth,
        "outcome": outcome(truth, said),
        "verdict": said["verdict"],
        "found": [{"name": each["name"], "confounded": _beside(each["name"], said)} for each in said["effects"]],
        "refused": [each["name"] for each in said["unreplicated"]],
        "limits": said["limits"][:_TOLD_LEFT_OUT],
        "left_out": said.get("left_out", [])[:_TOLD_LEFT_OUT],
        "gain": (said.get("error") or {}).get("gain"),
        "seconds": round(time.perf_counter() - began, 1),
    }


def outcome(truth: Sequence[str], said: dict[str, Any]) -> str:
    """exact, in_set, part, beside, wrong, or the verdict where no effect is named."""
    effects = said["effects"]
    if not effects:
        return str(said["verdict"])
    hit = [each for each in effects if any(_means(each, name, said) for name in truth)]
    met = [name for name in truth if any(_means(each, name, said) for each in effects)]
    if len(hit) == len(effects) and len(met) == len(truth) and truth:
        is_exact = {each["name"] for each in effects} == set(truth) and not said["confounded"]
        return "exact" if is_exact else "in_set"
    if hit:
        return "beside" if len(hit) < len(effects) else "part"
    driven = {channel for name in truth for channel in effect(name).needs}
    channels = {channel for each in effects for channel in each["unknown_function_of"]}
    return "unknown" if channels & driven else "wrong"


def _means(found: dict[str, Any], truth: str, said: dict[str, Any]) -> bool:
    """Whether a finding names the truth; a free function may be found as an effect of its channel alone."""
    names = (found["name"], *_beside(found["name"], said))
    if truth in (*names, *found["companions"]):
        return True
    needs = effect(truth).needs
    if not truth.startswith("function_of"):
        return False
    driven = {("time_since_power_on",) if name == "drift_in_run" else _needs(name) for name in names}
    return needs[0] in found["unknown_function_of"] or needs in driven


def _needs(name: str) -> tuple[str, ...]:
    """Channels of an effect; none of what is no effect of the library, such as a cause that nobody recorded."""
    try:
        return effect(name).needs
    except GyrofleetError:
        return ()


def _beside(name: str, said: dict[str, Any]) -> list[str]:
    """What the data cannot tell from a finding."""
    return [other["name"] for other in said["confounded"] if other["beside"] == name]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--means", default="10,30,60")
    parser.add_argument("--rows", default="planted,null")
    parser.add_argument("--count", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--z", type=float, default=10.0)
    parser.add_argument("--only", default="")
    parser.add_argument("--results", type=Path, default=Path("loop_files.jsonl"))
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=600.0)
    asked = parser.parse_args()
    only = [name for name in asked.only.split(",") if name]
    wanted = [
        FileCase(case, float(mean_s))
        for row in asked.rows.split(",")
        for mean_s in asked.means.split(",")
        for case in cases(row, asked.count, [asked.z], only, first=asked.first)
    ]
    lines = run(wanted, asked.results, processes=asked.processes, minutes=asked.minutes)
    sys.exit(0 if reported(lines, len(wanted)) else "a target is missed")


def run(wanted: Sequence[FileCase], results: Path, *, processes: int, minutes: float) -> list[dict[str, Any]]:
    """Trace what has not been traced yet, append it to the results, and return the lines of all that was wanted."""
    done = {}
    if results.exists():
        done = {line["key"]: line for line in map(json.loads, results.read_text().splitlines())}
    until = time.monotonic() + 60.0 * minutes
    waiting = [each for each in wanted if each.key not in done]
    with multiprocessing.get_context("spawn").Pool(processes) as pool, results.open("a") as file:
        for line in pool.imap_unordered(partial(_in_time, until=until), waiting):
            if line is not None:
                file.write(json.dumps(line) + "\n")
                file.flush()
                done[line["key"]] = line
                print(f"{line['key']:60} {line['outcome']:16} {line['seconds']:.0f} s", flush=True)
    return [done[each.key] for each in wanted if each.key in done]


def _in_time(which: FileCase, *, until: float) -> dict[str, Any] | None:
    return traced(which) if time.monotonic() < until else None


def reported(lines: Sequence[dict[str, Any]], wanted: int) -> bool:
    """Print what became of the campaigns, and say whether the targets are met."""
    met = len(lines) == wanted
    print(f"\n{len(lines)} of {wanted} campaigns")
    for row in ("planted", "null"):
        for mean_s in sorted({line["mean_s"] for line in lines if line["row"] == row}):
            of = [line for line in lines if line["row"] == row and line["mean_s"] == mean_s]
            counts = Counter(line["outcome"] for line in of)
            print(f"{row} {mean_s:g} s means: " + ", ".join(f"{n} {what}" for what, n in counts.most_common()))
            if row == "planted":
                right, wrong = sum(counts[each] for each in _RIGHT), counts["wrong"]
                print(f"  exact or in the set {100 * right / len(of):.1f} % (>= 97), wrong {wrong} (0)")
                met = met and right >= 0.97 * len(of) and wrong == 0
            else:
                named = sum(bool(line["found"] or line["refused"]) for line in of)
                confirmed = sum(line["verdict"] in _CONFIRMED for line in of)
                for words in (
                    judged("  an effect before the held-out runs", named, len(of), 0.03, most=True),
                    judged("  an effect after the held-out runs", confirmed, len(of), 0.01, most=True),
                ):
                    print(words[0])
                    met = met and words[1]
    return met


if __name__ == "__main__":
    main()
