"""How a server is to be reached, and by whom."""

from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from analytics.serve.doors.login_file import LoginFile
from analytics.serve.doors.origin import is_loopback
from analytics.serve.doors.roles import Role
from analytics.serve.doors.users_file import UsersFile
from stream.errors import BadInput
from stream.terminal.option_checks import about


@dataclass(frozen=True)
class Settings:
    """Settings of a server.

    Parameters
    ----------
    host: Address to listen on.
    port: Port to listen on; 0 for any that is free.
    token: Token of the server; empty for none.
    token_role: What its holder may do.
    users_path: File of users, if there is one.
    names: Names of the host by which browsers call it, besides addresses and localhost.
    certificate, key: Files of TLS, both or none.
    trusts_network: Listen beyond loopback without users or TLS.
    login_path: File of logins by a provider or through a proxy, if there is one.
    url: How browsers reach the server, as ``https://bench7.plant``; empty for the address that it listens on.
    """

    host: str
    port: int
    token: str
    token_role: Role
    users_path: Path | None = None
    names: tuple[str, ...] = ()
    certificate: Path | None = None
    key: Path | None = None
    trusts_network: bool = False
    login_path: Path | None = None
    url: str = ""

    @property
    def is_secure(self) -> bool:
        """Whether browsers reach it by TLS, its own or that of a proxy."""
        return self.url.startswith("https://") or (not self.url and self.certificate is not None)

    @property
    def all_names(self) -> tuple[str, ...]:
        """Names of the host, that of the URL as well."""
        name = urlsplit(self.url).hostname
        return (*self.names, name) if name else self.names

    @property
    def is_on_loopback(self) -> bool:
        """Whether it is reached from this machine only."""
        return is_loopback(self.host)

    def check(self) -> None:
        """Refuse files that cannot be used, and to listen beyond loopback without users and TLS; BadInput says why."""
        if (self.certificate is None) is not (self.key is None):
            with about("key" if self.key is None else "certificate"):
                raise BadInput("--certificate and --key belong together: give both files, or neither")
        for option, path in (("certificate", self.certificate), ("key", self.key)):
            if path is not None and not path.is_file():
                with about(option):
                    raise BadInput(f"--{option} {path}: there is no such file")
        if self.users_path is not None:
            with about("users_path"):
                UsersFile(self.users_path)
        if self.login_path is not None:
            with about("login_path"):
                LoginFile.read(self.login_path).check_secrets()
        with about("url"):
            self._check_url()
        with about("host"):
            self._check_reach()

    def _check_url(self) -> None:
        if self.url and not _is_site(self.url):
            raise BadInput(f"--url {self.url!r} is not the address of a server without a path, as https://bench7.plant")
        if self.url.startswith("http://") and self.certificate is not None:
            raise BadInput(f"--url {self.url} is without TLS, but the server has a certificate; write https://")

    def _check_reach(self) -> None:
        if self.is_on_loopback or self.trusts_network:
            return
        lacking = [
            text
            for text, is_there in (
                (
                    "users (--users FILE; `gyrofleet users add` writes it)",
                    self.users_path is not None or self.login_path is not None,
                ),
                ("TLS (--certificate FILE --key FILE)", self.certificate is not None),
            )
            if not is_there
        ]
        if lacking:
            raise BadInput(
                f"--host {self.host} is reached from other machines, which needs {' and '.join(lacking)}; or say that "
                "only people whom you trust are on that network, or a proxy with TLS: --trust-network"
            )


def _is_site(url: str) -> bool:
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        return False
    return (
        url == f"{parts.scheme}://{parts.netloc}"
        and parts.scheme in {"http", "https"}
        and (bool(parts.hostname) and port != 0 and "@" not in parts.netloc and url.isascii() and url.isprintable())
    )
