"""Every format that gyrofleet reads, with inputs that are nearly right; the campaign of hours is a command.

A format is added in `tests/fuzz/formats`, and nowhere else. ``python -m tests.fuzz.campaign --guided --seconds 3600``
is an hour a format; among the long tests they share an hour, or have `GYROFLEET_FUZZ_SECONDS` each.
"""

import json
import os
import random
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from analytics.config_kinds import KINDS
from tests.fuzz.campaign import FOUND
from tests.fuzz.format import formats
from tests.fuzz.mutations import mutated_bytes, mutated_json, mutated_lines, mutated_toml

ROOT = Path(__file__).parents[2]
NAMES = tuple(formats())
SECONDS = float(os.environ.get("GYROFLEET_FUZZ_SECONDS", 3600.0 / len(NAMES)))


def campaign(*arguments: str, timeout_s: float) -> list[dict[str, Any]]:
    command = [sys.executable, "-m", "tests.fuzz.campaign", *arguments, "--json"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=timeout_s)
    results = [json.loads(line) for line in done.stdout.splitlines()]
    assert done.returncode == 0, done.stderr + done.stdout
    return results


@pytest.mark.parametrize("part", [5, pytest.param(1, marks=pytest.mark.long)])  # one in so many inputs
def test_what_is_nearly_right_is_refused_in_a_sentence(part: int) -> None:
    """Also what earlier campaigns have found (`found`), of which no line may be left out."""
    results = campaign("--gate", str(part), "--seed", "20261125", timeout_s=300)
    assert [each["format"] for each in results] == list(NAMES)
    for each in results:
        assert each["findings"] == {}
        assert each["inputs"] >= formats()[each["format"]].gate_inputs / part, each


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_what_coverage_leads_to_is_refused_in_a_sentence(name: str) -> None:
    (result,) = campaign(name, "--guided", "--seconds", str(SECONDS), timeout_s=SECONDS + 600)
    assert result["findings"] == {}


def test_every_kind_of_file_that_people_write_is_a_format() -> None:
    other_names = {"frame": "layout", "site": "site rules", "access": "access list"}
    assert {other_names.get(kind, kind) for kind in KINDS} <= set(NAMES)


def test_what_was_found_is_of_a_format() -> None:
    assert {path.name for path in FOUND.iterdir()} <= set(NAMES)
    assert sum(1 for _ in FOUND.glob("*/*")) >= 30


def test_mutations_change_what_they_are_given() -> None:
    rng = random.Random(1)
    samples = {
        mutated_bytes: b"0123456789", mutated_lines: b"a,b\n1,2\n", mutated_json: b'{"a":[1,2]}',
        mutated_toml: b'a = 1\nb = "x"\n',
    }  # fmt: skip
    for mutate, content in samples.items():
        mutated = [mutate(content, rng) for _ in range(200)]
        assert sum(each != content for each in mutated) > 150
        assert len(set(mutated)) > 50


READINGS = {
    "while True: pass": "Hang",
    "threading.Event().wait()": "Hang",
    "raise KeyError('x')": "KeyError",
    "open('/etc/passwd').close()": "outside open",
    "open(path.parents[2] / 'bait', 'a').close()": "outside open",
    "print('x')": "printed x",
    "raise BadInput('no')": "nameless",
    "raise BadInput(f'{path}: no')": "None",
    "bytes([1]) * (560 << 20)": "memory",
}


def test_the_watch_sees_what_it_is_for(tmp_path: Path) -> None:
    """In a process of its own, which keeps its audit hook."""
    script = f"""
import sys
import threading
from pathlib import Path
from stream.errors import BadInput
from tests.fuzz.format import Format
from tests.fuzz.mutations import mutated_bytes
from tests.fuzz.trial import Trial, Watch
watch = Watch()
for number, reading in enumerate({list(READINGS)!r}):
    def read(path):
        exec(reading)
    hang_s = {{"while": 0.3, "threa": 0.03}}.get(reading[:5], 40.0)  # on a busy machine, memory takes its time too
    form = Format("x", lambda _: [b"x"], read, mutated_bytes, "x.bin", hang_s=hang_s)
    found = Trial(form, Path(sys.argv[1]) / str(number), watch).judge(b"x")
    print(found.mark if found else None)
"""
    command = [sys.executable, "-c", script, str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    for seen, (reading, mark) in zip(done.stdout.splitlines(), READINGS.items(), strict=True):
        assert seen.startswith(mark), (reading, seen)
