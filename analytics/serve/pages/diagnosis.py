"""The pages of diagnoses: units with error models, and one with its versions, their use, and new diagnoses."""

from typing import Any

import msgspec

from analytics.plots.picture import Picture
from analytics.serve.api import jobs as jobs_api
from analytics.serve.api.operation import Call, Nothing, link
from analytics.serve.api.proposals import ProposalsAsked, list_proposals
from analytics.serve.api.rows import Name
from analytics.serve.api.unit import diagnosis as api
from analytics.serve.pages.frame.page import shown
from stream.decoding import converted
from stream.errors import NotFound


@shown("/diagnosis", "diagnosis/diagnoses.html.jinja", is_slow=True)
def list_diagnoses(call: Call, asked: Nothing) -> dict[str, Any]:
    """Units with error models."""
    return {
        "found": api.list_diagnoses(call, asked),
        "jobs": jobs_api.list_jobs(call, asked).jobs,
        "data": "/api/diagnosis",
    }


class DiagnosisPageAsked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which diagnosis of the unit is shown: its job, by default the last one that is done."""

    job: Name = ""


@shown("/diagnosis/{unit}", "diagnosis/diagnosis.html.jinja", is_slow=True)
def diagnosis(call: Call, asked: DiagnosisPageAsked) -> dict[str, Any]:
    """One unit."""
    found = api.diagnosis(call, Nothing())
    done = [job for job in found.jobs if job.state == "done" and asked.job in ("", job.id)]
    if asked.job and not done:
        raise NotFound(f"unit {found.unit} has no finished diagnosis {asked.job!r}; /api/jobs lists this server's")
    shown_job = jobs_api.document_of(call.service.jobs.job(done[0].id)) if done else None
    return {
        "found": found,
        "shown": shown_job,
        "reports": {} if shown_job is None else _reports(shown_job),
        "proposals": [each for each in list_proposals(call, ProposalsAsked()).proposals if each.unit == found.unit],
        "data": link("api", "diagnosis", found.unit),
    }


@shown("/jobs/{job}", "diagnosis/job.html.jinja")
def job(call: Call, asked: Nothing) -> dict[str, Any]:
    """One job."""
    found = jobs_api.job(call, asked)
    result = found.result if isinstance(found.result, dict) else {}
    return {
        "found": found, "result": result, "reports": _reports(found), "data": link("api", "jobs", found.job.id),
        "has_table": False,
    }  # fmt: skip


def _reports(document: jobs_api.JobDocument) -> dict[str, Any]:
    """Reports of a diagnosis by unit, each with its pictures and the addresses of their data."""
    result = document.result if isinstance(document.result, dict) else {}
    return {
        unit: report
        | {
            "pictures": [
                {
                    "picture": converted(picture, Picture),
                    "url": link("api", "jobs", document.job.id, "picture", name=name, unit=unit),
                }
                for name, picture in report["pictures"].items()
            ]
        }
        for unit, report in (result.get("reports") or {}).items()
    }
