"""An identified arm, and how well it explains its logs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.robot_description import RobotDescription
from controller.manipulator_model import ManipulatorModel
from deploy.measure.identify.base_parameters import SEEN, Z_95, Grouping, Interval
from deploy.measure.identify.currents import Constants, Payload
from deploy.measure.identify.fit import Fit
from deploy.measure.identify.quality import predicted_before, relative_errors
from deploy.measure.identify.regression import ROTOR, Trial
from deploy.scenario.starter import Drives


@dataclass(frozen=True)
class Identified:
    """An identified arm.

    Attributes:
        robot: the arm as its file has it.
        model: likewise.
        group: its base parameters.
        drives: motors and friction before.
        fit: what was found.
        training: motions that were fitted.
        held_out: motions that were not.
        logs: names of the files of both.
        constants: torque per current; None for logs with torques.
        payload: what the log with a payload carries; None without.
        dead_time_s: from commanded to measured positions, and half of its interval; None without.
        not_seen: a sentence for each value that stays as it was.
        notes: what was changed in the logs, and what residuals show.
        warnings: a sentence for each reason to doubt the result.
    """

    robot: RobotDescription
    model: ManipulatorModel
    group: Grouping
    drives: Drives
    fit: Fit
    training: list[Trial]
    held_out: list[Trial]
    logs: tuple[list[str], list[str]]
    constants: Constants | None
    payload: Payload | None
    dead_time_s: tuple[float, float] | None
    not_seen: list[str]
    notes: list[str]
    warnings: list[str]

    @property
    def interval(self) -> str:
        """Name of the intervals: they leave out errors of the file's masses where these scale."""
        by_weight = self.constants is not None and self.constants.by_weight
        return "noise alone" if by_weight else "95 %"

    def errors(self, *, before: bool = False) -> Vector:
        """Return relative RMS errors of the held-out torques, shape (joints,)."""
        of = (lambda t: predicted_before(self.fit, t)) if before else self.fit.predicted
        measured = np.concatenate([each.torque * self.fit.constants for each in self.held_out])
        return relative_errors(np.concatenate([of(each) for each in self.held_out]), measured)

    def term(self, joint: int, term: int) -> Interval:
        """Return a parameter of a joint."""
        found, has = self.fit, self.fit.has_term[joint, term]
        before = float(found.prior.terms[joint, term])
        if not has:
            value = before if term == ROTOR else 0.0
            return Interval(value, math.nan, before, seen=False)
        sd = float(found.terms_sd[joint, term])
        seen = bool(sd < SEEN * found.prior.terms_sd[joint, term])
        seen = seen and not (term == ROTOR and self.group.of_rotor[joint].any())
        return Interval(float(found.terms[joint, term]), Z_95 * sd, before, seen)
