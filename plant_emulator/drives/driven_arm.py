"""An arm whose joints are moved, slowed down and held by their own motor drives."""

from __future__ import annotations

import numpy as np

from plant_emulator.arm.arm_plant import ArmPlant
from plant_emulator.drives.bank import DriveBank


class DrivenArm(ArmPlant):
    """An arm with drives: what a command says is theirs to carry out, and so is every stop."""

    _bank: DriveBank | None = None

    def attach(self, bank: DriveBank) -> None:
        """Give the joints their drives; of the safe stop that is configured nothing is needed."""
        self._bank, self._safe_stop = bank, "zero_torque"

    def advance(self, first: int, end: int) -> None:
        bank = self._bank
        if bank is None:
            super().advance(first, end)
            return
        self.hold(bank.braked)
        if not bank.closes_loops:
            np.copyto(self._commanded, bank.torque_nm)
            super().advance(first, end)
            return
        for number in range(first, end):
            bank.close_loops(self.position, self.velocity, self._grid.substep_s)
            np.copyto(self._commanded, bank.torque_nm)
            super().advance(number, number + 1)
