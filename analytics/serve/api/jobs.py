"""Jobs of the server: diagnoses and verifications at work, and their results."""

from pathlib import Path
from typing import Any

import msgspec

from analytics.plots.picture import Picture
from analytics.serve.api.operation import Call, Nothing, get, post
from analytics.serve.api.rows import Name, iso
from analytics.serve.doors.roles import Role
from analytics.serve.jobs import Job
from stream.decoding import converted
from stream.errors import NotFound


class JobRow(msgspec.Struct, frozen=True, kw_only=True):
    """A job; `state` is waiting, running, done, failed or cancelled, `progress` its last word."""

    id: str
    kind: str
    subject: str
    by: str
    state: str
    progress: str
    entered_ns: int
    entered: str | None
    ended_ns: int | None
    ended: str | None


class PictureAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which picture of a diagnosis; of which unit, by default of the job's own."""

    name: Name
    unit: Name = ""


class JobList(msgspec.Struct, frozen=True, kw_only=True):
    """Jobs, the latest first."""

    jobs: list[JobRow]


class JobDocument(msgspec.Struct, frozen=True, kw_only=True):
    """A job with its result, the JSON of its command, or its error."""

    job: JobRow
    result: Any


@get("/api/jobs", table="jobs", is_kept=False)
def list_jobs(call: Call, asked: Nothing) -> JobList:
    """Jobs that this server runs or has run."""
    del asked
    return JobList(jobs=[job_row(job) for job in call.service.jobs.all()])


@get("/api/jobs/{job}", is_kept=False)
def job(call: Call, asked: Nothing) -> JobDocument:
    """One job, with its result once it is done."""
    del asked
    return document_of(call.service.jobs.job(call.path["job"]))


@get("/api/jobs/{job}/picture", table="", is_kept=False)
def job_picture(call: Call, asked: PictureAsked) -> Picture:
    """A picture of a diagnosis, by unit and name: residual over its driver, error before and after."""
    found = call.service.jobs.job(call.path["job"])
    reports = found.result.get("reports") if isinstance(found.result, dict) else None
    pictures = (reports or {}).get(asked.unit or found.subject, {}).get("pictures", {})
    if asked.name not in pictures:
        raise NotFound(f"job {found.id} has no picture {asked.name!r}; it has {', '.join(pictures) or 'none'}")
    return converted(pictures[asked.name], Picture)


@post("/api/jobs/{job}/cancel", role=Role.ENGINEER)
def cancel_job(call: Call, asked: Nothing) -> JobDocument:
    """End a job."""
    del asked
    return document_of(call.service.jobs.cancel(call.path["job"]))


@post("/api/store/verify", role=Role.OPERATOR, status=202)
def verify_store(call: Call, asked: Nothing) -> JobDocument:
    """Read everything in the store and report what is wrong; a job."""
    del asked
    folder = str(call.store.folder.resolve())
    arguments = ("verify", f"--store={folder}")
    return document_of(call.service.jobs.enter(Job("verify", call.store.folder.name, arguments, call.person.name)))


def document_of(job: Job) -> JobDocument:
    """A job as an answer."""
    return JobDocument(job=job_row(job), result=result_of(job))


def result_of(job: Job) -> Any:
    """The result of a job; of the store its name, not where it lies."""
    if isinstance(job.result, dict) and isinstance(job.result.get("store"), str):
        return job.result | {"store": Path(job.result["store"]).name}
    return job.result


def job_row(job: Job) -> JobRow:
    """A job without its result."""
    names = ("id", "kind", "subject", "by", "state", "progress", "entered_ns", "ended_ns")
    values = {name: getattr(job, name) for name in names}
    return JobRow(**values, entered=iso(job.entered_ns), ended=iso(job.ended_ns))
