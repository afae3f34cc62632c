"""The file of users: TOML with role and hashed password, hashed token, or certificate, of each.

[users.li]
role = "engineer"
password = "scrypt:..."

certificate = "CN=Li Wei,O=Plant"   # subject of a certificate that a proxy asks for

[users.dashboard]          # a program
role = "viewer"
token_sha256 = "..."
"""

import hashlib
import re
import secrets
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec
import tomli_w

from analytics.serve.doors.passwords import hashed, is_hash, matches
from analytics.serve.doors.roles import Person, Role
from stream.decoding import converted
from stream.errors import BadInput
from stream.files.atomic_file import write_durably
from stream.files.toml_text import decode_toml
from stream.security.file_modes import fault_of_rules

RoleWord = Literal["viewer", "operator", "engineer", "approver"]
_NAME = re.compile(r"[\w.@+-]{1,64}")
_SHA256 = re.compile(r"[0-9a-f]{64}")


class User(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """A person with a password, a program with a token, or either with a certificate."""

    role: RoleWord
    password: str = ""
    token_sha256: str = ""
    certificate: str = ""

    @property
    def fingerprint(self) -> str:
        """Changes with role, password and token: what was opened with another one ends."""
        return hashlib.sha256(msgspec.json.encode(self)).hexdigest()

    def person(self, name: str) -> Person:
        """The user as who asks."""
        return Person(name, Role.named(self.role), is_program=bool(self.token_sha256))


class _Content(msgspec.Struct, forbid_unknown_fields=True):
    users: dict[str, User] = {}


@dataclass(frozen=True)
class _Read:
    stamp: tuple[int, int, int]
    users: dict[str, User]
    by_token: dict[str, str]
    by_certificate: dict[str, str]


class UsersFile:
    """The users of a server, read again when the file changes; a file that cannot be read lets nobody in."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._read: _Read | None = None
        self.users()

    def users(self) -> dict[str, User]:
        """Users by name; BadInput if the file cannot be read."""
        return self._current().users

    def with_password(self, name: str, password: str) -> User | None:
        """The user of that name and password."""
        user = self.users().get(name)
        stored = user.password if user is not None and user.password else None
        return user if matches(password, stored) else None

    def with_token(self, token: str) -> tuple[str, User] | None:
        """The program with that token, and its name."""
        found = self._current()
        name = found.by_token.get(_sha256(token))
        return None if name is None else (name, found.users[name])

    def with_certificate(self, subject: str) -> tuple[str, User] | None:
        """The user with the certificate of that subject, and their name."""
        found = self._current()
        name = found.by_certificate.get(subject)
        return None if name is None else (name, found.users[name])

    def _current(self) -> _Read:
        try:
            status = self.path.stat()
            stamp = (status.st_mtime_ns, status.st_size, status.st_ino)
            if self._read is None or self._read.stamp != stamp:
                users = read_users(self.path)
                by_token = {user.token_sha256: name for name, user in users.items() if user.token_sha256}
                by_certificate = {user.certificate: name for name, user in users.items() if user.certificate}
                self._read = _Read(stamp, users, by_token, by_certificate)
        except OSError as error:
            raise BadInput(f"the file of users {self.path} cannot be read: {error.strerror or error}") from error
        return self._read


def read_users(path: Path) -> dict[str, User]:
    """Users of a file by name; BadInput names the fault. Whoever could write it could let anybody in."""
    if fault := fault_of_rules(path):
        raise BadInput(f"the file of users {path}: {fault}")
    try:
        content = decode_toml(path.read_bytes(), _Content)
    except msgspec.MsgspecError as error:
        raise BadInput(f"the file of users {path}: {error}; `gyrofleet users add` writes it") from error
    subjects: dict[str, str] = {}
    for name, user in content.users.items():
        _check_name(name, f"{path}: ")
        if bool(user.password) is bool(user.token_sha256) and (user.password or not user.certificate):
            raise BadInput(f"{path}: user {name} needs a password or a token_sha256, one of them, or a certificate")
        if user.certificate and (other := subjects.setdefault(user.certificate, name)) != name:
            raise BadInput(f"{path}: users {other} and {name} have the same certificate {user.certificate!r}")
        if user.password and not is_hash(user.password):
            raise BadInput(f"{path}: the password of user {name} is not hashed; set it with `gyrofleet users add`")
        if user.token_sha256 and _SHA256.fullmatch(user.token_sha256) is None:
            raise BadInput(f"{path}: token_sha256 of user {name} is not 64 hexadecimal digits")
    return content.users


def add_person(path: Path, name: str, role: Role, password: str) -> None:
    """Add a person to a file, created if there is none, or replace role and password of one."""
    _put(path, name, User(role=_word(role), password=hashed(password)))


def add_certificate(path: Path, name: str, role: Role, subject: str) -> None:
    """Add or replace a user whom a proxy knows by the subject of a certificate."""
    if not subject.strip() or not subject.isprintable():
        raise BadInput(f"{subject!r} is not the subject of a certificate, as CN=Li Wei,O=Plant")
    others = read_users(path) if path.exists() else {}
    if (taken := next((each for each, user in others.items() if user.certificate == subject), name)) != name:
        raise BadInput(f"{path}: user {taken} has the certificate {subject!r} already")
    _put(path, name, User(role=_word(role), certificate=subject.strip()))


def add_program(path: Path, name: str, role: Role) -> str:
    """Add or replace a program; returns its token, which is stored nowhere."""
    token = secrets.token_urlsafe(32)
    _put(path, name, User(role=_word(role), token_sha256=_sha256(token)))
    return token


def remove_user(path: Path, name: str) -> None:
    """Remove a user; its sessions end."""
    users = read_users(path) if path.exists() else {}
    if name not in users:
        raise BadInput(f"{path} has no user {name!r}; it has {', '.join(users) or 'none'}")
    del users[name]
    _write(path, users)


def _put(path: Path, name: str, user: User) -> None:
    _check_name(name)
    _write(path, (read_users(path) if path.exists() else {}) | {name: user})


def _write(path: Path, users: dict[str, User]) -> None:
    content = {"users": {name: msgspec.to_builtins(user) for name, user in sorted(users.items())}}
    try:
        write_durably(path, tomli_w.dumps(content).encode(), mode=0o600)
    except OSError as error:
        raise BadInput(f"cannot write {path}: {error.strerror or error}; give --users a file you can write") from error


def is_name(text: str) -> bool:
    """Whether a text can be a user's name."""
    return _NAME.fullmatch(text) is not None


def _check_name(name: str, where: str = "") -> None:
    if not is_name(name):
        raise BadInput(f"{where}{name!r} cannot be a user's name: 1 to 64 letters, digits or . @ + - _ are expected")


def _word(role: Role) -> RoleWord:
    word: RoleWord = converted(role.word, RoleWord)
    return word


def _sha256(token: str) -> str:
    # a token has 256 random bits: a slow hash would add nothing
    return hashlib.sha256(token.encode(errors="surrogatepass")).hexdigest()
