"""All pages, and their routes."""

import functools

from starlette.routing import Route

from analytics.serve.pages import login, runs, units
from analytics.serve.service import Service


def page_routes(service: Service) -> list[Route]:
    """Routes of the pages."""
    pages = (units.list_units, units.unit, runs.list_runs, runs.run)
    return [
        *(each.route(service) for each in pages),
        Route("/login", functools.partial(login.login, service=service), methods=["GET", "POST"], name="login"),
        Route("/logout", functools.partial(login.logout, service=service), methods=["POST"], name="logout"),
    ]
