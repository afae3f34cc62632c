"""Processes for commands without the wait for their imports: a server that has loaded the program once and forks.

``python tests/forked_commands.py`` reads requests, a line of JSON each, from its input and answers each with the exit
code of the process that ran it. What a command does is done in a process of its own, with its own folder, files and
end; only the start, which takes one to three seconds of importing, is that of the server. Tests of how a process
starts, is signalled or killed begin real ones.
"""

import contextlib
import importlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

_TICK_S = 0.005
# what commands import when they come to it
_WANTED = (
    "analytics.metrics.evaluation",
    "analytics.tracing.diagnosis",
    "ingest.importer",
    "matplotlib.pyplot",
    "scipy.signal",
    "scipy.stats",
)


class CommandServer:
    """Runs commands of the program in forked processes, one after the other.

    Examples
    --------
    >>> import tempfile
    >>> with CommandServer() as server, tempfile.TemporaryDirectory() as folder:
    ...     code, out, err = server.run(["--version"], Path(folder), {}, 60.0)
    >>> code, out.startswith("gyrofleet"), err
    (0, True, '')
    """

    def __enter__(self) -> "CommandServer":
        self._folder = tempfile.TemporaryDirectory()
        self._process = subprocess.Popen(
            [sys.executable, "-P", __file__],  # beside its folder's packages, which are named like those of the program
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONWARNINGS": "error"},
        )
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()
        self._folder.cleanup()

    def run(self, arguments: list[str], folder: Path, env: dict[str, str], timeout_s: float) -> tuple[int, str, str]:
        """Exit code, output and messages of a command in a folder.

        Raises
        ------
        subprocess.TimeoutExpired
            If it was still running after `timeout_s`; it is killed.
        """
        files = [Path(self._folder.name) / name for name in ("out", "err")]
        request = {
            "arguments": arguments,
            "folder": str(folder),
            "env": env,
            "timeout_s": timeout_s,
            "out": str(files[0]),
            "err": str(files[1]),
        }
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        assert answer, f"the server of commands ended with {self._process.poll()}"
        code: int | None = json.loads(answer)
        out, err = (file.read_text() for file in files)
        if code is None:
            raise subprocess.TimeoutExpired(arguments, timeout_s, out, err)
        return code, out, err


def _serve() -> None:
    from gyrofleet import front_door
    from stream.estimators.base import warm_up

    for name in _WANTED:
        importlib.import_module(name)
    warm_up()
    for line in sys.stdin:
        request = json.loads(line)
        process = os.fork()
        if process == 0:
            _become(request)
            sys.argv = ["gyrofleet", *request["arguments"]]
            front_door()
        print(json.dumps(_end(process, request["timeout_s"])), flush=True)


def _become(request: dict[str, Any]) -> None:
    os.chdir(request["folder"])
    os.environ.update(request["env"])
    nothing = os.open(os.devnull, os.O_RDONLY)
    new = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
    for number, file in enumerate((nothing, os.open(request["out"], new), os.open(request["err"], new))):
        os.dup2(file, number)
        os.close(file)
    sys.stdin = open(0)  # noqa: SIM115  the server's has read ahead


def _end(process: int, timeout_s: float) -> int | None:
    """Exit code as `subprocess` has it; None if it had to be killed."""
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        ended, status = os.waitpid(process, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        time.sleep(_TICK_S)
    with contextlib.suppress(ProcessLookupError):
        os.kill(process, signal.SIGKILL)
    os.waitpid(process, 0)
    return None


if __name__ == "__main__":
    _serve()
