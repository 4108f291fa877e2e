"""An arm whose joints are moved, slowed down and held by their own motor drives."""

from __future__ import annotations

import numpy as np

from plant_emulator.arm_plant import ArmPlant
from plant_emulator.drives.drives_on_bus import DrivesOnBus


class DrivenArm(ArmPlant):
    """An arm with drives: what a command says is theirs to carry out, and so is every stop."""

    _drives: DrivesOnBus | None = None

    def attach(self, drives: DrivesOnBus) -> None:
        """Give the joints their drives; of the safe stop that is configured nothing is needed."""
        self._drives, self._safe_stop = drives, "zero_torque"

    def advance(self, first: int, end: int) -> None:
        if self._drives is None:
            super().advance(first, end)
            return
        self._drives.handle_due(self._grid.substep_ns(first))
        bank = self._drives.bank
        self.hold(bank.braked)
        if not bank.closes_loops:
            np.copyto(self._commanded, bank.torque_nm)
            super().advance(first, end)
            return
        for number in range(first, end):
            bank.close_loops(self.position, self.velocity, self._grid.substep_s)
            np.copyto(self._commanded, bank.torque_nm)
            super().advance(number, number + 1)
