"""All operations of the API, and their routes."""

import functools
from typing import Any

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from analytics.serve.api import alerts, events, health, jobs, live, notes, proposals, store
from analytics.serve.api.endpoint import route
from analytics.serve.api.openapi import openapi_document
from analytics.serve.api.operation import Operation
from analytics.serve.api.query import allan, grafana, signals, sql
from analytics.serve.api.run import exclusions, run_allan, run_commands, run_course, runs
from analytics.serve.api.trend import trend_pictures, trends
from analytics.serve.api.unit import certificates, diagnosis, unit_pictures, units
from analytics.serve.doors.admission import admitted
from analytics.serve.doors.roles import Role
from analytics.serve.service import Service

OPERATIONS: tuple[Operation[Any, Any], ...] = (
    units.list_units,
    units.unit,
    unit_pictures.unit_history,
    unit_pictures.unit_allan,
    unit_pictures.unit_temperature,
    events.unit_audit,
    certificates.certificate_pdf,
    runs.list_runs,
    runs.run,
    run_course.run_course,
    run_allan.run_allan,
    run_commands.command_run,
    run_commands.list_run_commands,
    signals.signal,
    allan.allan,
    trends.list_metrics,
    trends.trend,
    trend_pictures.trend_values,
    trend_pictures.trend_chart,
    trends.list_yield,
    trend_pictures.yield_picture,
    trend_pictures.pareto_picture,
    trends.list_verdicts,
    events.list_events,
    live.floor,
    live.unit_floor,
    store.store,
    store.status,
    alerts.list_alerts,
    alerts.acknowledge_alert,
    sql.sql,
    sql.sql_tables,
    diagnosis.list_diagnoses,
    diagnosis.diagnosis,
    diagnosis.diagnose_unit,
    diagnosis.promote_model,
    diagnosis.roll_back_model,
    proposals.list_proposals,
    proposals.approve_proposal,
    proposals.reject_proposal,
    jobs.list_jobs,
    jobs.job,
    jobs.job_picture,
    jobs.cancel_job,
    jobs.verify_store,
    notes.add_note,
    exclusions.enter_exclusion,
    grafana.grafana,
    grafana.grafana_metrics,
    grafana.grafana_options,
    grafana.grafana_variable,
    grafana.grafana_query,
    grafana.grafana_tag_keys,
)


def api_routes(service: Service) -> list[Route]:
    """Routes of the API, its document, and those for machines that watch the server."""
    return [
        *(route(operation, service) for operation in OPERATIONS),
        Route("/api/openapi.json", _openapi, name="openapi"),
        Route("/api/me", _me, name="me"),
        Route("/api/live", functools.partial(live.live, service=service), name="live"),
        Route("/health", functools.partial(health.health, service=service), name="health"),
        Route("/metrics", functools.partial(health.prometheus, service=service), name="metrics"),
    ]


async def _openapi(request: Request) -> Response:
    admitted(request.scope, Role.VIEWER)
    return JSONResponse(_document())


@functools.cache
def _document() -> dict[str, Any]:
    return openapi_document(OPERATIONS)


async def _me(request: Request) -> Response:
    person = admitted(request.scope, Role.VIEWER)
    return JSONResponse({"name": person.name, "role": person.role.word, "csrf": person.csrf})
