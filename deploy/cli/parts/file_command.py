"""Commands of the kinds of study that installed packages add: each runs a definition file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import typer

from deploy.cli.parts.options import Confirm, GateOptions, taking
from deploy.cli.parts.study_command import run_study
from deploy.cli.parts.study_options import WorkerOptions
from deploy.reports.kinds import study_type
from deploy.scenario.yaml_files import naming
from deploy.study.definition import study_values


@dataclass(kw_only=True)
class FileOptions(GateOptions, WorkerOptions):
    """The options of a study that a file defines."""

    file: Annotated[str, typer.Argument(metavar="FILE", help="The definition, a YAML file.")]
    confirm: Confirm = False


def command_of(kind: str) -> Callable[..., Any]:
    """Return the command of a kind of study."""

    @taking(FileOptions)
    def command(options: FileOptions) -> None:
        """Run the study in a file.

        After an interruption or a kill, the same command continues.
        """
        more = {"confirm": True} if options.confirm else {}
        values, path = study_values(options.file, more, options.fixed())
        with naming(path):
            study = study_type(kind)
        run_study(study(values, path), options)

    return command
