"""The torques of a run that are judged: commanded ones, or those of drives with their own loops."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.messages import topics
from deploy.judge.recorded_ticks import Rows, rows_after_gaps
from deploy.judge.run_data import RunData


class Torques(NamedTuple):
    """Torques over time.

    Attributes:
        times_s: when the states were measured that they answer, or when they act; shape (rows,).
        values_nm: shape (rows, joints).
        after_gaps: rows that follow a gap.
    """

    times_s: Vector
    values_nm: Matrix
    after_gaps: Rows


def torques(run: RunData) -> Torques:
    """Return the commanded torques; what the actuators deliver, where drives close a loop.

    Drives that follow positions get torques of their own: a command's torque is then only a part,
    or zero.
    """
    joints = run.setup.robot.joints
    commands, truth = (
        run.tables[topic.name] for topic in (topics.JOINT_COMMANDS, topics.PLANT_TRUTH)
    )
    if closes_drive_loops(run):
        acting = truth[truth["command_age_ns"] >= 0]
        values, times_s = acting["torque"], run.times_s(topics.PLANT_TRUTH)
        times_s = times_s[truth["command_age_ns"] >= 0]
    else:
        values, times_s = commands["effort"], run.times_s(topics.JOINT_COMMANDS)
    return Torques(times_s, np.asarray(values.reshape(-1, joints)), rows_after_gaps(run, times_s))


def closes_drive_loops(run: RunData) -> bool:
    """Whether the drives add torques to those of commands.

    They do if commands have targets, or if no command has a torque, and the actuators have.
    """
    commands = run.tables[topics.JOINT_COMMANDS.name]
    names = commands.dtype.names or ()
    has_targets = "position" in names and bool(np.isfinite(commands["position"]).any())
    delivered = run.tables[topics.PLANT_TRUTH.name]["torque"]
    return has_targets or bool(len(commands) and not commands["effort"].any() and delivered.any())
