"""Names the user's code that a command runs, before it runs."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING

from bus_schema.foreign_text import say

if TYPE_CHECKING:  # the command line needs this module before it loads the program
    from deploy.scenario.checking.explanation import Origin
    from deploy.scenario.definition import ScenarioConfiguration

_printed: ContextVar[set[str] | None] = ContextVar("lines that were printed", default=None)


@contextmanager
def code_is_named() -> Iterator[None]:
    """Let `name_code` write to standard error while the context lasts, each line once."""
    before = _printed.set(set())
    try:
        yield
    finally:
        _printed.reset(before)


def name_code(scenario: ScenarioConfiguration, origin: Origin) -> None:
    """Name the user's law or program that a scenario is about to run."""
    from controller.laws.custom import EXTERNAL, are_left_out, is_custom
    from controller.policies.configuration import is_address

    shown_lines, controller, does = _printed.get(), scenario.controller, "runs code"
    if shown_lines is None or are_left_out():
        return
    if controller.process is not None:
        key, what = "controller.process", f"program {shlex.join(controller.process)}"
    elif controller.law == EXTERNAL and controller.external is not None:
        key, what = "controller.law", f"program {shlex.join(controller.external.command)}"
    elif is_address(controller.law):
        key, what, does = "controller.law", controller.law, "asks the policy server"
    elif is_custom(controller.law):
        key, what = "controller.law", f"law {controller.law}"
    else:
        return
    line = f"{does} of {origin.of(key)}: {what}"
    if line not in shown_lines:
        shown_lines.add(line)
        say(line, err=True)
