"""The gate of a command: it ends with exit code 3 if a margin is too small."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console

from deploy.cli.options import GateOptions
from deploy.reports import gate


class CommandGate:
    """The gate of a command, checked before anything starts.

    Args:
        options: what it must reach.
        name: of what is gated.
        unit: of its numbers.

    Raises:
        ScenarioError: the options cannot be used with this result.
    """

    def __init__(self, options: GateOptions, name: str, unit: str) -> None:
        self._gate = gate.build_gate(options.at_least, options.baseline, options.tolerance)
        gate.require_unit(self._gate, unit)
        self._options, self._name, self._unit = options, name, unit
        self._entries = [] if options.history is None else gate.read_history(options.history)

    def is_passed(self, summary: Mapping[str, Any], console: Console) -> bool:
        """Whether a result reaches what it must; writes the files, and prints what failed."""
        options, found = self._options, gate.gauged(summary)
        failures = self._gate.failures(found)
        failures |= {
            each.name: failures[each.name] + gate.since_when(self._entries, each)
            for each in found
            if each.name in failures
        }
        if options.junit is not None:
            gate.write_junit(options.junit, found, failures)
        if options.markdown is not None:
            gate.write_markdown(options.markdown, found, failures)
        if options.history is not None:
            entries = [*self._entries, gate.entry_of(found)]
            gate.write_history(options.history, self._name, entries, self._unit)
        for sentence in failures.values():
            console.print(f"gate: {sentence}", style="bold red", markup=False, soft_wrap=True)
        return not failures
