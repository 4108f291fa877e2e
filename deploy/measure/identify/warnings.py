"""Warnings about an identified arm: reasons why its values may be wrong, and what to do."""

from __future__ import annotations

import numpy as np

from deploy.measure.identify.currents import Constants
from deploy.measure.identify.identified import Identified
from deploy.measure.identify.quality import predicted_before

_POOR = 0.5
"""Error on held-out data, over the measured torque, from which a fit is doubtful."""
_SMALL, _LARGE = 3.0, 0.1
"""Torques that the file predicts, over those of the log, from which these are no torques in N m."""


def warnings_of(found: Identified) -> list[str]:
    """Return a sentence for each reason to doubt the result."""
    warnings = []
    if found.constants is None:
        warnings += _about_units(found)
    elif found.constants.by_weight:
        warnings.append(_about_weight(found.constants))
    names = zip(found.robot.joint_names, found.errors(), strict=True)
    if poor := [name for name, error in names if error > _POOR]:
        warnings.append(
            f"{', '.join(poor)}: more than {100 * _POOR:g} % of the torque is not predicted; is"
            " this the robot of the log, and are these its columns?"
        )
    return warnings


def _about_weight(constants: Constants) -> str:
    if constants.tool is not None:
        kg, half = constants.tool.kg
        than = "beyond what the robot's file has" if kg > 0 else "less than the robot's file has"
        found = (
            f"the last link carries about {abs(kg):.2g} ± {half:.1g} kg {than}, as of a tool or"
            " payload: the current constants are found with it, and are as true as the file's other"
            " masses; correct the file"
        )
    elif not constants.fits:
        found = (
            "the weight in the robot's file does not explain the currents of all joints: it lacks a"
            " tool or payload, or its masses are wrong. Current constants, friction, rotors and"
            " masses may be wrong by as much; correct the file"
        )
    else:
        found = (
            "current constants, and with them friction, rotors and masses, are as true as the"
            " masses in the robot's file: a tool or payload in the log must be in the file"
        )
    return f"{found}, or give --current-constants. Intervals (±) have the noise of the log alone"


def _about_units(found: Identified) -> list[str]:
    """Return a sentence if the logged torques are far smaller or larger than the file's."""
    predicted = np.concatenate([predicted_before(found.fit, each) for each in found.held_out])
    measured = np.concatenate([each.torque for each in found.held_out])
    ratio = float(np.sqrt((predicted**2).sum() / (measured**2).sum()))
    if _LARGE < ratio < _SMALL:
        return []
    times, size = (ratio, "smaller") if ratio > 1.0 else (1.0 / ratio, "larger")
    return [
        f"the torques of the log are {times:.2g} times {size} than those of the robot's file: if"
        " they are motor currents, give their columns as --current; torques must be in N m"
    ]
