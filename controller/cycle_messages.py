"""The messages of a cycle: their memory, and who writes each part of it."""

from __future__ import annotations

import numpy as np

from bus_schema.arrays import Matrix
from bus_schema.messages import topics
from bus_schema.messages.record import Record
from controller.control_law import Tracking


class CycleMessages:
    """Owner of the messages of a cycle. All views keep their memory for the whole run.

    Args:
        joint_names: names of the joints.
        rows: torques that a command has, one after the other.
        row_ticks: ticks from one of them to the next.
        has_targets: whether a command has targets for drives that close their own loop.
        has_acting_time: whether a command says when it acts.

    Attributes:
        arrived: the last state, also an invalid or late one; the loop decodes into it.
        state: the newest valid state; only `accept` writes it.
        motion: its positions and velocities, shape (2, joints).
        plant_status: the plant's report beside a state; the loop decodes into it.
        command: the answer. The torque guard writes the first torque, a bridge the later ones and
            their targets, the loop everything else.
        torques_nm: its torques, shape (rows, joints).
        targets: its targets, positions and velocities, shape (2, rows, joints); without any, memory
            that no message has.
        status: the control status. `Tracking` writes `tracked`, `ControlStatus` the rest.
        tracked: the rows `Tracking.PUBLISHED` of the status.
    """

    def __init__(
        self, joint_names: tuple[str, ...], rows: int, row_ticks: int, *,
        has_targets: bool, has_acting_time: bool,
    ) -> None:  # fmt: skip
        self.state_layout = topics.layout(topics.JOINT_STATES, joint_names)
        self.arrived, self.state = Record(self.state_layout), Record(self.state_layout)
        self.motion: Matrix = self.state.rows("position", "velocity")
        self.plant_status_layout = topics.layout(topics.PLANT_STATUS, joint_names)
        self.plant_status = Record(self.plant_status_layout)
        command = topics.layout(
            topics.JOINT_COMMANDS, joint_names,
            has_targets=has_targets, has_acting_time=has_acting_time,
            rows=rows, row_ticks=row_ticks,
        )  # fmt: skip
        self.command = Record(command)
        self.torques_nm: Matrix = self.command.fields["effort"].reshape(rows, -1)
        self.targets = np.zeros((2, *self.torques_nm.shape))
        if has_targets:
            self.targets = self.command.rows("position", "velocity").reshape(2, rows, -1)
        self.status = Record(topics.layout(topics.CONTROL_STATUS, joint_names))
        self.tracked: Matrix = self.status.rows(*Tracking.PUBLISHED)

    def accept(self) -> None:
        """Make the state that arrived the newest valid one."""
        self.state.memory[:] = self.arrived.memory
