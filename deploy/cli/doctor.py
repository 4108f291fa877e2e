"""`funnel-hil doctor`."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.console import Console

from deploy.processes.doctor import examine, show
from deploy.processes.lacking import remedy


def doctor(
    fix: Annotated[
        bool,
        typer.Option("--fix", help="Show commands to copy that allow real-time runs to this user."),
    ] = False,
) -> None:
    """Say what this machine grants, and what each missing thing costs; nothing is changed."""
    if fix:
        print(remedy())
        return
    show(examine(), Console())
