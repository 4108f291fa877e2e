"""Reason why a run left its funnel, from the time just before and after."""

from __future__ import annotations

import math
from enum import StrEnum
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


class Reason(StrEnum):
    """Reason why a run left its funnel, or does not hold although it kept it.

    Attributes:
        words: how the error left the funnel, as the end of a sentence about it.
        meaning: when a run has this reason, for the documentation.
    """

    words: str
    meaning: str

    def __new__(cls, name: str, words: str = "", meaning: str = "") -> Reason:
        """Create a member whose value is its name in rows and summaries."""
        member = str.__new__(cls, name)
        member._value_ = name
        member.words, member.meaning = words, meaning
        return member

    START = (
        "start", "before any command acted",
        "no command had acted yet: brakes held the arm while the reference moved",
    )  # fmt: skip
    INJECTED = (
        "injected fault", "after the injected fault",
        "a fault of the scenario had begun, and had not ended more than a second before",
    )  # fmt: skip
    STOPPED = (
        "reflex", "after the robot stopped by its reflex",
        "the robot's own controller had stopped the arm",
    )  # fmt: skip
    UNSTABLE = (
        "unstable", "as an error of an unstable loop grew",
        "the error grew exponentially without a delay, or without swinging, which no delay causes:"
        " look at signs and gains of the law",
    )  # fmt: skip
    GROWING = (
        "growing", "as an oscillation grew",
        "an oscillation grew: the delay is too long for the gains",
    )  # fmt: skip
    SWINGING = (
        "oscillation", "as it oscillated",
        "an error swung by half of its bound or more, faster than the reference, without growing:"
        " the delay is too long for the gains, or they are too high",
    )  # fmt: skip
    VIBRATION = (
        "vibration", "as its torque swung between its limits",
        "the torque swung from one limit to the other and back",
    )  # fmt: skip
    LATE = (
        "late command", "after a command that was much later than usual",
        "shortly before, a command in force was much older than usual",
    )  # fmt: skip
    JITTER = (
        "jitter", "as targets arrived irregularly",
        "targets reached the robot at uneven times, and the error swung faster than a loop around"
        " the robot does: a play-out (`link.playout_ms`) or a longer lookahead smooths them",
    )  # fmt: skip
    RAN_OUT = (
        "chunk ran out", "with nothing left to send",
        "the law's chunk had no row left, and the next one was not there yet: answers take too"
        " long for their length",
    )  # fmt: skip
    JUMPED = (
        "jump", "after a jump of its target between two chunks",
        "shortly before, a new chunk moved the joint's target by half of its bound or more",
    )  # fmt: skip
    OLD_ANSWER = (
        "old answer", "while an answer acted that was much older than usual",
        "shortly before, the observation behind the law's answer was much older than usual",
    )  # fmt: skip
    SATURATED = (
        "saturated", "with torques at their limits",
        "torques were at their limits for most of the time before, or the joint's own against the"
        " error for most of its rise: the arm or the motion is too heavy for its motors",
    )  # fmt: skip
    LAG = (
        "lag", "behind the reference, in proportion to its speed",
        "the arm moved as its reference did a constant time before: the error is proportional to"
        " the reference's speed",
    )  # fmt: skip
    OWN_LAG = (
        "robot's lag", "by the robot's own lag",
        "the robot's own controller follows late, and its lag explains most of the error. It is"
        " half to twice the lag found, or explains half or more of a slow error, or leaves the"
        " bounds by itself where a command came late. A law of torques has this lag as a delay in"
        " its loop, and loses within four times that lag. Read the reference ahead by it"
        " (`controller.preview_ms`), or make the robot's own loop faster",
    )  # fmt: skip
    GRAVITY = (
        "no gravity term", "under its weight, for which the law has no term",
        "a slow error in the direction of the joint's weight, larger than friction, disturbance and"
        " payload explain. The joint could hold the weight, but the law does not know it: compare"
        " the same law with a gravity term",
    )  # fmt: skip
    DELAY = (
        "delay", "sooner than the law could act, over a delay",
        "a slow error. Half of it or more arose after the state that the command in force answers,"
        " or it was there within two delays of the first command",
    )  # fmt: skip
    DELAY_OR_MODEL = (
        "delay or model", "slowly, as by friction or an error of the model over a delay",
        "a slow error, 5 % of which or more arose after the state that the command in force"
        " answers: a shorter delay or a better model makes it smaller",
    )  # fmt: skip
    SLOW = (
        "friction or model", "slowly, as by friction or an error of the model",
        "any other slow error, next to none of which is due to the delay",
    )  # fmt: skip


_OF_TARGETS = (Reason.LAG, Reason.LATE, Reason.SATURATED, Reason.RAN_OUT, Reason.JUMPED)
"""Reasons of a law of targets that hold beside jitter."""


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
