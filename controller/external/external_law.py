"""A control law whose torques come from a program.

Questions and answers are records of IEEE doubles in the machine's byte order. The program reads
questions from its standard input and writes answers to its standard output. A question is `HEADER`
values and then `ROWS` rows of one value per joint; an answer is one value, `DONE` or any other
number for a failure, and then a torque per joint, N m. Each question has one answer; the end of
input is the end of the run. `funnel_hil_law.h` defines it in C.

With ``controller.external.rows``, an answer has so many rows of torques, one for each of the next
ticks. With ``controller.external.targets``, as many rows of target positions follow, and then as
many of target velocities.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Annotated

import numpy as np
from pydantic import Field

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import ConfigurationError, Positive, StrictModel, Whole
from controller.control_law import Diagnostics, Tracking
from controller.external.program import ExternalLawError, LawProgram, why_not_startable

VERSION = 1
DONE = 0.0


class Question(IntEnum):
    """Kinds of questions."""

    RESET = 0
    """Forget everything; the torques of the answer are ignored."""
    TORQUE = 1
    """Return the torques for a situation."""


HEADER = ("question", "version", "joints", "time_s", "step_s", "horizon_s", "rows", "targets")
"""Names of the leading values; times as in `controller.control_law.Tracking`. `targets` is 1 if the
answer must have them, else 0."""
ROWS = (
    "position_rad", "velocity_rad_s",
    "reference_position_rad", "reference_velocity_rad_s", "reference_acceleration_rad_s2",
    "upper_bound_rad", "lower_bound_rad", "torque_limit_nm",
)  # fmt: skip
"""Rows after the header. Position minus reference must stay between the bounds, of which the lower
is negative; limits are the actuators', inf for none."""

Word = Annotated[str, Field(min_length=1)]


class ExternalLawConfiguration(StrictModel):
    """The program of ``controller.law: external``.

    Attributes:
        command: the program and its arguments; started in the current folder, without a shell.
        timeout_s: longest wall time for an answer.
        start_timeout_s: longest wall time from its start to its first answer.
        rows: rows of an answer, one for each of the next ticks.
        targets: whether an answer also has targets for the drives, in as many rows.
    """

    command: Annotated[tuple[Word, ...], Field(min_length=1)]
    timeout_s: Positive = 1.0
    start_timeout_s: Positive = 10.0
    rows: Annotated[Whole, Field(ge=1, le=1000)] = 1
    targets: bool = False


_LARGEST_STATUS = 2**31
_SHOWN_BYTES = 24


class ExternalLaw:
    """A law whose torques come from a program, which starts with the first question.

    Args:
        configuration: the program, and its time limits.
        torque_limits_nm: the actuators' limits, shape (joints,).

    Raises:
        ConfigurationError: the program does not exist here.
    """

    def __init__(self, configuration: ExternalLawConfiguration, torque_limits_nm: Vector) -> None:
        joints = torque_limits_nm.size
        hindrance = why_not_startable(configuration.command)
        if hindrance is not None:
            raise ConfigurationError(
                "controller.external.command", configuration.command, hindrance
            )
        self.diagnostics = Diagnostics(joints)
        self._configuration = configuration
        self._question: Vector = np.zeros(len(HEADER) + len(ROWS) * joints)
        self._header = self._question[: len(HEADER)]
        self._rows: Matrix = self._question[len(HEADER) :].reshape(len(ROWS), joints)
        self._rows[ROWS.index("torque_limit_nm")] = torque_limits_nm
        rows, arrays = configuration.rows, 3 if configuration.targets else 1
        self._header[6:] = rows, configuration.targets
        self._answer: Vector = np.zeros(1 + arrays * rows * joints)
        answered = self._answer[1:].reshape(arrays, rows, joints)
        self._torques: Vector = answered[0] if rows > 1 else answered[0, 0]
        self._targets: Matrix = answered[1:].swapaxes(0, 1)
        self._program: LawProgram | None = None

    def torque(self, tracking: Tracking) -> Vector:
        """Return the program's torques, shape (joints,), or (rows, joints) for more than one row.

        Raises:
            ExternalLawError: it failed, ended, or took too long.
        """
        rows = self._rows
        rows[0:2] = tracking.motion
        rows[2] = tracking.reference_position
        rows[3] = tracking.reference_velocity
        rows[4] = tracking.reference_acceleration
        rows[5] = tracking.upper_bound
        rows[6] = tracking.lower_bound
        self._ask(Question.TORQUE, tracking.time_s, tracking.step_s, tracking.horizon_s)
        return self._torques

    def reset(self) -> None:
        """Reset the program; one that has not been asked yet needs no reset."""
        if self._program is not None:
            self._ask(Question.RESET, 0.0, 0.0, 0.0)

    def close(self) -> None:
        """End the program."""
        if self._program is not None:
            self._program.end()
            self._program = None

    def _ask(self, question: Question, time_s: float, step_s: float, horizon_s: float) -> None:
        self._header[:6] = question, VERSION, self._rows.shape[1], time_s, step_s, horizon_s
        timeout_s = self._configuration.timeout_s
        if self._program is None:
            self._program = LawProgram(self._configuration.command, self._question, self._answer)
            timeout_s = max(timeout_s, self._configuration.start_timeout_s)
        self._program.ask(timeout_s)
        if self._answer[0] != DONE:
            command = " ".join(self._configuration.command)
            raise ExternalLawError(f"external law {command} {self._complaint()} at {time_s:.3f} s")

    def _complaint(self) -> str:
        status = float(self._answer[0])
        if status.is_integer() and abs(status) <= _LARGEST_STATUS:
            return f"reports failure {status:g}"
        began = self._answer.tobytes()[:_SHOWN_BYTES]
        return (
            f"sent {began!r}…, but an answer begins with 0 or the number of a failure (standard"
            " output is only for answers; other text must go to standard error)"
        )


class ExternalTargetLaw(ExternalLaw):
    """A law whose program also answers with targets for the drives."""

    def target(self, tracking: Tracking) -> Matrix:  # noqa: ARG002 (the interface)
        """Return the targets that came with the torques, shape (rows, 2, joints)."""
        return self._targets
