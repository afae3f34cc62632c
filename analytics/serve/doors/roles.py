"""People and programs, and what they may do."""

from dataclasses import dataclass
from enum import IntEnum
from typing import Self

from stream.errors import BadInput
from stream.security.actor import Actor, signed_in


class Role(IntEnum):
    """What a person may do; each role may do what those before it may."""

    VIEWER = 1  # read everything, ask in SQL
    OPERATOR = 2  # enter notes, command runs, verify the store
    ENGINEER = 3  # diagnose, promote and roll back error models
    APPROVER = 4  # approve, exclude runs from evaluation

    @property
    def word(self) -> str:
        """Its name in files and messages."""
        return self.name.lower()

    @classmethod
    def named(cls, word: str) -> Self:
        """The role with that name.

        >>> Role.named("engineer") > Role.named("viewer")
        True
        """
        try:
            return cls[word.upper()]
        except KeyError:
            raise BadInput(f"there is no role {word!r}: give one of {', '.join(ROLES)}") from None


ROLES = tuple(role.word for role in Role)


@dataclass(frozen=True)
class Person:
    """Who asks; `csrf` is the secret that changes from a browser must carry, None for programs with a token.

    The holder of the server's own token is nobody by name (`is_named`); a program is no second person.
    """

    name: str
    role: Role
    csrf: str | None = None
    is_named: bool = True
    is_program: bool = False

    @property
    def actor(self) -> Actor:
        """Who acts, for the log."""
        return signed_in(self.name) if self.is_named else Actor(self.name)
