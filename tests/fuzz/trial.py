"""One input read under watch: errors of other classes, hangs, memory, files elsewhere, refusals that name nothing."""

import io
import re
import resource
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import Any, NamedTuple

from stream.errors import GyrofleetError
from tests.fuzz.format import Format

MAX_MEMORY_BYTES = 1 << 30
MAX_MESSAGE_CHARS = 3000
_DEVICES = ("/dev/null", "/dev/random", "/dev/urandom", "/dev/tty")  # not /dev/shm, where tests may have their files
_READ_BY_PYTHON = (sys.prefix, sys.base_prefix, *sys.path, "/usr", "/lib", "/proc", "/sys", "/etc/localtime", *_DEVICES)
_OPENING = {"open", "os.listdir", "os.scandir"}
_CHANGING = {
    "os.remove", "os.rename", "os.mkdir", "os.rmdir", "os.link", "os.symlink", "os.truncate", "os.chmod",
    "shutil.rmtree", "shutil.copyfile", "shutil.move", "subprocess.Popen", "os.system", "os.exec", "socket.connect",
}  # fmt: skip


class Hang(BaseException):
    """Reading has taken too long; no reader catches it."""


class Finding(NamedTuple):
    """What an input has shown; `mark` is the same for findings of one cause."""

    mark: str
    text: str


class Watch:
    """Notes files outside of a folder that are opened or changed; installed once in a process."""

    def __init__(self) -> None:
        self.folder: Path | None = None
        self.outside: list[str] = []
        allowed = {str(Path(each).resolve()) for each in _READ_BY_PYTHON if each} | set(_READ_BY_PYTHON)
        self._allowed = tuple(f"{each}/" for each in allowed if each) + tuple(each for each in allowed if each)
        sys.addaudithook(self._hear)

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if (
            self.folder is None
            or "__pycache__" in repr(arguments)
            or (event not in _OPENING and event not in _CHANGING)
        ):
            return
        if event in ("subprocess.Popen", "os.system", "os.exec", "socket.connect"):
            self.outside.append(f"{event} {arguments!r:.200}")
            return
        if event in ("os.rename", "os.link", "os.remove", "os.mkdir", "os.rmdir") and arguments[-1] != -1:
            if any("/" in str(each) or str(each) == ".." for each in arguments):  # within an open folder
                self.outside.append(f"{event} {arguments!r:.200}")
            return
        paths = arguments[:2] if event in ("os.rename", "os.link", "shutil.copyfile", "shutil.move") else arguments[:1]
        for path in paths:
            if isinstance(path, str | bytes | Path) and not self._is_own(path, event):
                self.outside.append(f"{event} {path!r:.200}")

    def _is_own(self, path: str | bytes | Path, event: str) -> bool:
        folder, self.folder = self.folder, None  # what is asked here is not heard
        assert folder is not None
        try:
            text = path.decode(errors="replace") if isinstance(path, bytes) else str(path)
            full = str(Path(text).absolute()) if "\0" not in text else text
            full = str(Path(full).resolve()) if ".." in full else full
            return full.startswith(str(folder)) or (event in _OPENING and full.startswith(self._allowed))
        except (OSError, ValueError, RuntimeError):
            return True  # it is the name of no file
        finally:
            self.folder = folder


class Trial:
    """Reads inputs of one format, each in `folder`, which has what belongs around them."""

    def __init__(self, form: Format, folder: Path, watch: Watch) -> None:
        self.form, self.watch = form, watch
        self._base = folder.resolve()
        self._around = self._base / "around"
        self._around.mkdir(parents=True)
        if form.around is not None:
            form.around(self._around)
        self._place = self._base / "in" / "place"
        (self._base / "bait").write_text("it is read by nobody")
        (self._base / "in" / "tmp").mkdir(parents=True)
        tempfile.tempdir = str(self._base / "in" / "tmp")
        self._is_there = False

    def judge(self, content: bytes, *, is_sound: bool = False) -> Finding | None:
        """Read one input; what is wrong with how that went, as that a sound one is refused."""
        (self._base / "last").write_bytes(content)  # a crash leaves it
        if self.form.changes or not self._is_there or not isinstance(self.form.file, str):
            shutil.rmtree(self._place, ignore_errors=True)
            shutil.copytree(self._around, self._place)
            self._is_there = True
        path = self._place / self.form.path(content)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        self.watch.outside.clear()
        before = _restarted_peak_bytes()
        found = self._read(path, is_sound=is_sound)
        grown = _peak_bytes() - before
        if self.watch.outside and (found is None or found.mark.startswith("printed")):
            what = self.watch.outside[0]
            found = Finding(f"outside {what[:60]}", f"a file outside of its folder: {what}")
        if found is None and grown > MAX_MEMORY_BYTES // 2:
            found = Finding("memory", f"it took {grown >> 20} MiB, the input has {len(content):,} bytes")
        return found

    def _read(self, path: Path, *, is_sound: bool) -> Finding | None:
        try:
            with limited_time(self.form.hang_s), _heard() as heard:
                self.watch.folder = self._base / "in"
                try:
                    self.form.read(path)
                finally:
                    self.watch.folder = None
        except GyrofleetError as error:
            if is_sound:
                return Finding("refused seed", str(error))
            wrong = _of_message(error, path)
            return wrong if wrong is not None or not heard else _of_heard(heard)
        except (Exception, Hang) as error:  # noqa: BLE001  that is what is looked for
            return _of_error(error)
        return _of_heard(heard) if heard else None


def _of_heard(heard: list[str]) -> Finding:
    return Finding(f"printed {heard[-1][:40]}", f"it printed: {' '.join(heard)[:2000]}")


@contextmanager
def _heard() -> Iterator[list[str]]:
    """What a library prints, logs, warns of or raises where nobody can catch it: users would see it."""
    heard: list[str] = []

    class Paper(io.StringIO):
        def write(self, text: str) -> int:
            if text.strip():
                heard.append(text.strip())
            return len(text)

    def take(failure: Any) -> None:
        heard.append(f"{type(failure.exc_value).__name__}: {failure.exc_value} in {failure.object!r}")

    before = sys.unraisablehook
    sys.unraisablehook = take
    with redirect_stdout(Paper()), redirect_stderr(Paper()), warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            yield heard
        finally:
            sys.unraisablehook = before


def _of_message(error: GyrofleetError, path: Path) -> Finding | None:
    """Whether a refusal is a sentence that names the file."""
    text = str(error)
    of_its_folder = re.compile(rf"{re.escape(str(path.parent))}/[\w./-]*\w\.\w+")
    if path.name not in text and of_its_folder.search(text) is None:
        return Finding(f"nameless {_place(error)}", f"the refusal does not name the file: {text[:300]!r}")
    if len(text) > MAX_MESSAGE_CHARS:
        return Finding(f"long {_place(error)}", f"the refusal has {len(text):,} characters: {text[:300]!r}...")
    return None


def _of_error(error: BaseException) -> Finding:
    text = "".join(traceback.format_exception(error))
    mark = "Hang" if isinstance(error, Hang) else f"{type(error).__name__} {_place(error)}"
    return Finding(mark, text[-4000:])


def _place(error: BaseException) -> str:
    """Where it was raised: the last line of the project, and the last of all."""
    frames = traceback.extract_tb(error.__traceback__)
    names = [f"{Path(each.filename).name}:{each.lineno}" for each in frames]
    own = [name for name, each in zip(names, frames, strict=True) if "site-packages" not in each.filename]
    return f"{own[-1] if own else ''} {names[-1] if names else ''}"


@contextmanager
def limited_time(seconds: float) -> Iterator[None]:
    """Raise a Hang in the block after so many seconds of processor time, or 20 times as many of the clock.

    On a busy machine a process waits for its turn: that is no hang of what it reads.
    """

    def stop(_number: int, _frame: object) -> None:
        raise Hang

    timers = ((signal.ITIMER_PROF, signal.SIGPROF, seconds), (signal.ITIMER_REAL, signal.SIGALRM, 20.0 * seconds))
    before = {number: signal.signal(number, stop) for _, number, _ in timers}
    for timer, _, limit_s in timers:
        signal.setitimer(timer, limit_s, 1.0)  # again, if a library has caught the first
    try:
        yield
    finally:
        for timer, _, _ in timers:
            signal.setitimer(timer, 0.0)
        for number, handler in before.items():
            signal.signal(number, handler)


def _restarted_peak_bytes() -> int:
    """Let the peak of this process begin again at what it has now; returns that."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    return _peak_bytes()


def _peak_bytes() -> int:
    status = Path("/proc/self/status").read_text()
    return 1024 * int(status.partition("VmHWM:")[2].split()[0])


def limit_memory(beside_bytes: int = 0) -> None:
    """Bound what this process may take beyond what it has, and beyond what is kept beside what is read."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MAX_MEMORY_BYTES + beside_bytes
    resource.setrlimit(resource.RLIMIT_AS, (most, resource.getrlimit(resource.RLIMIT_AS)[1]))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
