"""The control laws by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from bus_schema.arrays import Vector
from controller.control_law import ControlLaw, Dynamics
from controller.laws.fixed_time_model_based import FixedTimeModelBased, FixedTimeModelBasedGains
from controller.laws.fixed_time_neural import FixedTimeNeural, FixedTimeNeuralGains
from controller.laws.ftsmc import Ftsmc, FtsmcGains
from controller.laws.pid import Pid, PidGains
from controller.laws.settling import LargestInertia, settling_bound_s
from controller.laws.smc import Smc, SmcGains
from controller.laws.tsmc import Tsmc, TsmcGains

_Build = Callable[[Any, Dynamics, Vector], ControlLaw]


class LawEntry(NamedTuple):
    """One law of the registry.

    Attributes:
        build: a fresh law from its gains, a nominal model, of which model-free laws see nothing,
            and the torque limits, shape (joints,), N m, by which a law with a memory stops it.
        gains: the type of its gains, which know how to derive themselves `from_inertia`.
        settling_bound_s: bound on the settling time, s, for the laws that have one.
    """

    build: _Build
    gains: Any
    settling_bound_s: Callable[[Any, LargestInertia], float] | None = None


def _model_free(law: Callable[[Any, Vector], ControlLaw]) -> _Build:
    return lambda gains, _model, torque_limits_nm: law(gains, torque_limits_nm)


def _model_based(law: Callable[[Any, Dynamics], ControlLaw]) -> _Build:
    return lambda gains, model, _torque_limits_nm: law(gains, model)


LAWS: dict[str, LawEntry] = {
    "fixed_time_neural": LawEntry(
        _model_free(FixedTimeNeural), FixedTimeNeuralGains, settling_bound_s
    ),
    "fixed_time_model_based": LawEntry(
        _model_based(FixedTimeModelBased), FixedTimeModelBasedGains, settling_bound_s
    ),
    "pid": LawEntry(_model_free(Pid), PidGains),
    "smc": LawEntry(_model_based(Smc), SmcGains),
    "tsmc": LawEntry(_model_based(Tsmc), TsmcGains),
    "ftsmc": LawEntry(_model_based(Ftsmc), FtsmcGains),
}
