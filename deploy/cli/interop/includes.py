"""`includes`: where the C header for laws in programs of their own is."""

from __future__ import annotations

from pathlib import Path

import typer

import controller.external


def includes() -> None:
    """Print the C compiler's option for the header of controller.law: external."""
    typer.echo(f"-I{Path(controller.external.__file__).parent}")
