"""Confirmation of a result on other physics: the same run on the other engine, and by Runge-Kutta.

Controller, channel and hardware are unchanged; only the rigid-body dynamics and the integration
over a substep differ.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from bus_schema.configuration import ConfigurationError
from bus_schema.errors import RobotDescriptionError
from deploy.judge.metrics import judge
from deploy.judge.run_data import RunData
from deploy.judge.run_rows import Row, held
from deploy.judge.run_rows import row as run_row
from deploy.run.execute import How, JudgedRun, execute
from deploy.run.run_folder import RunFolderError, load_run
from deploy.run.stop_signals import end_if_asked
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import ScenarioError, naming
from plant_emulator.configuration import PhysicsConfiguration
from plant_emulator.faults.process_faults import process_faults
from plant_emulator.physics.engines import ENGINES, engine_name, physics_text

CONFIRMATION = "confirmation"
"""Key of `confirmations` in ``summary.json``."""
NEAR_ZERO = 0.03
"""Different verdicts are too close to call if either smallest margin is within this share of the
bound: either physics may be right."""

CONFIRMATION_COLUMNS = {
    "confirmed_on": "list<string>",
    "confirmed_kept": "list<bool>",
    "confirmed_margin_min": "list<double>",
    "confirmed_error_difference_rad": "list<double>",
}
"""Names and Parquet types of a row's columns about the same run on other physics."""


def check_confirmable(setup: Setup) -> None:
    """Check that a scenario can be simulated on other physics.

    Raises:
        ScenarioError: its controller is a separate process, there is no other physics, or the other
            physics cannot load the arm.
    """
    process = setup.scenario.controller.process
    if process is not None:
        _refuse(setup, "controller.process", list(process), "left out, as one process simulates it")
    others = other_physics(setup)
    for name, other in others.items():
        plant = other.scenario.plant
        try:
            ENGINES[engine_name(plant)].arm_type.check(setup.robot, plant.payload_kg, gui=False)
        except RobotDescriptionError as error:
            raise ScenarioError(f"--confirm: {name} cannot load this arm: {error}") from error
    if not others:
        raise ScenarioError(
            "--confirm: no other physics engine is installed: "
            + " or ".join(engine.installed_by for engine in ENGINES.usable(()).values())
        )


def check_repeatable(setup: Setup) -> None:
    """Check that a simulation of a scenario must equal its run in processes.

    Raises:
        ScenarioError: it is not in lockstep, has a user's process, or has faults of processes.
    """
    scenario = setup.scenario
    if scenario.clock != "lockstep":
        allowed = "lockstep: only runs in virtual time are the same"
        _refuse(setup, "clock", scenario.clock, allowed)
    if scenario.controller.process is not None or process_faults(scenario.faults):
        kinds = [fault.kind for fault in scenario.faults]
        allowed = "without controller.process and faults of processes, as one process simulates it"
        _refuse(setup, "faults", kinds, allowed)


def _refuse(setup: Setup, key: str, value: object, allowed: str) -> NoReturn:
    with naming(setup.origin):
        raise ConfigurationError(key, value, f"must be {allowed} again with --confirm")


def simulated_otherwise(setup: Setup, path: Path) -> list[str]:
    """Return a sentence if a simulation's digest or verdict differs from this folder's run."""
    try:
        found = [judge(load_run(path)[0]), execute(setup).result]
    except RunFolderError:
        return []  # the command reports it itself
    recorded, simulated = (f"{one.verdict}, digest {one.digest[:16]}" for one in found)
    if recorded == simulated:
        return []
    return [f"a simulation in one process differs from the run: {simulated}, not {recorded}"]


def other_physics(setup: Setup) -> dict[str, Setup]:
    """Return the scenario on all other installed physics, by name: what ships, and its own engine.

    Engines of packages that the scenario does not use take no part.
    """
    own, found = physics_text(setup.scenario.plant), {}
    needs_rotors = setup.scenario.plant.actuator.has_rotors
    for name, engine in ENGINES.usable({engine_name(setup.scenario.plant)}).items():
        is_able = engine.is_installed and (engine.has_rotors or not needs_rotors)
        for integrator in engine.integrators if is_able else ():
            physics = PhysicsConfiguration.model_validate(
                {"engine": name, "integrator": integrator}
            )
            plant = setup.scenario.plant.model_copy(update={"physics": physics, "gui": False})
            scenario = setup.scenario.model_copy(update={"plant": plant})
            found[physics_text(plant)] = replace(setup, scenario=scenario)
    return {name: other for name, other in found.items() if name != own}


def confirmed_row(setup: Setup, run: JudgedRun, how: How | None = None) -> Row:
    """Return the row of a run, with the results of the same run on other physics.

    Args:
        setup: the scenario, which is simulated again.
        run: the run.
        how: as for `execute`.
    """
    values = run_row(run.result, setup.scenario.seed)
    values |= {name: [] for name in CONFIRMATION_COLUMNS}
    for name, other in other_physics(setup).items():
        end_if_asked()
        again = execute(other, how)
        found = run_row(again.result, setup.scenario.seed)
        values["confirmed_on"].append(name)
        values["confirmed_kept"].append(held(found))
        values["confirmed_margin_min"].append(found["margin_min"])
        values["confirmed_error_difference_rad"].append(_error_difference_rad(run.data, again.data))
    return values


def confirmation_of(run: JudgedRun, how: How | None = None) -> list[dict[str, Any]]:
    """Return the `confirmations` of one run; `how` is as for `execute`."""
    return confirmations([confirmed_row(run.data.setup, run, how)])


def confirmations(rows: Iterable[Row]) -> list[dict[str, Any]]:
    """Summarise the rows by scenario, law and other physics, ready for JSON.

    Rows without `CONFIRMATION_COLUMNS`, such as failed runs, are left out.
    """
    found: dict[tuple[str, ...], dict[str, Any]] = {}
    for row in rows:
        for place, physics in enumerate(row.get("confirmed_on") or ()):
            kept, margin, difference = (row[name][place] for name in list(CONFIRMATION_COLUMNS)[1:])
            of = found.setdefault(
                (row["scenario"], row["law"], physics),
                {"runs": 0, "agree": 0, "too_near": 0, "differ": 0,
                 "margin_difference": None, "error_difference_rad": None},
            )  # fmt: skip
            of["runs"] += 1
            of[_agreement(held(row), row["margin_min"], kept, margin)] += 1
            if margin is not None and row["margin_min"] is not None:
                apart = abs(margin - row["margin_min"])
                of["margin_difference"] = max(apart, of["margin_difference"] or 0.0)
            if difference is not None:
                of["error_difference_rad"] = max(difference, of["error_difference_rad"] or 0.0)
    keys = ("scenario", "law", "physics")
    return [{**dict(zip(keys, key, strict=True)), **values} for key, values in found.items()]


def _agreement(kept: bool, margin: float | None, other: bool, its_margin: float | None) -> str:
    if kept == other:
        return "agree"
    known = [abs(each) for each in (margin, its_margin) if each is not None]
    return "too_near" if min(known, default=1.0) < NEAR_ZERO else "differ"


def _error_difference_rad(run: RunData, other: RunData) -> float | None:
    """Return the largest difference of the true errors while both runs lasted, rad."""
    ticks = min(len(run.true_errors_rad), len(other.true_errors_rad))
    if not ticks:
        return None
    return float(np.abs(run.true_errors_rad[:ticks] - other.true_errors_rad[:ticks]).max())
