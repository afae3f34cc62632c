"""Errors as answers: status, kind and a sentence, never a traceback."""

from stream.errors import (
    BadInput,
    BusError,
    DeliveryError,
    GyrofleetError,
    NotEnoughData,
    NotFound,
    OutOfMemory,
    QueryError,
    StoreError,
)


class HttpProblem(GyrofleetError):
    """A request that is refused before it reaches the store."""

    status = 400


class Unauthorised(HttpProblem):
    """Nobody is known by this token or session."""

    status = 401

    def __init__(self) -> None:
        super().__init__(
            "this needs a login: send `Authorization: Bearer TOKEN` with the token that `gyrofleet serve` printed, or "
            "open /login in a browser"
        )


class Forbidden(HttpProblem):
    """A role that may not do this, or a change that another site sent."""

    status = 403


class WrongMethod(HttpProblem):
    """A resource that has no such method."""

    status = 405


class NotAcceptable(HttpProblem):
    """A form of the answer that a resource does not have."""

    status = 406


class Conflict(HttpProblem):
    """A change that needs a confirmation, or that something else is in the way of."""

    status = 409


class TooSlow(HttpProblem):
    """A request whose body does not come."""

    status = 408


class TooLarge(HttpProblem):
    """A request that is too long."""

    status = 413


class Misdirected(HttpProblem):
    """A request for another host."""

    status = 421


class TooMany(HttpProblem):
    """Too many tries; another one may come after `wait_s`."""

    status = 429

    def __init__(self, what: str, wait_s: float) -> None:
        super().__init__(f"{what}; try again in {max(wait_s, 1.0):.0f} s")
        self.wait_s = wait_s


class Stopping(HttpProblem):
    """A request that the server does not finish, because it stops."""

    status = 503

    def __init__(self) -> None:
        super().__init__("the server stops; ask again after its restart")


_STATUS: tuple[tuple[type[GyrofleetError], int], ...] = (
    (BadInput, 400),
    (QueryError, 400),
    (NotFound, 404),
    (NotEnoughData, 422),
    (StoreError, 503),
    (OutOfMemory, 503),
    (BusError, 503),
    (DeliveryError, 503),
)


def status_of(error: GyrofleetError) -> int:
    """The HTTP status of an error.

    >>> status_of(NotFound("unit")), status_of(TooMany("logins", 3.0))
    (404, 429)
    """
    if isinstance(error, HttpProblem):
        return error.status
    return next((status for kind, status in _STATUS if isinstance(error, kind)), 500)


def document_of(error: GyrofleetError) -> dict[str, dict[str, str]]:
    """An error in the JSON form that commands print with --json."""
    kind = next(each.__name__ for each in type(error).__mro__ if not each.__name__.startswith("_"))
    return {"error": {"kind": kind, "message": str(error)}}


def headers_of(error: GyrofleetError) -> dict[str, str]:
    """Headers that belong to an error."""
    if isinstance(error, Unauthorised):
        return {"WWW-Authenticate": 'Bearer realm="gyrofleet"'}
    if isinstance(error, TooMany):
        return {"Retry-After": f"{max(error.wait_s, 1.0):.0f}"}
    return {}
