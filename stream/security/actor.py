"""Who acts: the principal of a certificate, a user who has signed in, or whom a command names without proof."""

import getpass
from typing import NamedTuple

from stream.errors import BadInput
from stream.security.credentials import process_security

UNAUTHENTICATED = "unauthenticated"  # stands in the log: `by` is what somebody typed
_SIGNED_IN = "user:"


class Actor(NamedTuple):
    """Who acts, and as whom they have proved themselves: ``approver:li``, ``user:li``, or `UNAUTHENTICATED`.

    >>> Actor("Li").is_authenticated, signed_in("li").identity
    (False, 'user:li')
    """

    name: str
    identity: str = UNAUTHENTICATED

    @property
    def is_authenticated(self) -> bool:
        """Whether the identity is proved."""
        return self.identity != UNAUTHENTICATED

    def is_same_person(self, identity: str) -> bool:
        """Whether an identity is of the same name, by whichever door it came in.

        >>> Actor("approver:li", "approver:li").is_same_person("user:Li")
        True
        """
        return self.identity.partition(":")[2].casefold() == identity.partition(":")[2].casefold()


def signed_in(name: str) -> Actor:
    """A user who has signed in at the pages."""
    return Actor(name, _SIGNED_IN + name)


def acting(claimed: str | None, *, may_be_user: bool = True) -> Actor:
    """Who acts in this process: the principal of its certificate, else whom `--by` names, else the system's user.

    Raises BadInput if `--by` names somebody else than the certificate: the log has one name, and that one is proved.
    Unless it `may_be_user`, somebody has to be named where there is no certificate.
    """
    credentials = process_security().credentials
    given = (claimed or "").strip()
    if credentials is None:
        if not (given or may_be_user):
            raise BadInput("--by is missing: say who does it, or give --security FOLDER of a certificate")
        return Actor(given or getpass.getuser())
    principal = credentials.principal
    if given and given.casefold() not in {principal.common_name.casefold(), principal.name.casefold()}:
        raise BadInput(
            f"--by {given!r} names somebody else than the certificate, which is of {principal}: leave --by out, or "
            "give the --security folder of that person"
        )
    return Actor(principal.common_name, principal.common_name)
