"""Section ``controller.external`` of a scenario."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from bus_schema.configuration import Positive, StrictModel

Word = Annotated[str, Field(min_length=1)]


class ExternalLawConfiguration(StrictModel):
    """The program of ``controller.law: external``.

    Attributes:
        command: the program and its arguments; started in the current folder, without a shell.
        timeout_s: wall time it may take for an answer.
        start_timeout_s: wall time from its start to its first answer.
    """

    command: Annotated[tuple[Word, ...], Field(min_length=1)]
    timeout_s: Positive = 1.0
    start_timeout_s: Positive = 10.0
