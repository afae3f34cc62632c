"""Processes for commands without the wait for their imports: a server that has loaded the program once and forks.

What a command does is done in a process of its own, with its own folder, files, signals and end, which the server
reports to the test's process; only the start, one to three seconds of importing, is that of the server
(``python -P tests/forked_commands.py SOCKET``). The process that answers a statement is forked as well, but where its
time or memory is limited: from the command's, from the server where a test asks in its own process, and from a process
beside a command that is a server, which has threads. So are the processes of a simulated station. A few tests start the
installed program itself.
"""

import array
import ctypes
import fcntl
import gc
import importlib
import json
import os
import selectors
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import traceback
import typing
import weakref
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from types import SimpleNamespace
from typing import Any, AnyStr, NoReturn

# variable of the environment with other limits of a server's statements, the fields of `QueryLimits` in JSON
SERVER_LIMITS = "GYROFLEET_TESTS_SERVER_LIMITS"
# where a server listens that all processes of a run of pytest ask
SHARED_SERVER = "GYROFLEET_TESTS_SERVER"
_PR_SET_PDEATHSIG = 1
_M_ARENA_MAX, _MADV_COLLAPSE, _HUGE_BYTES = -8, 25, 2 << 20
_PARTS = 23
_PATIENCE_S = 120.0
_MOST_FILES = 16
_ABOVE = 200  # numbers of files that nobody asks for
# what commands import when they come to it; pandas comes with asammdf, and pyarrow imports it where it is
_WANTED = (
    "gyrofleet",
    "analytics.certificate.issue",
    "analytics.certificate.kept_files",
    "analytics.certificate.verification",
    "analytics.cluster.diagnosis_tasks",
    "analytics.curves.allan_curve",
    "analytics.curves.isolated_outliers",
    "analytics.curves.noise_coefficients",
    "analytics.curves.normalised_walk",
    "analytics.evaluation.inner_page",
    "analytics.evaluation.layer",
    "analytics.evaluation.selection",
    "analytics.evaluation.table",
    "analytics.loop.explainable",
    "analytics.loop.model.model_check",
    "analytics.loop.next_test.recommendation",
    "analytics.loop.report.diagnosis_html",
    "analytics.loop.report.diagnosis_plots",
    "analytics.loop.station_rival",
    "analytics.loop.tracing.diagnosis",
    "analytics.loop.tracing.fleet",
    "analytics.loop.unit_diagnosis",
    "analytics.metric_registry.registry",
    "analytics.plots.figure_file",
    "analytics.serve.server",
    "ingest.can.bus.interface",
    "ingest.can.plan",
    "ingest.commands.simulate",
    "ingest.importing.importer",
    "ingest.instruments.power_supply",
    "ingest.instruments.rate_table",
    "ingest.instruments.temperature_chamber",
    "ingest.instruments.vibration_table",
    "ingest.instruments.voltmeter",
    "ingest.procedures.procedure",
    "ingest.procedures.run_steps",
    "ingest.simulator.processes",
    "ingest.station.station",
    "ingest.tables.file",
    "matplotlib.backends.backend_agg",
    "matplotlib.backends.backend_svg",
    "matplotlib.pyplot",
    "pandas",
    "pint",
    "polars",
    "pyarrow.dataset",
    "pyarrow.pandas_compat",
    "pyhanko.sign.signers",
    "pyhanko.sign.validation",
    "rich._emoji_codes",
    "rich.progress",
    "rich.status",
    "rich.traceback",
    "scipy.signal",
    "scipy.stats",
    "storage.attestation.verified_state",
    "storage.check.verify",
    "storage.fleet_store",
    "storage.specifications.copies",
    "storage.sql.door",
    "storage.sql.fleet.fleet_door",
    "storage.sql.opened",
    "storage.sql.reading",
    "structlog",
    "typst",
)


class CommandServer:
    """Starts commands of the program in forked processes; a context.

    Its process is that of `SHARED_SERVER`, where it is set, else its own, which begins with the first command.
    """

    def __enter__(self) -> "CommandServer":
        self._process: subprocess.Popen[bytes] | None = None
        self._is_ready = False
        self._beginning = threading.Lock()
        self._folder = tempfile.TemporaryDirectory()
        self._socket = os.environ.get(SHARED_SERVER, "") or str(Path(self._folder.name) / "socket")
        return self

    def __exit__(self, *_: object) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        self._folder.cleanup()

    def begin(self) -> str:
        """Begin its process, and do not wait until it listens; where it will."""
        self._process = subprocess.Popen(
            # -P: beside its folder's packages, which are named like those of the program
            [sys.executable, "-P", __file__, self._socket],
            stdout=subprocess.DEVNULL,
            env={**os.environ, "PYTHONWARNINGS": "error"},
        )
        return self._socket

    def socket(self) -> str:
        """Where its process listens, which is begun if it has not been."""
        with self._beginning:
            if not self._is_ready:
                if self._process is None and SHARED_SERVER not in os.environ:
                    self.begin()
                self._wait()
                self._is_ready = True
        return self._socket

    def _wait(self) -> None:
        until = time.monotonic() + _PATIENCE_S
        while not Path(self._socket).exists():
            code = None if self._process is None else self._process.poll()
            assert code is None, f"the server of commands ended with {code}"
            assert time.monotonic() < until, "the server of commands does not begin"
            time.sleep(0.02)

    def start(self, arguments: list[str], **options: Any) -> "ForkedProcess[str]":
        """Start a command; the options are those of `subprocess.Popen` for its folder, environment and files."""
        return ForkedProcess(self.socket, arguments, text=True, **options)

    def forking(self) -> SimpleNamespace:
        """In place of `subprocess` in a module that starts processes of the program's modules."""
        return _forking(partial(ForkedProcess[bytes], self.socket))

    def run(self, arguments: list[str], *, timeout_s: float, **options: Any) -> "subprocess.CompletedProcess[str]":
        """Run a command to its end.

        Raises
        ------
        subprocess.TimeoutExpired
            If it was still running after `timeout_s`; it is killed.
        """
        with self.start(arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options) as process:
            try:
                out, err = process.communicate(timeout=timeout_s)
            except BaseException:
                process.kill()
                raise
        return subprocess.CompletedProcess(arguments, process.returncode, out, err)


def _forking(popen: Callable[..., Any]) -> SimpleNamespace:
    return SimpleNamespace(**{**vars(subprocess), "Popen": popen})


class ForkedProcess(subprocess.Popen[AnyStr]):
    """A process that a server has forked, which reports its end to this process.

    It is that of a command, or of a module where the arguments say so (``-m MODULE``). Input, output and errors may be
    left alone, be pipes of their own, or go to files.
    """

    pid: int
    _waitpid_lock: threading.Lock

    def __init__(self, server: Callable[[], str], arguments: list[str], **options: Any) -> None:
        self._server = server
        given = [options.get(name) for name in ("stdin", "stdout", "stderr")]
        if wrong := [each for each in given if isinstance(each, int) and each != subprocess.PIPE]:
            raise ValueError(f"{wrong} as a file of a forked process: give subprocess.PIPE or an open file")
        self._files = {each.fileno() for each in given if not isinstance(each, int | None)}
        super().__init__(arguments, **options)

    def _execute_child(self, *parts: Any) -> None:
        """Have the server fork, in place of forking here; the parts are those of Python 3.11 to 3.14."""
        assert len(parts) == _PARTS, f"Popen of Python {sys.version} hands {len(parts)} parts on, not {_PARTS}"
        arguments, cwd, env = parts[0], parts[5], parts[6]
        passed: Sequence[int] = parts[4]
        into, out, err = parts[10], parts[13], parts[15]
        request = {
            "arguments": arguments,
            "folder": str(cwd or Path.cwd()),
            "env": {**(env or os.environ)},
            "new_session": parts[21],
            "files": [0, 1, 2, *passed],
        }
        files = [own if given == -1 else given for own, given in ((0, into), (1, out), (2, err))] + list(passed)
        self._line = socket.socket(socket.AF_UNIX)
        self._line.connect(self._server())
        message = json.dumps(request).encode()
        socket.send_fds(self._line, [len(message).to_bytes(8, "little")], files)
        self._line.sendall(message)
        self.pid = int.from_bytes(self._line.recv(8), "little")
        self._child_created = True
        for given in {into, out, err} - {-1} - self._files:  # the child's ends of the pipes
            os.close(given)

    def _try_wait(self, wait_flags: int) -> tuple[int, int]:
        """Ask for the end in place of `os.waitpid`, with its options and result."""
        try:
            status = self._line.recv(4, socket.MSG_DONTWAIT if wait_flags & os.WNOHANG else 0)
        except BlockingIOError:
            return 0, 0
        assert status, "the server of commands has ended"
        self._line.close()
        return self.pid, int.from_bytes(status, "little")

    def _internal_poll(self, *_: Any, **__: Any) -> int | None:
        if self.returncode is None and self._waitpid_lock.acquire(blocking=False):
            try:
                if self.returncode is None and (ended := self._try_wait(os.WNOHANG))[0]:
                    self.returncode = os.waitstatus_to_exitcode(ended[1])
            finally:
                self._waitpid_lock.release()
        return self.returncode


class ForkedModule(subprocess.Popen[Any]):
    """A process of a module of the program, forked from one that has its libraries loaded."""

    def _execute_child(self, *parts: Any) -> None:
        assert len(parts) == _PARTS, f"Popen of Python {sys.version} hands {len(parts)} parts on, not {_PARTS}"
        main = _MAINS[parts[0][parts[0].index("-m") + 1]]
        ends = (parts[10], parts[13], parts[15])
        others = (parts[11], parts[12], parts[14])
        self.pid = os.fork()
        if self.pid == 0:
            if parts[21]:
                os.setsid()
            for number, end in enumerate(ends):
                if end != -1:
                    os.dup2(end, number)
            for end in {*ends, *others} - {-1}:
                os.close(end)
            _run_to_the_end(main, parts[0])
        self._child_created = True
        for end in {*ends} - {-1}:
            os.close(end)


def _run_to_the_end(main: Callable[[list[str]], None], words: list[str]) -> NoReturn:
    code = 1
    try:
        main(words)
        code = 0
    except SystemExit as end:
        code = int(end.code or 0)
    except BaseException:  # noqa: BLE001  printed as the interpreter would
        traceback.print_exc()
    finally:
        for file in (sys.stdout, sys.stderr):
            file.flush()
        os._exit(code)


def _answer_statements(_: list[str]) -> None:
    import numba

    from storage.sql.sandbox import child
    from stream import compiled

    vars(numba.config)["DISABLE_JIT"] = True  # as the variable of its environment does
    vars(compiled)["_IS_DISABLED"] = True
    ctypes.CDLL(None).mallopt(_M_ARENA_MAX, 2)  # as well
    child.main()
    raise SystemExit(1)


def _play(words: list[str]) -> None:
    from ingest.simulator import processes

    vars(processes)["_PARENT"] = os.getppid()
    sys.argv = ["-m", *words[words.index("-m") + 2 :]]
    processes.main()


_MAINS = {"storage.sql.sandbox.child": _answer_statements, "ingest.simulator.processes": _play}


def _serve(path: str) -> None:
    import numpy as np

    from stream.compiled import Kernel
    from stream.quantities import is_angular_rate
    from stream.worker.compile_kernels import warm_up

    for name in _WANTED:
        importlib.import_module(name)
    import click

    group = sys.modules["gyrofleet"].main
    for name in group.list_commands(click.Context(group)):
        group.get_command(click.Context(group), name)
    for metric in sys.modules["analytics.metric_registry.registry"].metrics().values():
        if metric.header.python:
            resolve_name(metric.header.python)
    sys.modules["storage.segments.records"].schemas()
    pages = importlib.import_module("analytics.serve.pages.frame.render")
    for template in pages.templates():
        pages.compiled(template)
    warm_up()
    sys.modules["storage.lake.rollups"].roll_up(np.arange(2), np.arange(2.0))
    for module in list(sys.modules.values()):  # else numba, which compiles nothing there, makes them in that process
        for value in list(getattr(module, "__dict__", {}).values()):
            if isinstance(value, Kernel):
                value.made()
    is_angular_rate("mdps")  # defines pint's units
    for clear in vars(typing)["_cleanups"]:  # a library does so at the end of each process, which would copy it all
        clear()
    for each in list(vars(weakref.finalize)["_registry"]):  # as would what libraries release at the end
        each.atexit = False
    gc.collect()
    gc.freeze()  # else collections in the forked processes would look at all of it, and copy it
    _join_pages()
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(f"{path}.new")
        server.listen()
        Path(f"{path}.new").rename(path)  # who finds it can connect
        _fork_for(server)


def _join_pages() -> None:
    """Let the kernel join the pages of memory, of which a fork then copies the table in a third of the time."""
    madvise = ctypes.CDLL(None).madvise
    for line in Path("/proc/self/maps").read_text().splitlines():
        place, rights, *_, inode = line.split()[:5]
        begin, end = (int(each, 16) for each in place.split("-"))
        if rights == "rw-p" and inode == "0" and end - begin >= _HUGE_BYTES:  # an older kernel refuses it
            madvise(ctypes.c_void_p(begin), ctypes.c_size_t(end - begin), _MADV_COLLAPSE)


def _fork_for(server: socket.socket) -> NoReturn:
    """Fork a process for each that connects, and report the end of that process to it."""
    watched = selectors.DefaultSelector()
    watched.register(server, selectors.EVENT_READ)
    while True:
        for key, _ in watched.select():
            if key.data is None:
                _begin(server, watched)
                continue
            watched.unregister(key.fileobj)
            process, line = key.data
            if key.fd == line.fileno():  # closed where the end is known, or nobody asks: its number may be given again
                os.waitpid(process, 0)
                line.close()
                continue
            os.close(key.fd)
            ended = os.waitid(os.P_PID, process, os.WEXITED | os.WNOWAIT)
            assert ended is not None
            status = ended.si_status << 8 if ended.si_code == os.CLD_EXITED else ended.si_status
            with suppress(OSError):
                line.sendall(status.to_bytes(4, "little"))
            watched.register(line, selectors.EVENT_READ, key.data)


def _begin(server: socket.socket, watched: selectors.BaseSelector) -> None:
    line, _ = server.accept()
    request, files = _received(line)
    process = os.fork()
    if process == 0:
        line.close()
        server.close()
        for key in [key for key in watched.get_map().values() if key.data is not None]:
            if key.fd != key.data[1].fileno():
                os.close(key.fd)
            key.data[1].close()
        watched.close()
        _become(request, files)
        words = request["arguments"]
        if "-m" in words:
            _run_to_the_end(_MAINS[words[words.index("-m") + 1]], words)
        _run_command(words, request["env"])
    with suppress(OSError):  # who asked may have been killed
        line.sendall(process.to_bytes(8, "little"))
    watched.register(os.pidfd_open(process), selectors.EVENT_READ, (process, line))
    for file in files:
        os.close(file)


def _run_command(words: list[str], env: dict[str, str]) -> NoReturn:
    import ingest.commands.simulate
    import storage.sql.door
    from gyrofleet import front_door

    if limits := env.get(SERVER_LIMITS):
        pool = sys.modules["analytics.serve.sql_pool"].SqlPool
        pool.__init__.__defaults__ = (storage.sql.door.QueryLimits(**json.loads(limits)),)
    elif "serve" in words:
        vars(storage.sql.door)["subprocess"] = _forking_beside()
    elif not {"--max-time", "--max-memory"}.intersection(words):
        vars(storage.sql.door)["subprocess"] = _forking(ForkedModule)
    vars(ingest.commands.simulate)["subprocess"] = _forking(ForkedModule)
    sys.argv = ["gyrofleet", *words]
    front_door()
    raise SystemExit(0)


def _forking_beside() -> SimpleNamespace:
    """The same in a command with threads: a process without them, which ends with this one, forks for it."""
    path = f"\0gyrofleet-tests-{os.getpid()}"
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(path)
        server.listen()
        if os.fork() == 0:
            ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
            nothing = os.open(os.devnull, os.O_RDWR)
            for number in range(3):  # whoever reads what the command prints does not wait for this process
                os.dup2(nothing, number)
            _fork_for(server)
    return _forking(partial(ForkedProcess[bytes], lambda: path))


def _received(line: socket.socket) -> tuple[dict[str, Any], list[int]]:
    size, files, _, _ = socket.recv_fds(line, 8, _MOST_FILES)
    with line.makefile("rb") as stream:  # a statement of tens of kilobytes comes in parts
        request: dict[str, Any] = json.loads(stream.read(int.from_bytes(size, "little")))
    return request, list(array.array("i", files))


def _become(request: dict[str, Any], files: list[int]) -> None:
    if request["new_session"]:
        os.setsid()
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["env"])
    above = [fcntl.fcntl(file, fcntl.F_DUPFD_CLOEXEC, _ABOVE) for file in files]
    for file in files:
        os.close(file)
    for number, file in zip(request["files"], above, strict=True):
        os.dup2(file, number)
        os.close(file)


if __name__ == "__main__":
    _serve(sys.argv[1])
