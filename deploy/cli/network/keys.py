"""Make, issue and list keys and certificates for link.security."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bus_schema.link.configuration import DEFAULT_FOLDER, KeyFolder
from bus_schema.messages.topics import Role
from deploy.reports.terminal import open_table
from deploy.run.console import Console
from deploy.run.network.keys import common_name, create_authority, hosts_of, issue, read_certificate

app = typer.Typer(help=__doc__, no_args_is_help=True, add_completion=False)

_LOCAL = ("localhost", "127.0.0.1", "::1")
Folder = Annotated[Path, typer.Option("--folder", help="Folder of the keys: link.security.folder.")]
Hosts = Annotated[
    list[str] | None,
    typer.Option(
        "--host",
        help="Host name or IP address under which plant or controller are reached; repeatable."
        " Added to those of this machine itself.",
    ),
]
Days = Annotated[float, typer.Option("--days", min=0.01, max=3650, help="Validity in days.")]


@app.command("init")
def init(
    folder: Folder = Path(DEFAULT_FOLDER),
    hosts: Hosts = None,
    days: Days = 30.0,
    authority_days: Annotated[
        float, typer.Option(min=0.01, max=3650, help="Validity of the authority in days.")
    ] = 365.0,
) -> None:
    """Make a certificate authority, and a certificate for each role."""
    create_authority(KeyFolder.at(folder), authority_days)
    issue_roles(list(Role), folder, hosts, days)


@app.command("issue")
def issue_roles(
    roles: Annotated[list[Role], typer.Argument(help="Roles that get a new key.")],
    folder: Folder = Path(DEFAULT_FOLDER),
    hosts: Hosts = None,
    days: Days = 30.0,
) -> None:
    """Replace the keys and certificates of roles by new ones."""
    keys = KeyFolder.at(folder)
    for role in roles:
        issue(keys, role, [*_LOCAL, *(hosts or [])], days)
    show_all(folder)


@app.command("list")
def show_all(folder: Folder = Path(DEFAULT_FOLDER)) -> None:
    """List the certificates with role, hosts and validity."""
    keys = KeyFolder.at(folder)
    rows = []
    files = [keys.authority, *(keys.certificate(role) for role in Role)]
    for file in files:
        if file is keys.authority or file.is_file():
            certificate = read_certificate(file, f"run `funnel-hil keys init --folder {keys.path}`")
            serial, end = certificate.serial_number, certificate.not_valid_after_utc
            hosts = ", ".join(hosts_of(certificate))
            rows.append(
                [common_name(certificate), f"{serial:x}"[:16], f"{end:%Y-%m-%d %H:%M}", hosts]
            )
    headings = ["role", "serial number", "valid until, UTC", "hosts"]
    Console().print(open_table(str(keys.path), headings, rows))
