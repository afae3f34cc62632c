"""What each route asks first: who is it, may they, and was a change sent by a page of this server."""

import hmac

from starlette.datastructures import Headers
from starlette.types import Scope

from analytics.serve.doors.gate import PERSON
from analytics.serve.doors.origin import is_of_this_site
from analytics.serve.doors.roles import Person, Role
from analytics.serve.problems import Forbidden, Unauthorised


def admitted(scope: Scope, role: Role) -> Person:
    """Who asks; Unauthorised if nobody is known, Forbidden if the role is not enough."""
    person: Person | None = scope[PERSON]
    if person is None:
        raise Unauthorised
    if person.role < role:
        raise Forbidden(
            f"this needs the role {role.word}, {person.name} has {person.role.word}; ask who keeps the file of users"
        )
    return person


def check_change(scope: Scope, given: str | None) -> None:
    """Refuse a change that a browser sends without the secret of its session, or from another site."""
    if not is_of_this_site(Headers(scope=scope), is_secure=scope["scheme"] == "https"):
        raise Forbidden("a page of another site sent this change; send it from a page of this server")
    person: Person | None = scope[PERSON]
    if person is None or person.csrf is None:
        return  # a token that no other site has
    if given is None or not hmac.compare_digest(given.encode(errors="surrogatepass"), person.csrf.encode()):
        raise Forbidden("the change lacks the secret of this session (X-CSRF-Token); load the page again")
