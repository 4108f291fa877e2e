"""Which messages are lost."""

from __future__ import annotations

import numpy as np

from plant_emulator.channel.conditions import Conditions
from plant_emulator.channel.random_numbers import uniform_numbers


class Loss:
    """Losses, independent and in bursts; each kind has random numbers of its own.

    Bursts are Gilbert–Elliott's: whether a message is lost depends on the chain's state, and then
    the chain takes a step. It starts in the good state. Mean loss is (p (1-h) + r (1-k)) / (p + r);
    with 1-h = 1 and 1-k = 0 bursts have 1 / r messages on average.
    """

    def __init__(self, random: np.random.Generator, burst_random: np.random.Generator) -> None:
        self._numbers = uniform_numbers(random)
        self._burst_numbers = uniform_numbers(burst_random)
        self._is_bad = False

    def takes(self, conditions: Conditions) -> bool:
        """Whether the next message is lost."""
        loss_in_state = conditions.loss_in_bad if self._is_bad else conditions.loss_in_good
        is_lost_in_burst = next(self._burst_numbers) < loss_in_state
        leaves_state = conditions.r if self._is_bad else conditions.p
        if next(self._burst_numbers) < leaves_state:
            self._is_bad = not self._is_bad
        return next(self._numbers) < conditions.loss or is_lost_in_burst
