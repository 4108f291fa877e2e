"""Options that commands of studies share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import typer

from controller.laws import COMPARED_LAWS
from deploy.cli.parts.options import Confirm, Out, Overrides, Overwrite
from deploy.scenario.yaml_files import option_value, parse_override

DEFAULT_LAWS = f"by default {', '.join(COMPARED_LAWS)}, and the scenario's"


@dataclass(kw_only=True)
class WorkerOptions:
    """The options of every command with many runs."""

    overrides: Overrides = None
    workers: Annotated[
        int | None, typer.Option(min=1, help="Number of processes; one per core by default.")
    ] = None
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="A Dask scheduler: tcp://host:8786.")
    ] = None
    out: Out = None
    overwrite: Overwrite = False

    def fixed(self) -> dict[str, Any]:
        """Return the values of ``--set`` by dotted key."""
        return dict(map(parse_override, self.overrides or []))


@dataclass(kw_only=True)
class StudyOptions(WorkerOptions):
    """The options of studies that can draw uncertain plants."""

    plants: Annotated[
        int | None, typer.Option(metavar="N", help="Number of uncertain plants to draw.")
    ] = None
    plant_seed: Annotated[int | None, typer.Option(help="Seed of the drawn plants; default 1.")] = (
        None
    )
    uncertainty: Annotated[
        str | None, typer.Option(help="A file of ranges to draw from; shipped are full, half.")
    ] = None

    def definition(self) -> dict[str, Any]:
        """Return the given part of a study's definition, without values from ``--set``."""
        given = {
            "plants": self.plants, "plant_seed": self.plant_seed, "uncertainty": self.uncertainty,
        }  # fmt: skip
        return {key: value for key, value in given.items() if value is not None}


@dataclass(kw_only=True)
class ConfirmedStudyOptions(StudyOptions):
    """The options that `sweep` and `margin` have in common."""

    confirm: Confirm = False

    def definition(self) -> dict[str, Any]:
        return super().definition() | ({"confirm": True} if self.confirm else {})


def listed(name: str, text: str | None) -> list[Any] | None:
    """Return the values in ``a,b,…``, with the types of YAML."""
    option = f"--{name.replace('_', '-')}"
    return None if text is None else [option_value(option, part) for part in text.split(",")]
