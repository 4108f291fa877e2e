"""Section ``controller.policy_server``: what a robot client tells a policy server."""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib.util import find_spec
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from bus_schema.configuration import ConfigurationError, Positive, StrictModel, Whole
from bus_schema.errors import needs_extra
from controller.policies.client import PolicyClient, Robot, Text
from controller.policies.lerobot_client import LeRobotClient, LeRobotSettings
from controller.policies.openpi_client import OpenPiClient, OpenPiSettings

KEY = "controller.policy_server"
_ADDRESS = re.compile(r"([a-z]+)://([\w.-]+|\[[0-9a-fA-F:]+\]):(\d{1,5})")
_Pixels = Annotated[Whole, Field(ge=1, le=4096)]
StateRow = Literal["position", "velocity", "reference_position", "reference_velocity", "error"]
_SUFFIXES = {"position": "pos", "velocity": "vel"}
"""Ends of names that LeRobot has too."""


class PolicyServerConfiguration(StrictModel):
    """Robot client of a policy server, whose address is ``controller.law``.

    Attributes:
        lerobot: settings of ``lerobot://``.
        openpi: settings of ``openpi://``.
        state: values of each joint that the state has, one kind after the other.
        unit: of all angles of state and actions: ``rad`` or ``deg``.
        images: height and width of each camera's images, by its name; the policy sees grey.
        task: instruction for the policy, in words.
        inference: in virtual time an answer acts after the ``configured`` controller.inference_ms,
            or after the ``measured`` time that the server took. In real time it acts when it is
            there.
        timeout_s: longest wall time for an answer.
        start_timeout_s: longest wall time to connect, and again to load the policy and to answer
            the first question.
    """

    lerobot: LeRobotSettings | None = None
    openpi: OpenPiSettings = OpenPiSettings()
    state: Annotated[tuple[StateRow, ...], Field(min_length=1)] = ("position",)
    unit: Literal["rad", "deg"] = "rad"
    images: dict[Text, tuple[_Pixels, _Pixels]] = Field(default_factory=dict)
    task: Text | None = None
    inference: Literal["configured", "measured"] = "configured"
    timeout_s: Positive = 5.0
    start_timeout_s: Positive = 60.0

    needs: ClassVar[dict[str, tuple[str, ...]]] = {
        "lerobot": ("grpc",), "openpi": ("websockets", "msgpack"),
    }  # fmt: skip
    """Modules of the extra ``policies`` by the scheme of an address."""

    @property
    def radians(self) -> float:
        """One unit of the policy's angles, rad."""
        return 1.0 if self.unit == "rad" else float(np.deg2rad(1.0))

    def robot(self, joint_names: Sequence[str], horizon: int) -> Robot:
        """Return the robot as the server must know it."""
        names = [
            f"{joint}.{_SUFFIXES.get(row, row)}" for row in self.state for joint in joint_names
        ]
        return Robot(names, self.images, len(joint_names), horizon)

    def client(self, address: str, robot: Robot) -> PolicyClient:
        """Return a client, which is not connected yet.

        Raises:
            ConfigurationError: a package or a setting is missing.
        """
        scheme, place = parts_of(address)
        if missing := [each for each in self.needs[scheme] if find_spec(each) is None]:
            allowed = needs_extra(missing[0], "policies")
            raise ConfigurationError("controller.law", address, allowed)
        if scheme == "openpi":
            return OpenPiClient(place, self.openpi, robot)
        if self.lerobot is None:
            allowed = "must have policy_type and checkpoint with a server of LeRobot"
            raise ConfigurationError(f"{KEY}.lerobot", None, allowed, ["controller.law"])
        return LeRobotClient(place, self.lerobot, robot)


SCHEMES = tuple(PolicyServerConfiguration.needs)


def is_address(law: str) -> bool:
    """Whether a law is the address of a policy server, ``lerobot://host:port`` or ``openpi://…``."""
    found = _ADDRESS.fullmatch(law)
    return found is not None and found[1] in SCHEMES and 0 < int(found[3]) < 65536


def parts_of(address: str) -> tuple[str, str]:
    """Return scheme and ``host:port`` of an address."""
    scheme, _, place = address.partition("://")
    return scheme, place
