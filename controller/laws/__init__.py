"""The control laws by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from controller.control_law import ControlLaw, Dynamics
from controller.laws.fixed_time_model_based import FixedTimeModelBased, FixedTimeModelBasedGains
from controller.laws.fixed_time_neural import FixedTimeNeural, FixedTimeNeuralGains
from controller.laws.ftsmc import Ftsmc, FtsmcGains
from controller.laws.pid import Pid, PidGains
from controller.laws.smc import Smc, SmcGains
from controller.laws.tsmc import Tsmc, TsmcGains
from controller.settling import LargestInertia, settling_bound_s


class LawEntry(NamedTuple):
    """One law of the registry.

    Attributes:
        build: a fresh law from its gains and a nominal model, of which model-free laws see nothing.
        gains: the type of its gains, which know how to derive themselves `from_inertia`.
        settling_bound_s: bound on the settling time, s, for the laws that have one.
    """

    build: Callable[[Any, Dynamics], ControlLaw]
    gains: Any
    settling_bound_s: Callable[[Any, LargestInertia], float] | None = None


def _model_free(law: Callable[[Any], ControlLaw]) -> Callable[[Any, Dynamics], ControlLaw]:
    return lambda gains, _model: law(gains)


LAWS: dict[str, LawEntry] = {
    "fixed_time_neural": LawEntry(
        _model_free(FixedTimeNeural), FixedTimeNeuralGains, settling_bound_s
    ),
    "fixed_time_model_based": LawEntry(
        FixedTimeModelBased, FixedTimeModelBasedGains, settling_bound_s
    ),
    "pid": LawEntry(_model_free(Pid), PidGains),
    "smc": LawEntry(Smc, SmcGains),
    "tsmc": LawEntry(Tsmc, TsmcGains),
    "ftsmc": LawEntry(Ftsmc, FtsmcGains),
}
