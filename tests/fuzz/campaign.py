"""Inputs that are nearly right, to every format that gyrofleet reads.

``python -m tests.fuzz.campaign csv --seconds 3600``. Without names, all formats; each is read in a process of its own,
whose memory is limited. ``--guided`` lets coverage choose what is mutated further (`tests.fuzz.guided`); with
``--resume FOLDER`` a campaign that was ended continues there until its seconds are reached. An input that shows
something is kept in ``--keep FOLDER``; moved to ``tests/fuzz/found/FORMAT``, it is read first ever after, also in the
gate.
"""

import argparse
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
from hashlib import sha256
from pathlib import Path
from typing import Any

from tests.fuzz.format import Format, formats
from tests.fuzz.trial import Finding, Trial, Watch, limit_memory

FOUND = Path(__file__).parent / "found"
_MOST_CORPUS = 400
_KILL_S = 60.0
_LEAST_NEW = 3
_BEGIN_AGAIN = 75  # of a guided process whose fuzzer has taken much memory


class Campaign:
    """Trials of one format in this process; `findings` are texts by their mark."""

    def __init__(self, form: Format, folder: Path, keep: Path | None) -> None:
        self.form, self._keep = form, keep
        made = folder / "seeds"
        made.mkdir(parents=True)
        self.seeds = list(form.seeds(made))
        self._trial = Trial(form, folder / "trial", Watch())
        self.inputs = 0
        self.findings: dict[str, str] = {}
        self._began = time.monotonic()

    def start(self, corpus_bytes: int = 0) -> None:
        """Read the sound contents, which must be taken, and what earlier campaigns have found; limit the memory.

        `corpus_bytes`: room for the inputs that somebody else keeps in this process.
        """
        for seed in self.seeds:
            self._take(self._trial.judge(seed, is_sound=True), seed)
        limit_memory(corpus_bytes)
        vars(os)["fsync"] = lambda _descriptor: None  # no power is lost here, and the disk is others' as well
        for path in sorted((FOUND / self.form.name).glob("*")):
            self.judge(path.read_bytes())

    def judge(self, content: bytes) -> None:
        """Read one input."""
        self.inputs += 1
        self._take(self._trial.judge(content), content)

    def run(self, rng: random.Random, *, seconds: float, most: int | None) -> None:
        """Mutate and read for that time, or that many times."""
        corpus = [*self.seeds]
        until = time.monotonic() + seconds
        while time.monotonic() < until and (most is None or self.inputs < most):
            content = self.form.mutate(rng.choice(corpus), rng)
            self.judge(content)
            if rng.random() < 0.05 and len(corpus) < _MOST_CORPUS:
                corpus.append(content)

    def result(self) -> dict[str, Any]:
        """Numbers and findings."""
        return {
            "format": self.form.name, "inputs": self.inputs, "seconds": round(time.monotonic() - self._began, 1),
            "findings": self.findings,
        }  # fmt: skip

    def _take(self, found: Finding | None, content: bytes) -> None:
        if found is None or found.mark in self.findings:
            return
        self.findings[found.mark] = found.text
        if self._keep is not None:
            folder = self._keep / self.form.name
            folder.mkdir(parents=True, exist_ok=True)
            (folder / sha256(content).hexdigest()[:12]).write_bytes(content)
        print(f"{self.form.name}: {found.mark}\n{found.text}\n", file=sys.stderr, flush=True)


def tried(form: Format, seed: int, seconds: float, *, most: int | None = None, keep: Path | None = None) -> Any:
    """The result of a campaign in a forked process; a crash, and a hang that no signal ends, are findings."""
    with tempfile.TemporaryDirectory(prefix="fuzz-") as temporary:
        folder = Path(temporary)
        process = os.fork()
        if process == 0:
            code = 1
            try:
                campaign = Campaign(form, folder, keep)
                campaign.start()
                campaign.run(random.Random(seed), seconds=seconds, most=most)
                (folder / "result").write_text(json.dumps(campaign.result()))
                code = 0
            except BaseException:  # noqa: BLE001  printed as the interpreter would
                traceback.print_exc()
            finally:
                sys.stderr.flush()
                os._exit(code)
        until = time.monotonic() + seconds + _KILL_S
        while (ended := os.waitpid(process, os.WNOHANG)) == (0, 0):
            if time.monotonic() > until:
                os.kill(process, 9)
            time.sleep(0.02)
        if ended[1] == 0:
            return json.loads((folder / "result").read_text())
        last = next((path.read_bytes() for path in folder.glob("trial/last")), b"")
        if keep is not None and last:
            keep.mkdir(parents=True, exist_ok=True)
            (keep / f"{form.name}-crash").write_bytes(last)
    what = f"the process ended with {os.waitstatus_to_exitcode(ended[1])}, after an input of {len(last):,} bytes"
    return {"format": form.name, "inputs": 0, "seconds": seconds, "findings": {"crash": what}}


def tried_guided(name: str, arguments: argparse.Namespace) -> Any:
    """The result of a campaign that coverage guides; with ``--resume``, with all that was run before."""
    with tempfile.TemporaryDirectory(prefix="fuzz-") as temporary:
        folder = Path(temporary) if arguments.resume is None else arguments.resume / name.replace(" ", "-")
        folder.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, "-m", "tests.fuzz.guided", name, str(arguments.seconds), str(arguments.seed)]
        command += [str(folder), *([] if arguments.keep is None else [str(arguments.keep)])]
        # numba cannot compile what is instrumented
        env = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
        seconds = 20 * arguments.seconds + 5 * _KILL_S  # `arguments.seconds` are processor time there
        try:
            while True:
                done = subprocess.run(command, capture_output=True, text=True, timeout=seconds, env=env)
                if done.returncode != _BEGIN_AGAIN:
                    break
            lines = [line for line in done.stderr.splitlines() if not line.startswith(("INFO: ", "WARNING: Failed"))]
            print("\n".join(lines), file=sys.stderr, end="\n" if lines else "", flush=True)
            what = "" if done.returncode == 0 else f"the process ended with {done.returncode}"
        except subprocess.TimeoutExpired:
            what = "the process had to be killed"
        for crash in folder.glob("crash-*") if arguments.keep is not None else ():
            arguments.keep.mkdir(parents=True, exist_ok=True)
            shutil.copy(crash, arguments.keep / f"{name}-{crash.name}")
        result = folder / "result.json"
        found: dict[str, Any] = {"format": name, "inputs": 0, "seconds": arguments.seconds, "findings": {}}
        if result.exists():
            found = json.loads(result.read_text())
        if what or not result.exists():
            found["findings"]["crash"] = what or "no input was read"
        return found


def in_gate(form: Format, part: int) -> int:
    """Inputs of a short campaign: one in `part` of the format's, but some that are new beside what was found."""
    found = sum(1 for _ in (FOUND / form.name).glob("*"))
    return max(-(-form.gate_inputs // part), found + _LEAST_NEW)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="FORMAT")
    parser.add_argument(
        "--seconds", type=float, default=60.0, help="Time for each format; with --guided, of the processor."
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--guided", action="store_true", help="Coverage chooses what is mutated further.")
    parser.add_argument(
        "--gate", type=int, const=1, nargs="?", metavar="N", help="Few inputs of each format, or an Nth of these."
    )
    parser.add_argument(
        "--resume", type=Path, metavar="FOLDER", help="Continue the guided campaigns of this folder until --seconds."
    )
    parser.add_argument("--keep", type=Path, help="Folder for inputs that show something.")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    known = formats()
    if unknown := set(arguments.names) - set(known):
        parser.error(f"{', '.join(unknown)}: the formats are {', '.join(known)}")
    results = []
    for name in arguments.names or known:
        form = known[name]
        most = None if arguments.gate is None else in_gate(form, arguments.gate)
        if arguments.guided:
            result = tried_guided(name, arguments)
        else:
            result = tried(form, arguments.seed, arguments.seconds, most=most, keep=arguments.keep)
        results.append(result)
        if arguments.json:
            print(json.dumps(result), flush=True)
        else:
            found = "; ".join(result["findings"]) or "no finding"
            print(f"{name}: {result['inputs']:,} inputs in {result['seconds']} s, {found}", flush=True)
    sys.exit(1 if any(each["findings"] for each in results) else 0)


if __name__ == "__main__":
    main()
