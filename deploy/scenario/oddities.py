"""What to say of an arm before it runs: what its file leaves open, or has odd."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from bus_schema.arrays import Vector
from deploy.scenario.setup import Setup


def oddities_of_all(setups: Iterable[Setup]) -> list[str]:
    """Those of several scenarios, each sentence once."""
    return list(dict.fromkeys(said for setup in setups for said in oddities(setup)))


def oddities(setup: Setup) -> list[str]:
    """A sentence for each thing that is taken, but that may not be what was meant."""
    robot, scenario = setup.robot, setup.scenario
    said = [*robot.warnings, *setup.reference.warnings]
    if scenario.limits.torque_nm is None and scenario.plant.actuator.saturation_nm is None:
        lacking = _unlimited(robot.joint_names, robot.effort_limits_nm)
        if lacking:
            said.append(
                f"no effort limit in the URDF for {lacking}: torques are UNLIMITED there; set"
                " limits.torque_nm or plant.actuator.saturation_nm"
            )
    if scenario.limits.velocity_rad_s is None:
        lacking = _unlimited(robot.joint_names, robot.velocity_limits_rad_s)
        if lacking:
            said.append(
                f"no velocity limit in the URDF for {lacking}: speeds are UNLIMITED there; set"
                " limits.velocity_rad_s"
            )
    most_nm = scenario.limits.of_plant(robot).torque_nm
    return said + setup.link_kind.oddities(setup.link_run(lockstep=True), most_nm)


def _unlimited(names: Sequence[str], limits: Vector) -> str:
    """Names of the joints without a limit; a URDF's zero is how exporters write unknown."""
    found = [name for name, limit in zip(names, limits, strict=True) if not np.isfinite(limit)]
    shown = ", ".join(found[:4])
    return f"{shown} and {len(found) - 4} more" if len(found) > 4 else shown
