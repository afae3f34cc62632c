"""Commands that take long, run one after the other in processes of their own: diagnoses, verifications."""

import json
import subprocess
import sys
import tempfile
import threading
import time
from collections import OrderedDict
from dataclasses import dataclass, field
from queue import Empty, Queue
from typing import Any, Literal
from uuid import uuid4

from analytics.serve.problems import TooMany
from stream.closing import Closing
from stream.errors import NotFound

State = Literal["waiting", "running", "done", "failed", "cancelled"]
_MOST_KEPT = 50
_MOST_WAITING = 10
_MOST_BYTES = 64 << 20
_LOOK_S = 0.2


@dataclass
class Job:
    """A command of gyrofleet with ``--json``; `progress` is the last line of its standard error."""

    kind: str
    subject: str
    arguments: tuple[str, ...]
    by: str
    id: str = field(default_factory=lambda: uuid4().hex[:12])
    state: State = "waiting"
    progress: str = ""
    entered_ns: int = field(default_factory=time.time_ns)
    ended_ns: int | None = None
    result: Any = None
    is_cancelled: bool = False


class Jobs(Closing):
    """Jobs of a server, the last 50 of them; they are forgotten with the process."""

    def __init__(self) -> None:
        self._jobs: OrderedDict[str, Job] = OrderedDict()
        self._waiting: Queue[Job] = Queue()
        self._lock = threading.Lock()
        self._ends = threading.Event()
        self._thread: threading.Thread | None = None

    def enter(self, job: Job) -> Job:
        """Put a job in the queue; TooMany if that is long."""
        with self._lock:
            if sum(each.state in {"waiting", "running"} for each in self._jobs.values()) > _MOST_WAITING:
                raise TooMany(f"{_MOST_WAITING} jobs are waiting", 60.0)
            self._jobs[job.id] = job
            for old in [each for each in self._jobs.values() if each.ended_ns is not None][:-_MOST_KEPT]:
                del self._jobs[old.id]
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, daemon=True, name="jobs")
                self._thread.start()
        self._waiting.put(job)
        return job

    def job(self, name: str) -> Job:
        """A job by its id."""
        with self._lock:
            found = self._jobs.get(name)
        if found is None:
            raise NotFound(f"there is no job {name!r}; /api/jobs lists those of this server")
        return found

    def all(self) -> list[Job]:
        """All jobs, the latest first."""
        with self._lock:
            return list(reversed(self._jobs.values()))

    def last(self, kind: str) -> Job | None:
        """The last job of a kind that is done."""
        return next((job for job in self.all() if job.kind == kind and job.state == "done"), None)

    def cancel(self, name: str) -> Job:
        """End a job, or take it out of the queue."""
        job = self.job(name)
        job.is_cancelled = True
        return job

    def close(self) -> None:
        """End the job at work."""
        self._ends.set()
        if self._thread is not None:
            self._thread.join(timeout=3.0)

    def _work(self) -> None:
        while not self._ends.is_set():
            try:
                job = self._waiting.get(timeout=_LOOK_S)
            except Empty:
                continue
            if not job.is_cancelled:
                job.state = "running"
                self._run(job)
            if job.is_cancelled:
                job.state = "cancelled"
            job.ended_ns = time.time_ns()

    def _run(self, job: Job) -> None:
        command = [sys.executable, "-P", "-m", "gyrofleet", *job.arguments, "--json"]
        with tempfile.TemporaryFile() as out:
            process = subprocess.Popen(  # noqa: S603  our own program, each argument one word
                command, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.PIPE, text=True, errors="replace"
            )
            listener = threading.Thread(target=_listen, args=(process, job), daemon=True)
            listener.start()
            while process.poll() is None and not (job.is_cancelled or self._ends.wait(_LOOK_S)):
                pass
            if process.poll() is None:
                process.kill()
                job.is_cancelled = True
            code = process.wait()
            listener.join()
            out.seek(0)
            _finish(job, code, out.read(_MOST_BYTES))


def _listen(process: subprocess.Popen[str], job: Job) -> None:
    assert process.stderr is not None
    with process.stderr as file:
        for line in file:
            job.progress = line.strip()[:500] or job.progress


def _finish(job: Job, code: int, out: bytes) -> None:
    """Take the answer of a command that has ended; one with findings ends with 1 as well."""
    try:
        job.result = json.loads(out)
    except ValueError:
        job.state = "failed"
        job.result = {"error": {"kind": "JobFailed", "message": job.progress or f"it ended with exit code {code}"}}
        return
    job.state = "failed" if _is_refusal(job.result) else "done"


def _is_refusal(result: Any) -> bool:
    """Whether an answer is ``{"error": {"kind": ..., "message": ...}}``; a diagnosis has an `error` too."""
    error = result.get("error") if isinstance(result, dict) else None
    return isinstance(error, dict) and "kind" in error
