"""The table of faults: what each shipped fault scenario does to a run, as measured.

`python -m scripts.experiments.fault_table` runs them all and writes the table into its page.
Faults of plant or recorder as a process need real ones and run in lockstep; all others are
simulated. Either way they are the same on every machine.
"""

from __future__ import annotations

import logging
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bus_schema.messages import topics
from bus_schema.messages.topics import Role
from bus_schema.runtime.modes import Mode
from deploy.judge.metrics import summarise
from deploy.judge.run_data import RunData
from deploy.run.execute import execute
from deploy.run.run_folder import load_run
from deploy.scenario.scenario import SHIPPED, load_setup
from deploy.scenario.setup import Setup
from plant_emulator.faults.process_faults import process_faults

BEGIN = "<!-- fault table: python -m scripts.experiments.fault_table -->\n"
END = "<!-- end of fault table -->\n"
_HEADER = """\
| scenarios | reaction | to safe state | exit code |
|---|---|---|---|
"""
PAGE = Path(__file__).resolve().parents[2] / "deploy" / "docs" / "how-to" / "faults.md"
_TICKS_OF_GRACE = 2


class Outcome(NamedTuple):
    """Outcome of a run with a fault.

    Attributes:
        code: exit code of the run.
        to_safe_state_ms: from the last torque that came into force to the begin of the safe stop;
            None without one.
        recorded_anew: a second recorder went on where the first one ended.
    """

    run: RunData
    summary: dict[str, Any]
    code: int
    to_safe_state_ms: float | None
    recorded_anew: bool = False

    @property
    def allowed_ms(self) -> float:
        """Within which a silent arm must begin to stop."""
        period_ms = self.run.setup.grid.period_ns * 1e-6
        return self.run.setup.scenario.plant.command_timeout_ms + _TICKS_OF_GRACE * period_ms


def fault_scenarios() -> list[str]:
    """Names of the shipped scenarios with a fault."""
    return [f"faults/{file.stem}" for file in sorted((SHIPPED / "faults").glob("*.yaml"))]


def needs_processes(setup: Setup) -> bool:
    """Whether a fault is of a process that a simulation has not."""
    faults = process_faults(setup.scenario.faults)
    return any(Role(fault.target) is not Role.CONTROLLER for fault in faults)


def measure(name: str) -> Outcome:
    """Run one of the scenarios, in virtual time."""
    setup = load_setup(name)
    if needs_processes(setup):
        return _run(name)
    run = execute(setup)
    code = int(not run.summary["completed"])
    return Outcome(run.data, run.summary, code, to_safe_state_ms(run.data))


def to_safe_state_ms(run: RunData) -> float | None:
    """From the last torque that came into force to the begin of the safe stop, ms."""
    truth = run.tables[topics.PLANT_TRUTH.name]
    stopped_s = run.times_s(topics.PLANT_TRUTH)[np.isin(truth["mode"], (Mode.STOPPING, Mode.FAULT))]
    commanded_s = run.times_s(topics.PLANT_TRUTH)[truth["round_trip_ns"] >= 0]
    commanded_s = commanded_s[commanded_s <= stopped_s[0]] if len(stopped_s) else commanded_s
    if not len(stopped_s) or not len(commanded_s):
        return None
    return round(1e3 * float(stopped_s[0] - commanded_s[-1]), 6)


def table() -> str:
    """The table as Markdown, from new runs: a row for all scenarios of one outcome."""
    found: dict[str, list[str]] = {}
    for name in fault_scenarios():
        found.setdefault(_cells(measure(name)), []).append(f"`{name}`")
    return _HEADER + "".join(
        f"| {', '.join(names)} | {cells} |\n" for cells, names in found.items()
    )


def _run(name: str) -> Outcome:
    with tempfile.TemporaryDirectory() as folder:
        words = ["run", name, "--set", "clock=lockstep", "--out", folder]
        ended = subprocess.run(
            [sys.executable, "-m", "deploy.cli", *words], capture_output=True, check=False
        )
        data, _ = load_run(Path(folder))
        summary = summarise(data)
        recorded_anew = Path(folder, "run-2.mcap").exists()
        return Outcome(data, summary, ended.returncode, to_safe_state_ms(data), recorded_anew)


def _cells(outcome: Outcome) -> str:
    time_ms = outcome.to_safe_state_ms
    time = "—" if time_ms is None else f"{time_ms:g} ms"
    return f"{_reaction(outcome)} | {time} | {outcome.code}"


def _reaction(outcome: Outcome) -> str:
    bounds, run = outcome.summary["bounds"], outcome.run
    if outcome.to_safe_state_ms is not None:
        return f"safe stop ({run.setup.scenario.plant.safe_stop})"
    if outcome.recorded_anew:
        return "continues, a second recording begins"
    if outcome.code:
        return "the run ends"
    lost_at = f" at {bounds['first_violation_s']:g} s" if bounds["violation_fraction"] else ""
    return f"continues, bounds {outcome.summary['verdict']}{lost_at}"


def main() -> None:
    """Write the table into its page."""
    logging.disable()
    text = PAGE.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    _, after = rest.split(END)
    PAGE.write_text(f"{before}{BEGIN}{table()}{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
