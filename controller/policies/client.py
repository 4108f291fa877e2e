"""Robot client of a policy server: it sends an observation, and receives a chunk of actions."""

from __future__ import annotations

import reprlib
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import numpy.typing as npt
from pydantic import Field

from bus_schema.arrays import Matrix
from controller.errors import ControllerError

Image = npt.NDArray[np.uint8]
MOST_BYTES = 64 * 1024 * 1024
"""Largest answer of a policy server."""
UNREADABLE = (ArithmeticError, MemoryError, RecursionError, TypeError, ValueError)
"""What reading a foreign value may raise."""
Text = Annotated[str, Field(min_length=1)]
"""A setting that cannot be empty."""


class PolicyServerError(ControllerError):
    """A policy server cannot be used: it refused, failed, or sent no chunk of actions."""


class ServerGoneError(PolicyServerError, ConnectionError):
    """The connection to a policy server could not be made, or was lost."""


class NoAnswerError(PolicyServerError, TimeoutError):
    """A policy server did not answer in time."""


@dataclass(frozen=True)
class Robot:
    """The robot that a policy moves, as a server must know it.

    Attributes:
        state_names: names of the values of the state.
        images: shapes of the cameras' images, (height, width), by name.
        joints: values of an action.
        horizon: actions of a chunk.
    """

    state_names: Sequence[str]
    images: Mapping[str, tuple[int, int]]
    joints: int
    horizon: int


@dataclass(frozen=True)
class Observation:
    """Input of a policy.

    Attributes:
        number: of the question; those of two clients of a server differ.
        state: values in the order of `Robot.state_names`.
        images: of the cameras, shape (height, width, 3), by name.
        task: instruction in words; None for none.
    """

    number: int
    state: Sequence[float]
    images: Mapping[str, Image]
    task: str | None


class PolicyClient(ABC):
    """A connection to one policy server."""

    @abstractmethod
    def connect(self, timeout_s: float) -> None:
        """Connect, and have the server load its policy.

        Raises:
            PolicyServerError: that failed.
        """

    @abstractmethod
    def ask(self, observation: Observation, timeout_s: float) -> object:
        """Return the actions for an observation, of shape (actions, joints) if all is well.

        Raises:
            ServerGoneError: the connection was lost.
            PolicyServerError: the server failed, or sent something else.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the connection; `connect` may follow."""


def checked_actions(given: object, robot: Robot) -> Matrix:
    """Return actions as an array of shape (actions, joints).

    Raises:
        PolicyServerError: they have another shape, or an entry is no finite number.
    """
    try:
        actions: Matrix = np.array(given, dtype=np.float64)
    except UNREADABLE:
        raise PolicyServerError(f"the actions are no numbers: {reprlib.repr(given)}") from None
    if actions.ndim != 2 or actions.shape[1] != robot.joints or not actions.size:
        wanted = f"(actions, {robot.joints}), a column for each joint"
        raise PolicyServerError(f"the actions have shape {actions.shape}: must be {wanted}")
    if not np.isfinite(actions).all():
        row, joint = np.argwhere(~np.isfinite(actions))[0]
        raise PolicyServerError(
            f"action {row} has {actions[row, joint]:g} for joint {joint + 1}: must be finite"
        )
    return actions
