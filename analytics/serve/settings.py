"""How a server is to be reached, and by whom."""

from dataclasses import dataclass
from pathlib import Path

from analytics.serve.doors.origin import is_loopback
from analytics.serve.doors.roles import Role
from stream.errors import BadInput


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

    @property
    def is_secure(self) -> bool:
        """Whether it speaks TLS itself."""
        return self.certificate is not None

    @property
    def is_on_loopback(self) -> bool:
        """Whether it is reached from this machine only."""
        return is_loopback(self.host)

    def check(self) -> None:
        """Refuse to listen beyond loopback without users and TLS; BadInput names what is missing."""
        if (self.certificate is None) is not (self.key is None):
            raise BadInput("--certificate and --key belong together: give both files, or neither")
        for option, path in (("--certificate", self.certificate), ("--key", self.key)):
            if path is not None and not path.is_file():
                raise BadInput(f"{option} {path}: there is no such file")
        if self.is_on_loopback or self.trusts_network:
            return
        lacking = [
            text
            for text, is_there in (
                ("users (--users FILE; `gyrofleet users add` writes it)", self.users_path is not None),
                ("TLS (--certificate FILE --key FILE)", self.is_secure),
            )
            if not is_there
        ]
        if lacking:
            raise BadInput(
                f"--host {self.host} is reached from other machines, which needs {' and '.join(lacking)}; or say that "
                "only people whom you trust are on that network, or a proxy with TLS: --trust-network"
            )
