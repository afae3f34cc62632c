"""All pages, and their routes."""

import functools

from starlette.routing import Route

from analytics.serve.doors.login_file import DONE_PATH
from analytics.serve.pages import at_work, diagnosis, events, floor, proposals, runs, signal, sql, store, trends, units
from analytics.serve.pages.frame import actions
from analytics.serve.pages.frame.render import compiled, templates
from analytics.serve.pages.sign_in import login, single_sign_on
from analytics.serve.service import Service

PAGES = (
    floor.floor,
    runs.list_runs,
    runs.run,
    units.list_units,
    units.unit,
    signal.signal,
    trends.trends,
    trends.verdicts,
    diagnosis.list_diagnoses,
    diagnosis.diagnosis,
    diagnosis.job,
    proposals.proposals,
    events.events,
    store.store,
    at_work.at_work,
)


def page_routes(service: Service) -> list[Route]:
    """Routes of the pages."""
    both = ["GET", "POST"]
    # also those that others extend or include
    service.warming.tasks += [functools.partial(compiled, name) for name in templates()]
    return [
        *(each.route(service) for each in PAGES),
        Route("/sql", functools.partial(sql.sql, service=service), methods=both, name="page_sql"),
        Route("/login", functools.partial(login.login, service=service), methods=both, name="login"),
        Route("/login/oidc", functools.partial(single_sign_on.start, service=service), name="login_oidc"),
        Route(DONE_PATH, functools.partial(single_sign_on.done, service=service), name="login_oidc_done"),
        Route("/logout", functools.partial(login.logout, service=service), methods=["POST"], name="logout"),
        Route("/act/{action}", functools.partial(actions.act, service=service), methods=["POST"], name="act"),
    ]
