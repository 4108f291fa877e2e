"""The data sheet of a robot that has a controller of its own: how far behind, and which reflex.

Delay compensation is for torques. Behind an interface of positions or velocities, other things
help: a preview of the reference, a loop around the robot, and the robot's own limiter.
"""

from __future__ import annotations

import itertools
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from controller.laws import LAWS
from deploy.judge.metrics import judge
from deploy.judge.verdict import Verdict
from deploy.run.simulate import simulate
from deploy.scenario.interface_choice import COMPENSATION, KIND, LOOPS, interface_values, takes_of
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.study_keys import DELAYS, LAW, TRACES
from deploy.scenario.yaml_files import ScenarioError, override
from deploy.studies.datasheet.data_sheet import START_KEYS, Sheet
from deploy.studies.datasheet.result import NO_NETWORK, RobotRun, Way
from deploy.studies.margin.margin_study import margin_study
from deploy.study.study import StudyOfRuns
from plant_emulator.interfaces.configuration import INTERFACES, InterfaceConfiguration
from plant_emulator.interfaces.settings import TORQUE

_SOURCE = Path("datasheet")
_PREVIEW = "controller.preview_ms"
_LINK = ("link.uplink", "link.downlink")
_USUAL_LAW = "fixed_time_adaptive"
_ROUND_TRIPS_MS = (0.0, 10.0, 20.0, 40.0, 80.0)
_WHOLE = {"metrics.from_s": 0.0}
"""Errors of the tip count from the start: the robot starts on its reference."""
_LIMIT_MS = 500.0
"""Largest round trip of the search for margins: loops around robots take more than torques do."""
SHOWN_MS = 40.0
"""Round trip that a headline quotes, if none is given."""


@dataclass(frozen=True)
class RobotSheet(Sheet):
    """Settings of the data sheet of a robot.

    Attributes:
        arm: a scenario, or the file of an arm.
        interface: kind of the robot's interface, one with a controller of its own.
        law: the only control law; None for those of the interface.
        network: a file of delays, or the name of a shipped trace; None for the scenario's link.
        fixed: values of the scenario, by dotted key.
        is_quick: shorter and fewer runs.
    """

    arm: str
    interface: str
    law: str | None = None
    network: str | None = None
    fixed: Mapping[str, Any] | None = None
    is_quick: bool = False
    network_windows: int | None = None

    @property
    def loop(self) -> str:
        """The law whose margin is searched."""
        return self.law or LOOPS.get(takes_of(self.interface), _USUAL_LAW)

    @property
    def all_set(self) -> dict[str, Any]:
        return {**interface_values(self.interface), **_WHOLE, **super().all_set}

    def ways(self) -> list[Way]:
        """Return the ways to drive the robot, without what is set already."""
        has_torque = takes_of(self.interface) == TORQUE
        streams = not self.law and takes_of(self.interface) == "position"
        laws = ["streaming", self.loop] if streams else [self.loop]
        limiters = self._tried(limiter_key(self.interface), can=_has_limiter(self.interface))
        compensations = self._tried(COMPENSATION, can=has_torque)
        found = []
        for limiter, law, compensation in itertools.product(limiters, laws, compensations):
            reads_ahead = not has_torque and law in LAWS and LAWS[law].gives != TORQUE
            previews = self._tried(_PREVIEW, can=reads_ahead)
            options: dict[str, Any] = {"law": law, "limiter": limiter, "compensation": compensation}
            found += [Way(preview=each, **options) for each in previews]
        return found

    def _tried(self, key: str, *, can: bool) -> Sequence[bool | None]:
        return [False, True] if can and key not in (self.fixed or {}) else [None]

    def links(self) -> dict[str, dict[str, Any]]:
        """Return values of the links that are tried, by a name for them.

        With a network, windows of it, and none; otherwise the given link, or several round trips if
        it has no delay and `fixed` sets none.
        """
        if self.network is None:
            link = self._setup({}).link
            is_given = any(key in self._set() for key in ("link", *_LINK, *DELAYS))
            ways = (link.uplink, link.downlink)
            if is_given or any(not way.is_constant or way.delay_ms for way in ways):
                return {"the given link": {}}
            return {f"{ms:g} ms": dict.fromkeys(DELAYS, 0.5 * ms) for ms in _ROUND_TRIPS_MS}
        name, starts_s = self.windows_of(self.network)
        traces = dict.fromkeys(TRACES, name)
        windows = {
            f"window at {start_s:g} s": {**traces, **dict.fromkeys(START_KEYS.split(", "), start_s)}
            for start_s in starts_s
        }  # fmt: skip
        return {**windows, NO_NETWORK: {}}

    def runs(self) -> Iterator[tuple[Way, str, Setup]]:
        """Return all runs, checked: the way, the name of the link, and the scenario.

        Raises:
            ScenarioError: a scenario refuses a setting.
        """
        for way, (name, values) in itertools.product(self.ways(), self.links().items()):
            yield way, name, self._setup({**values_of(way, self.interface), **values})

    def margin(self) -> StudyOfRuns:
        """Return the search for the largest constant delay; raises ScenarioError."""
        given = {**interface_values(self.interface, self.loop), **self._set()}
        own = {key: each for key, each in given.items() if not key.startswith((*_LINK, LAW))}
        if _has_limiter(self.interface):
            own.setdefault(limiter_key(self.interface), True)
        values = {
            "name": "margin", "scenarios": [self.arm], "laws": [self.loop], "running": [False],
            "seeds": [1], "offsets": [1.0], "duration_s": self.duration_s,
            "limit": _LIMIT_MS,
        }  # fmt: skip
        if takes_of(self.interface) == TORQUE and COMPENSATION not in own:
            values["compensation"] = [False, True]
        return margin_study({**values, "set": own}, _SOURCE)

    def _setup(self, values: Mapping[str, Any]) -> Setup:
        own = interface_values(self.interface, self.law)
        for key, varied in itertools.product(self._set(), (KIND, *values)):
            if f"{varied}.".startswith(f"{key}."):
                option = " (--law)" if varied == LAW else ""
                what = f"must be left out: the data sheet sets {varied}{option}"
                raise ScenarioError(f"--set {key}: {what}")
        given = {**own, **_WHOLE, "duration_s": self.duration_s, **values, **self._set()}
        return load_setup(self.arm, [override(key, each) for key, each in given.items()])


def values_of(way: Way, kind: str) -> dict[str, Any]:
    """Return its values of a scenario whose robot has a kind of interface."""
    varied = {
        _PREVIEW: {None: None, False: 0.0, True: "auto"}[way.preview],
        limiter_key(kind): way.limiter,
        COMPENSATION: way.compensation,
    }
    return {LAW: way.law} | {key: each for key, each in varied.items() if each is not None}


def limiter_key(kind: str) -> str:
    """Return the key of a robot's limiter."""
    return f"plant.interface.{kind if kind in INTERFACES.shipped else 'own'}.limiter"


def _has_limiter(kind: str) -> bool:
    return "limiter" in type(InterfaceConfiguration(kind=kind).settings).model_fields


def run_row(way: Way, link: str, setup: Setup) -> RobotRun:
    """Run a robot, and return what its data sheet says of it."""
    found = judge(simulate(setup).data())
    lags = {
        name: lag
        for name, lag in zip(setup.robot.joint_names, found.lag_ms, strict=True)
        if lag is not None
    }
    joint = max(lags, key=lambda name: abs(lags[name]), default=None)
    words = (word for each in setup.overrides for word in ("--set", each))
    return RobotRun(
        **dict(way), link=link, kept=found.verdict is Verdict.KEPT, verdict=found.verdict.value,
        tip_rms_mm=found.tip_error_mm.rms, tip_largest_mm=found.tip_error_mm.largest,
        lag_ms=None if joint is None else lags[joint], lag_joint=joint,
        reflexes=found.reflexes, first_violation_s=found.bounds.first_violation_s,
        faults=found.faults, command=f"funnel-hil simulate {setup.source} {shlex.join(words)}",
    )  # fmt: skip
