"""The control laws by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from controller.control_law import ControlLaw
from controller.laws.fixed_time_neural import FixedTimeNeural, FixedTimeNeuralGains
from controller.laws.pid import Pid, PidGains


class LawEntry(NamedTuple):
    """A law and its gains type; gains know how to derive themselves `from_inertia`."""

    law: Callable[[Any], ControlLaw]
    gains: Any


LAWS: dict[str, LawEntry] = {
    "fixed_time_neural": LawEntry(FixedTimeNeural, FixedTimeNeuralGains),
    "pid": LawEntry(Pid, PidGains),
}
