"""Faults of the arm's hardware: encoders that lie, actuators that do not do what they are told."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from bus_schema.arrays import Matrix, Vector
from plant_emulator.faults.fault import (
    ActuatorDead,
    ActuatorWeak,
    ArmFault,
    EncoderBiased,
    EncoderNoisy,
    EncoderStuck,
    Fault,
    PayloadDropped,
    TorqueOffset,
)


class ArmFaults:
    """What the scheduled faults do to the arm at an instant of the plant's clock.

    Args:
        faults: all faults of the plant; those of other parts are passed over.
        joint_names: names of the joints, which the faults refer to.
        random: source of an encoder's noise.
    """

    def __init__(
        self, faults: Iterable[Fault], joint_names: tuple[str, ...], random: np.random.Generator
    ) -> None:
        self._faults = [fault for fault in faults if isinstance(fault, ArmFault)]
        self._joint = {name: joint for joint, name in enumerate(joint_names)}
        self._random = random
        self._stuck_at_rad: dict[int, float] = {}
        self._payload_falls_ns = [
            fault.start_ns for fault in self._faults if isinstance(fault, PayloadDropped)
        ]

    def ask(self, commanded_nm: Vector, now_ns: int, asked: Vector) -> None:
        """Write the torques that the actuators are asked for in place of those commanded."""
        asked[:] = commanded_nm
        for fault in self._faults:
            if fault.is_active(now_ns):
                match fault:
                    case ActuatorDead():
                        asked[self._joint[fault.joint]] = 0.0
                    case ActuatorWeak():
                        asked[self._joint[fault.joint]] *= fault.share
                    case TorqueOffset():
                        asked[self._joint[fault.joint]] += fault.torque_nm

    def sense(self, motion: Matrix, now_ns: int) -> None:
        """Spoil what the encoders read, positions and velocities as rows, in place."""
        position, velocity = motion
        for index, fault in enumerate(self._faults):
            if fault.is_active(now_ns):
                match fault:
                    case EncoderStuck():
                        joint = self._joint[fault.joint]
                        position[joint] = self._stuck_at_rad.setdefault(index, position[joint])
                        velocity[joint] = 0.0
                    case EncoderBiased():
                        position[self._joint[fault.joint]] += fault.bias_rad
                    case EncoderNoisy():
                        joint = self._joint[fault.joint]
                        noise = self._random.standard_normal(2)
                        position[joint] += fault.noise_rad * noise[0]
                        velocity[joint] += fault.noise_rad_s * noise[1]

    def payload_falls(self, now_ns: int) -> bool:
        """Whether the payload falls off now; true once."""
        if self._payload_falls_ns and self._payload_falls_ns[0] <= now_ns:
            self._payload_falls_ns.clear()
            return True
        return False
