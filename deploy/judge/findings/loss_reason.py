"""Reason why a run left its funnel, from the time just before and after."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from bus_schema.messages import topics
from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Role
from controller.laws import LAWS
from controller.outer_laws.streaming import Streaming
from deploy.judge.bounds import bound_usage
from deploy.judge.findings.gravity import sags
from deploy.judge.findings.growing import Growth, growing_swings
from deploy.judge.findings.loss import (
    LATE_NS,
    LATELY_S,
    MOSTLY,
    MUCH_OLDER,
    SWUNG_BACK,
    Loss,
    is_mostly,
)
from deploy.judge.findings.reason import Reason
from deploy.judge.result.section import Column, Section
from deploy.judge.run_data import ROBOT_SERVER, RunData
from deploy.scenario.robot_interface import moves_model
from plant_emulator.interfaces.settings import TORQUE

_LAGS_OF_A_SWING = 4.0
"""An integrator behind a delay of L is lost with swings of 4 L, and a double one with longer ones:
a loss before that shows none."""
_FAST_HZ = 5.0
"""Loops around robots swing more slowly."""
_NOTABLE = 0.05
"""Share of a slow error that arose within the delay; friction alone has less."""

_OF_TARGETS = (Reason.LAG, Reason.LATE, Reason.SATURATED, Reason.RAN_OUT, Reason.JUMPED)
"""Reasons of a law without a loop that jitter does not hide."""


class LossReason(Section):
    """Reason why a run left its funnel.

    Attributes:
        reason: why the run left its funnel ([table](#why-a-run-was-lost))
        joint: the joint that left it first
        time_s: time of that
        rate_per_s: of an error that grew as e^(rate t); null for none
        frequency_hz: of an oscillation; null for none
        lag_ms: the time by which the arm followed its reference late; null for no constant time
        own_lag_ms: of it, the lag of the robot's own controller at a constant speed; null unless it
            is the reason
        delay_ms: age of the command in force, ms, where the delay is a reason; null otherwise
        without_delay: whether commands acted without a delay, also of the robot's own controller,
            so that none is the cause
        fault: the injected fault, or the robot's reflex, after which it was lost; null for none
    """

    reason: Annotated[Reason, Column(of_any_part=True)]
    joint: Annotated[str, Column(of_any_part=True)]
    time_s: float
    rate_per_s: float | None = None
    frequency_hz: float | None = None
    lag_ms: float | None = None
    own_lag_ms: float | None = None
    delay_ms: float | None = None
    without_delay: bool = False
    fault: str | None = None


def loss_reason(run: RunData) -> LossReason | None:
    """Return why a run left its funnel; None if it did not, or was never moved."""
    usage = bound_usage(run)
    outside = np.flatnonzero(~(usage < 1.0).all(axis=1))
    if not outside.size:
        return None
    tick, truth = int(outside[0]), run.tables[topics.PLANT_TRUTH.name]
    worst = np.nan_to_num(usage[tick], nan=np.inf)  # an unknown position counts as outside
    joint, times_s = int(worst.argmax()), run.times_s(topics.PLANT_TRUTH)
    acting = np.flatnonzero(truth["command_age_ns"][: tick + 1] >= 0)
    if not acting.size:
        name = run.setup.robot.joint_names[joint]
        return LossReason(reason=Reason.START, joint=name, time_s=float(times_s[tick]))
    return _Loss(run, joint, int(acting[0]), tick).reason()


class _Loss(Loss):
    """The loss of one joint, and why it was lost."""

    def reason(self) -> LossReason:
        """Return the first reason that fits, the most certain ones first."""
        if self.fault is not None:
            return self._because(Reason.INJECTED).model_copy(update={"fault": self.fault})
        if self.reflex is not None:
            return self._because(Reason.STOPPED).model_copy(update={"fault": self.reflex})
        found = (
            self._of_chunks() or self._lag() or self._divergence() or self._oscillation()
            or self._late() or self._at_limits()
            or self._sag() or self._because(Reason.SLOW)
        )  # fmt: skip
        is_slow = 0.0 < (found.frequency_hz or math.inf) < _FAST_HZ
        if (
            self._gives_targets
            and self.is_jittery
            and not is_slow
            and found.reason not in _OF_TARGETS
        ):
            found = self._because(Reason.JITTER)
        if not self.is_disturbed:
            if self._is_lost_by_own_lag(found):
                own_ms = 1e3 * self.uncovered_lag_s
                own = {"reason": Reason.OWN_LAG, "rate_per_s": None, "own_lag_ms": own_ms}
                found = found.model_copy(update=own)
            elif found.reason == Reason.SLOW:
                found = self._slow()
        return found.model_copy(update={"without_delay": self.is_without_delay})

    @property
    def _gives_targets(self) -> bool:
        """Whether the law gives positions or velocities."""
        law = self.run.setup.scenario.controller.law
        return law in LAWS and LAWS[law].gives != TORQUE

    @property
    def _is_open(self) -> bool:
        """Whether the law closes no loop."""
        law = self.run.setup.scenario.controller.law
        return law in LAWS and LAWS[law].build is Streaming

    def _slow(self) -> LossReason:
        """Return what keeps an error large: swings, or its delay, of a law that acts on errors."""
        if self.swings_hz is not None:
            return self._because(Reason.SWINGING, hertz=self.swings_hz)
        is_due = self.is_early or self.arisen_share >= MOSTLY
        if self._is_open or self.is_without_delay or not (is_due or self.arisen_share >= _NOTABLE):
            return self._because(Reason.SLOW)
        found = self._because(Reason.DELAY if is_due else Reason.DELAY_OR_MODEL)
        return found.model_copy(update={"delay_ms": 1e3 * self.delay_s})

    def _is_lost_by_own_lag(self, found: LossReason) -> bool:
        """Whether the lag of the robot's own controller explains a loss."""
        if found.lag_ms is not None:
            own_ms, is_client = 1e3 * self.uncovered_lag_s, self.run.link == ROBOT_SERVER
            # A client's motion may be lost before the robot's lag has its full size.
            return is_mostly(own_ms, found.lag_ms) or (is_client and own_ms > found.lag_ms)
        if not moves_model(self.run.setup.scenario):
            late_s, is_late = self.uncovered_lag_s, found.reason == Reason.LATE
            is_slow = found.reason == Reason.SLOW or (is_late and self.is_lag_enough(late_s))
            return late_s > 0.0 and is_slow and self.is_error_of_lag(late_s)
        if found.reason == Reason.GROWING:
            return bool(self.own_lag_s >= self.usual_age_s)
        lasted_s = self.times_s[self.tick] - self.times_s[self.acting]
        is_open = found.reason in (Reason.UNSTABLE, Reason.SLOW) or (
            found.reason == Reason.LATE and self.own_lag_s >= self.oldest_s
        )
        return bool(is_open and lasted_s <= _LAGS_OF_A_SWING * self.own_lag_s)

    def _sag(self) -> LossReason | None:
        is_sag = not self.is_disturbed and sags(self.run, self.joint, self.tick)
        return self._because(Reason.GRAVITY) if is_sag else None

    def _because(
        self, reason: Reason, growth: Growth | None = None, hertz: float | None = None,
        lag_ms: float | None = None,
    ) -> LossReason:  # fmt: skip
        return LossReason(
            reason=reason,
            joint=self.run.setup.robot.joint_names[self.joint],
            time_s=float(self.times_s[self.tick]),
            rate_per_s=None if growth is None else growth.rate_per_s,
            frequency_hz=hertz if growth is None else growth.frequency_hz or None,
            lag_ms=lag_ms,
        )

    def _of_chunks(self) -> LossReason | None:
        """Whether a chunk ran out or moved the target by much, or an answer was much older."""
        if self.is_starved:
            return self._because(Reason.RAN_OUT)
        found = self.run.last_values(Role.CONTROLLER, EventKind.ENDED).get("chunks", {})
        lost_s = self.times_s[self.tick]
        if not found:
            return None
        before = [each for each in found.get("first_switches", ()) if each[0] <= lost_s]
        lately = [each for each in before if each[0] >= lost_s - LATELY_S]
        half_rad = 0.5 * abs(self.errors_rad[self.tick])
        if any(jump >= half_rad and int(joint) == self.joint for _, _, jump, joint in lately):
            return self._because(Reason.JUMPED)
        usual_s = 1e-3 * found.get("age_ms", {}).get("median", math.inf)
        asked_s = before[-1][1] if before else 0.0  # the first answer acts from the start on
        is_old = lost_s - asked_s > max(MUCH_OLDER * usual_s, usual_s + 1e-9 * LATE_NS)
        return self._because(Reason.OLD_ANSWER) if is_old else None

    def _oscillation(self) -> LossReason | None:
        around = slice(self.first, self.end)
        growth = growing_swings(self.times_s[around], self.errors_rad[around])
        return None if growth is None else self._because(Reason.GROWING, growth)

    def _late(self) -> LossReason | None:
        return self._because(Reason.LATE) if self.is_after_late_command else None

    def _divergence(self) -> LossReason | None:
        if (growth := self.divergence) is None:
            return None
        needs_delay = growth.frequency_hz > 0.0 and not self.is_without_delay
        return self._because(Reason.GROWING if needs_delay else Reason.UNSTABLE, growth)

    def _at_limits(self) -> LossReason | None:
        """Return what torques at their limits mean: too much, the wrong sign, or not enough."""
        swings_s = self.swings_s(slice(self.first, self.end))
        if len(swings_s) >= SWUNG_BACK:
            hertz = 0.5 * (len(swings_s) - 1) / float(np.ptp(swings_s))
            return self._because(Reason.VIBRATION, hertz=hertz)
        after = slice(self.tick, self.end)
        outwards = self.sides[after] * np.sign(self.errors_rad[after]) > 0.0
        if self.is_without_delay and outwards.mean() > MOSTLY:
            return self._because(Reason.UNSTABLE)
        is_saturated = self.truth["saturated"][self.first : self.tick + 1].mean() > MOSTLY
        is_weak = is_saturated or self.is_too_weak
        return self._because(Reason.SATURATED) if is_weak else None

    def _lag(self) -> LossReason | None:
        return None if self.lag_s is None else self._because(Reason.LAG, lag_ms=1e3 * self.lag_s)
