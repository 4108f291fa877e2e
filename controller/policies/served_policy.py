"""A law whose targets come from a policy server."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence

import numpy as np

from bus_schema.arrays import Matrix, Vector
from controller.control_law import Diagnostics, Tracking
from controller.policies.client import (
    UNREADABLE,
    Observation,
    PolicyServerError,
    ServerGoneError,
    checked_actions,
)
from controller.policies.configuration import PolicyServerConfiguration

_GREY = 128
_MOST_QUESTIONS = 1_000_000
_MOST_LETTERS = 200


class ServedPolicy:
    """A policy behind a server; the client connects with the first question.

    Args:
        address: of the server.
        settings: of the client.
        joint_names: of the arm.
        horizon: actions of a chunk.
        period_s: between two actions.

    Raises:
        ConfigurationError: a package or a setting is missing.
    """

    def __init__(
        self, address: str, settings: PolicyServerConfiguration, joint_names: Sequence[str],
        horizon: int, period_s: float,
    ) -> None:  # fmt: skip
        self.diagnostics = Diagnostics(len(joint_names))
        self.settings = settings
        self._address, self._period_s = address, period_s
        self._robot = settings.robot(joint_names, horizon)
        self._client = settings.client(address, self._robot)
        self._images = {
            name: np.full((*shape, 3), _GREY, np.uint8) for name, shape in settings.images.items()
        }
        self._number = os.getpid() * _MOST_QUESTIONS  # those of two clients differ
        self._is_connected = self._has_answered = self._is_closed = False

    def reset(self) -> None:
        """Do nothing: all state is the server's, which has one question at a time."""

    def torque(self, tracking: Tracking) -> Vector:
        """Return zero torques: the robot, or a drive loop, follows the targets."""
        return np.zeros_like(tracking.error)

    def target(self, tracking: Tracking) -> Matrix:
        """Ask the server, wait for it, and return the targets, shape (actions, 2, joints).

        Raises:
            PolicyServerError: it failed.
        """
        return self.as_targets(self.answer(self.observe(tracking)))

    def observe(self, tracking: Tracking) -> Observation:
        """Return what the policy sees of a situation, with a new number."""
        self._number += 1
        rows = [getattr(tracking, row) / self.settings.radians for row in self.settings.state]
        state = np.concatenate(rows).tolist()
        return Observation(self._number, state, self._images, self.settings.task)

    def answer(self, observation: Observation) -> Matrix:
        """Return the server's actions in its unit, shape (actions, joints).

        Where the connection is lost, the question is repeated once on a new one.

        Raises:
            PolicyServerError: it failed, or this object is closed; the message has its address.
        """
        try:
            try:
                return self._asked(observation)
            except ServerGoneError:
                if not self._has_answered:
                    raise
                self._client.close()
                self._is_connected = False
                return self._asked(observation)
        except PolicyServerError as error:
            raise type(error)(f"policy server {self._address}: {error}") from error.__cause__
        except UNREADABLE as error:
            reason = f"its answer cannot be read: {type(error).__name__}: {error}"[:_MOST_LETTERS]
            raise PolicyServerError(f"policy server {self._address}: {reason}") from error

    def as_targets(self, actions: object) -> Matrix:
        """Return positions and velocities, rad and rad/s, shape (actions, 2, joints).

        The velocity of an action leads to the next one.

        Raises:
            PolicyServerError: the actions have another shape, or are not finite.
        """
        positions = self.settings.radians * checked_actions(actions, self._robot)
        velocities = np.zeros_like(positions)
        if len(positions) > 1:
            velocities[:-1] = np.diff(positions, axis=0) / self._period_s
            velocities[-1] = velocities[-2]
        return np.stack([positions, velocities], axis=1)

    def close(self) -> None:
        """Close the connection for good, which also ends an open question."""
        self._is_closed = True
        self._client.close()

    def _asked(self, observation: Observation) -> Matrix:
        settings, limit_s = self.settings, self.settings.timeout_s
        if not self._is_connected:
            limit_s = max(limit_s, settings.start_timeout_s)
            self._refuse_if_closed()
            self._client.connect(settings.start_timeout_s)
            self._is_connected = True
            self._refuse_if_closed()  # another thread may have called `close` meanwhile
        actions = checked_actions(self._client.ask(observation, limit_s), self._robot)
        self._has_answered = True
        return actions

    def _refuse_if_closed(self) -> None:
        if self._is_closed:
            self._client.close()
            raise PolicyServerError("the connection is closed")


def timed_answer(policy: ServedPolicy, observation: Observation) -> tuple[Matrix, float]:
    """Return a server's actions, and the wall time that they took, s."""
    began_s = time.monotonic()
    actions = policy.answer(observation)
    return actions, time.monotonic() - began_s
