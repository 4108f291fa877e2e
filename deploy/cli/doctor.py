"""`funnel-hil doctor`."""

from __future__ import annotations

from rich.console import Console

from deploy.processes.doctor import examine, show


def doctor() -> None:
    """Say what this machine grants, and what each missing thing costs."""
    show(examine(), Console())
