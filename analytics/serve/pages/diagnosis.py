"""The pages of diagnoses: units with error models, and one with its versions, their use, and new diagnoses."""

from typing import Any

from analytics.serve.api import diagnosis as api
from analytics.serve.api import jobs as jobs_api
from analytics.serve.api.operation import Call, Nothing, link
from analytics.serve.pages.page import shown


@shown("/diagnosis", "diagnoses.html.jinja", is_slow=True)
def list_diagnoses(call: Call, asked: Nothing) -> dict[str, Any]:
    """Units with error models."""
    return {
        "found": api.list_diagnoses(call, asked),
        "jobs": jobs_api.list_jobs(call, asked).jobs,
        "data": "/api/diagnosis",
    }


@shown("/diagnosis/{unit}", "diagnosis.html.jinja", is_slow=True)
def diagnosis(call: Call, asked: Nothing) -> dict[str, Any]:
    """One unit."""
    found = api.diagnosis(call, asked)
    return {"found": found, "data": link("api", "diagnosis", found.unit)}


@shown("/jobs/{job}", "job.html.jinja")
def job(call: Call, asked: Nothing) -> dict[str, Any]:
    """One job."""
    found = jobs_api.job(call, asked)
    result = found.result if isinstance(found.result, dict) else {}
    units = result.get("units") if isinstance(result.get("units"), dict) else {}
    return {
        "found": found, "result": result, "units": units, "data": link("api", "jobs", found.job.id), "has_table": False,
    }  # fmt: skip
