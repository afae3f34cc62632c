"""The command `gyrofleet serve`: pages and an HTTP API over a store, for browsers and programs."""

import faulthandler
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from analytics.serve.doors.roles import ROLES, Role
from stream.roles.config_file import configured
from stream.roles.role_log import RoleLog, logged
from stream.terminal.console import print_json, reporting, results, store_option
from stream.terminal.option_checks import WRONG_USE, options_checked

if TYPE_CHECKING:
    from analytics.serve.settings import Settings


def _settings(*, token_role: str, url: str, **given: Any) -> "Settings":
    from analytics.serve.settings import Settings

    return Settings(token_role=Role.named(token_role), url=url.rstrip("/"), **given)


def _check(options: Mapping[str, Any]) -> None:
    names = ("host", "port", "users_path", "names", "certificate", "key", "trusts_network", "login_path", "url")
    _settings(token_role=ROLES[0], token="", **{name: options[name] for name in names}).check()


@click.command("serve")
@store_option
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to listen on.")
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=8766,
    show_default=True,
    help="Port to listen on; 0 for a free one.",
)
@click.option(
    "--token", envvar="GYROFLEET_TOKEN", metavar="TEXT",
    help="Token of programs and for the first login, also as GYROFLEET_TOKEN; by default a new one is printed.",
)  # fmt: skip
@click.option(
    "--token-role", type=click.Choice(ROLES),
    help="What the holder of the token may do; by default all, with --users or --login only read.",
)  # fmt: skip
@click.option(
    "--users", "users_path", type=click.Path(path_type=Path, dir_okay=False),
    help="File of users with roles, which `gyrofleet users add` writes.",
)  # fmt: skip
@click.option(
    "--name", "names", multiple=True, metavar="HOST", help="Name by which browsers call this host; may be repeated."
)
@click.option("--certificate", type=click.Path(path_type=Path), help="Certificate chain for TLS, PEM.")
@click.option("--key", type=click.Path(path_type=Path), help="Private key of the certificate, PEM.")
@click.option(
    "--login", "login_path", type=click.Path(path_type=Path, dir_okay=False),
    help="File of logins by a provider of OpenID Connect, or by client certificates through a proxy (TOML).",
)  # fmt: skip
@click.option(
    "--url", default="", metavar="URL",
    help="Address by which browsers call this server, as https://bench7.plant, where it is not the one it listens on.",
)  # fmt: skip
@click.option("--trust-network", "trusts_network", is_flag=True, help="Listen beyond loopback without users or TLS.")
@configured("serve")
@reporting
@logged("serve")
@options_checked(_check, exit_code=WRONG_USE)
def serve(
    folder: Path, host: str, port: int, token: str | None, token_role: str | None, users_path: Path | None,
    names: tuple[str, ...], certificate: Path | None, key: Path | None, login_path: Path | None, url: str, *,
    trusts_network: bool, as_json: bool,
) -> None:  # fmt: skip
    """Serve pages and an HTTP API over a store, to browsers and programs; Ctrl-C ends it.

    It listens on loopback and prints an address with a token that logs a browser in. Programs send the token as
    `Authorization: Bearer TOKEN`; /api/openapi.json describes the API. With --users people log in by name.

    \b
    gyrofleet serve --store night
    gyrofleet users add li --role engineer --users users.toml
    gyrofleet serve --users users.toml --host 0.0.0.0 --certificate c --key k
    """  # noqa: D301  click's mark for lines that are not to be joined
    import starlette  # noqa: F401  a sentence names the extra where it is absent
    import uvicorn  # noqa: F401

    from analytics.serve.server import serve as serve_store
    from storage.sql.sandbox.landlock import WITHOUT_LANDLOCK, landlock_version
    from storage.store import Store

    store = Store.open(folder)
    is_new = not token and users_path is None and login_path is None
    role = token_role or ("approver" if users_path is None and login_path is None else "viewer")
    settings = _settings(
        host=host, port=port, token=token or (secrets.token_urlsafe(24) if is_new else ""), token_role=role,
        users_path=users_path, names=names, certificate=certificate, key=key, trusts_network=trusts_network,
        login_path=login_path, url=url,
    )  # fmt: skip

    def say(url: str) -> None:
        login = f"{url}/login?token={settings.token}" if is_new else url
        if as_json:
            print_json({"event": "ready", "url": url, "login": login, "port": int(url.rpartition(":")[2])})
        else:
            results().print(f"serving {folder}: {login}", soft_wrap=True)

    log = RoleLog("serve")
    if landlock_version() == 0:
        log.write("warning", "no_landlock", WITHOUT_LANDLOCK)
    faulthandler.enable()  # a crash of a library says where
    serve_store(store, settings, say)
    if as_json:
        print_json({"event": "ended"})
    else:
        log.write("info", "ended", "server ended")
