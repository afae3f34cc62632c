"""The commands `gyrofleet site`: the certificates of a site."""

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from stream.security.rights import Role, principal_of
from stream.terminal.command_group import CommandGroup
from stream.terminal.console import notes, print_json, reporting, results
from stream.terminal.result_table import ResultTable

if TYPE_CHECKING:
    from stream.security.certificate_authority import Issued

_FOLDER = click.argument("folder", type=click.Path(path_type=Path, file_okay=False))
_NAME = click.argument("name")
_WHO = click.argument("who", metavar="ROLE:NAME")
_DAYS = click.option(
    "--days", type=click.FloatRange(min=0.0, min_open=True, max=825.0), default=30.0, show_default=True,
    help="Length of the certificate's validity.",
)  # fmt: skip
_HOSTS = click.option(
    "--host", "hosts", multiple=True, help="Name or address of its computer, as others connect to it; may be repeated."
)


@click.group("site", cls=CommandGroup)
def site() -> None:
    """Make and end the certificates by which stations, recorders and people know each other on the bus."""


@site.command("init")
@_FOLDER
@_HOSTS
@_DAYS
@reporting
def init(folder: Path, hosts: tuple[str, ...], days: float, *, as_json: bool) -> None:
    """Make a site in a new FOLDER: its authority, and the certificate of a recorder of the name `recorder`."""
    from stream.security.certificate_authority import Site

    made = Site.create(folder).add(Role.RECORDER, "recorder", hosts=hosts, days=days)
    if as_json:
        print_json({"site": str(folder), "recorder": str(made)})
        return
    notes().print(f"made the site {folder}; ca.key in it stays there, with a copy in a safe", soft_wrap=True)
    results().print(f"{made}", soft_wrap=True)


def _added(folder: Path, role: Role, name: str, hosts: tuple[str, ...], days: float, *, as_json: bool) -> None:
    from stream.security.certificate_authority import Site

    made = Site(folder).add(role, name, hosts=hosts, days=days)
    if as_json:
        print_json({"role": role, "name": name, "folder": str(made)})
        return
    results().print(f"{made}", soft_wrap=True)
    notes().print(
        f"copy this folder to the computer of {role} {name} (--security FOLDER there), and the new access.json to the "
        f"folders of recorders and routers; they admit it after a restart",
        soft_wrap=True,
    )


@site.command("add")
@_FOLDER
@click.argument("role", type=click.Choice([str(each) for each in Role]))
@_NAME
@_HOSTS
@_DAYS
@reporting
def add(folder: Path, role: str, name: str, hosts: tuple[str, ...], days: float, *, as_json: bool) -> None:
    """Make the certificate and key of NAME in a ROLE; their folder is printed."""
    _added(folder, Role(role), name, hosts, days, as_json=as_json)


@site.command("add-station")
@_FOLDER
@_NAME
@_DAYS
@reporting
def add_station(folder: Path, name: str, days: float, *, as_json: bool) -> None:
    """Make the certificate of a station, which may send under its own NAME only."""
    _added(folder, Role.STATION, name, (), days, as_json=as_json)


@site.command("add-recorder")
@_FOLDER
@_NAME
@_HOSTS
@_DAYS
@reporting
def add_recorder(folder: Path, name: str, hosts: tuple[str, ...], days: float, *, as_json: bool) -> None:
    """Make the certificate of another recorder; only recorders acknowledge."""
    _added(folder, Role.RECORDER, name, hosts, days, as_json=as_json)


@site.command("add-estimator")
@_FOLDER
@_NAME
@_DAYS
@reporting
def add_estimator(folder: Path, name: str, days: float, *, as_json: bool) -> None:
    """Make the certificate of an estimator: estimates, verdicts, compensated signals."""
    _added(folder, Role.ESTIMATOR, name, (), days, as_json=as_json)


@site.command("add-approver")
@_FOLDER
@_NAME
@_DAYS
@reporting
def add_approver(folder: Path, name: str, days: float, *, as_json: bool) -> None:
    """Make the certificate of a person who may promote error models and enter specifications."""
    _added(folder, Role.APPROVER, name, (), days, as_json=as_json)


@site.command("renew")
@_FOLDER
@_WHO
@_HOSTS
@_DAYS
@reporting
def renew(folder: Path, who: str, hosts: tuple[str, ...], days: float, *, as_json: bool) -> None:
    """Prolong a certificate; its key stays."""
    from stream.security.certificate_authority import Site

    issued = Site(folder).renew(principal_of(who), days=days, hosts=hosts)
    if as_json:
        print_json(_row(issued))
    else:
        results().print(f"{issued.principal}: valid until {_moment(issued.until_ns)}")


@site.command("revoke")
@_FOLDER
@_WHO
@reporting
def revoke(folder: Path, who: str, *, as_json: bool) -> None:
    """Take ROLE:NAME off the access list; it is never renewed.

    Recorders and routers refuse it once they have the new access.json of this site and were restarted.
    """
    from stream.security.certificate_authority import Site

    opened = Site(folder)
    opened.revoke(principal_of(who))
    if as_json:
        print_json({"revoked": who})
        return
    results().print(f"{principal_of(who)} is revoked")
    notes().print("copy the new access.json to every recorder and router, and restart them now", soft_wrap=True)


@site.command("rules")
@_FOLDER
@reporting
def rules(folder: Path, *, as_json: bool) -> None:
    """Sign the rules of FOLDER/site.toml into the access lists, and show them.

    \b
    two_persons = ["models", "specifications", "certificates"]
    """  # noqa: D301  click's mark for lines that are not to be joined
    from stream.security.certificate_authority import Site

    found = Site(folder).publish()
    if as_json:
        print_json(found)
        return
    named = ", ".join(found.two_persons) or "nothing"
    results().print(f"two persons are needed for {named}")
    notes().print("copy the new access.json to every folder of recorders and approvers, and restart recorders")


@site.command("list")
@_FOLDER
@reporting
def list_site(folder: Path, *, as_json: bool) -> None:
    """List everybody on the site: role, name, end of the certificate, whether it is revoked."""
    from stream.security.certificate_authority import Site

    issued = Site(folder).issued
    if as_json:
        print_json([_row(each) for each in issued])
        return
    table = ResultTable("role", "name", "valid until", "state")
    for each in issued:
        table.add_row(each.principal.role, each.principal.name, _moment(each.until_ns), each.state)
    results().print(table)


def _row(issued: "Issued") -> dict[str, object]:
    principal = issued.principal
    return {
        "role": principal.role, "name": principal.name, "until_ns": issued.until_ns, "state": issued.state,
        "hosts": issued.hosts,
    }  # fmt: skip


def _moment(at_ns: int) -> str:
    return f"{datetime.fromtimestamp(at_ns / 1e9, UTC):%Y-%m-%d %H:%M} UTC"
