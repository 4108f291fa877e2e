"""The gate of a command: it ends with exit code 3 if a margin is too small."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.console import Console

from deploy.cli.options import GateOptions
from deploy.reports.gate import build_gate, gauged, require_unit


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
        self._gate = build_gate(options.at_least, options.baseline, options.tolerance)
        require_unit(self._gate, unit)
        self._options, self._name, self._unit = options, name, unit
        self._files = [options.junit, options.markdown, options.history]
        self._entries = []
        if options.history is not None:
            from deploy.reports.gate_files import read_history

            self._entries = read_history(options.history)

    def is_passed(self, summary: Mapping[str, Any], console: Console) -> bool:
        """Write the files, print what failed, and return whether the result is good enough."""
        found = gauged(summary)
        failures = self._gate.failures(found)
        if any(self._files):
            from deploy.reports import gate_files  # draws

            if self._entries:
                failures |= {
                    each.name: failures[each.name] + gate_files.since_when(self._entries, each)
                    for each in found if each.name in failures
                }  # fmt: skip
            junit, markdown, history = self._files
            if junit is not None:
                gate_files.write_junit(junit, found, failures)
            if markdown is not None:
                gate_files.write_markdown(markdown, found, failures)
            if history is not None:
                entries = [*self._entries, gate_files.entry_of(found)]
                gate_files.write_history(history, self._name, entries, self._unit)
        for sentence in failures.values():
            console.print(f"gate: {sentence}", style="bold red", markup=False, soft_wrap=True)
        return not failures
