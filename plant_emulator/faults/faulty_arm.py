"""What scheduled faults do to encoders and actuators, substep by substep."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from bus_schema.arrays import Matrix, Vector
from plant_emulator.faults.arm_faults import (
    ActuatorFault,
    ArmFault,
    ArmHardware,
    EncoderFault,
    EncoderReading,
    FaultyEncoder,
)
from plant_emulator.faults.fault import Fault
from plant_emulator.faults.scheduler import FaultScheduler, ScheduledAction


class ArmFaults:
    """The faults of an arm; where two of them meet in a joint, the later in the scenario is last.

    Args:
        faults: all faults of the plant; those of other parts are passed over.
        joint_names: names of the joints, which the faults refer to.
        random: source of an encoder's noise.
        arm: the arm as a whole.
    """

    def __init__(
        self,
        faults: Sequence[Fault],
        joint_names: tuple[str, ...],
        random: np.random.Generator,
        arm: ArmHardware,
    ) -> None:
        self._encoder_faults = [fault for fault in faults if isinstance(fault, EncoderFault)]
        self._actuator_faults = [fault for fault in faults if isinstance(fault, ActuatorFault)]
        self._joint = {name: joint for joint, name in enumerate(joint_names)}
        self._random = random
        self._first: dict[int, EncoderReading] = {}
        self._beginnings = FaultScheduler(
            ScheduledAction(fault.start_ns, str(fault), _beginning(fault, arm))
            for fault in faults
            if isinstance(fault, ArmFault)
        )

    def begin_due(self, now_ns: int) -> None:
        """Do to the arm what faults do once, when they begin."""
        self._beginnings.run_due(now_ns)

    def faulty_torques(self, commanded_nm: Vector, now_ns: int) -> Vector:
        """Torques that the actuators take for those commanded, N m, shape (joints,)."""
        requested_nm = commanded_nm.copy()
        for fault in self._actuator_faults:
            if fault.is_active(now_ns):
                joint = self._joint[fault.joint]
                requested_nm[joint] = fault.faulty_torque_nm(float(requested_nm[joint]))
        return requested_nm

    def spoil_readings(self, motion: Matrix, now_ns: int) -> None:
        """Put what faulty encoders show in place of what they would show.

        Args:
            motion: positions, rad, and velocities, rad/s, as rows; changed in place.
            now_ns: time on the plant's clock.
        """
        for index, fault in enumerate(self._encoder_faults):
            if fault.is_active(now_ns):
                joint = self._joint[fault.joint]
                reading = EncoderReading(*motion[:, joint].tolist())
                first = self._first.setdefault(index, reading)
                motion[:, joint] = fault.faulty_reading(FaultyEncoder(reading, first, self._random))


def _beginning(fault: ArmFault, arm: ArmHardware) -> Callable[[int], None]:
    return lambda _now_ns: fault.begin(arm)
