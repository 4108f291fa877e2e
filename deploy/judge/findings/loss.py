"""A run's first time outside its bounds, and what is known of the time just before and after."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.messages import topics
from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Role
from bus_schema.runtime.modes import Mode
from deploy.judge.bounds import bound_usage
from deploy.judge.findings.divergence import divergence
from deploy.judge.findings.growing import Growth, turning_points
from deploy.judge.findings.lag import lag_s
from deploy.judge.findings.vibration import at_limits
from deploy.judge.motion.robot_lag import uncovered_lag_of
from deploy.judge.recorded_ticks import rows_after_gaps
from deploy.judge.run_data import RunData, Table
from deploy.scenario.robot_interface import own_lag_s

_BEFORE_S = 1.0
"""Time before the loss that is looked at."""
AFTER_S = 0.3
"""Time after the loss in which its oscillation continues, if there is one."""
MOSTLY = 0.5
LATELY_S, MUCH_OLDER, LATE_NS = 0.15, 3.0, 10e6
"""A command that was in force within this time before the loss, and older than usual by both, is
its likely cause."""
_PERIODS_WITHOUT_DELAY = 1.5
"""A command acts one period after the measurement where nothing delays it."""
_FEWEST_SWINGS, _TIMES_REFERENCE = 4, 2
SWUNG_BACK = 2
"""Changes from one torque limit to the other; a braked motion has one."""
_A_LITTLE_MORE = 1.2
_UNEVEN = 3.0
"""Cycles of the robot."""
_FEW_DELAYS = 2.0
"""A law that had less time than this shows little effect yet."""


def is_mostly(cause: float, effect: float) -> bool:
    """Whether a cause is half of an effect or more, and not so much that others make up for it."""
    return MOSTLY * effect <= cause <= effect / MOSTLY


@dataclass(frozen=True)
class Loss:
    """The loss of one joint.

    Attributes:
        joint: its number.
        acting: the first tick at which a command acts.
        tick: the first tick outside.
    """

    run: RunData
    joint: int
    acting: int
    tick: int

    @cached_property
    def truth(self) -> Table:
        return self.run.tables[topics.PLANT_TRUTH.name]

    @cached_property
    def times_s(self) -> Vector:
        return self.run.times_s(topics.PLANT_TRUTH)

    @cached_property
    def first(self) -> int:
        """The first tick of the time just before the loss."""
        return self._tick_before(_BEFORE_S)

    def _tick_before(self, seconds: float) -> int:
        """Return the tick so long before the loss, not before commands act."""
        begin_s = self.times_s[self.tick] - seconds
        return max(self.acting, int(np.searchsorted(self.times_s, begin_s)))

    @cached_property
    def end(self) -> int:
        """The end of the time just after the loss."""
        return int(np.searchsorted(self.times_s, self.times_s[self.tick] + AFTER_S))

    @cached_property
    def errors_rad(self) -> Vector:
        return np.asarray(self.run.true_errors_rad[:, self.joint])

    @cached_property
    def wanted_rad(self) -> Vector:
        """The joint's reference until the loss."""
        until = slice(self.tick + 1)
        return np.asarray(self.truth["position"][until, self.joint] - self.errors_rad[until])

    @cached_property
    def is_without_delay(self) -> bool:
        """Whether commands acted as soon as they can, and the law was asked at every state."""
        controller = self.run.setup.scenario.controller
        longest_s = 1e-9 * _PERIODS_WITHOUT_DELAY * self.run.setup.grid.period_ns
        is_asked_always = controller.every == 1 and not controller.inference_ms
        return bool(is_asked_always and self.usual_age_s + self.own_lag_s <= longest_s)

    @cached_property
    def usual_age_s(self) -> float:
        """Median time from a state until its command is in force."""
        return 1e-9 * float(np.median(self.truth["command_age_ns"][self.acting : self.tick + 1]))

    @cached_property
    def own_lag_s(self) -> float:
        return own_lag_s(self.run.setup)

    @cached_property
    def uncovered_lag_s(self) -> float:
        return uncovered_lag_of(self.run)

    @cached_property
    def is_disturbed(self) -> bool:
        """Whether a fault had begun or the arm was being stopped: then no law is to blame."""
        stopped = np.isin(self.truth["mode"][: self.tick + 1], (Mode.STOPPING, Mode.FAULT))
        faults = self.run.setup.scenario.faults
        return bool(stopped.any() or any(f.at_s <= self.times_s[self.tick] for f in faults))

    @cached_property
    def fault(self) -> str | None:
        """The last injected fault that still acts at the loss, or did shortly before."""
        loss_s = float(self.times_s[self.tick])
        acting = [
            each
            for each in self.run.setup.scenario.faults
            if each.at_s <= loss_s <= 1e-9 * each.end_ns + _BEFORE_S
        ]
        if not acting:
            return None
        last = max(acting, key=lambda fault: fault.at_s)
        return f"{last} at {last.at_s:g} s"

    @cached_property
    def sides(self) -> Vector:
        """Sign of the joint's torque at ticks where it is at a limit; 0 at others."""
        limits, torques = self.run.setup.largest_torques_nm, self.truth["torque"]
        return np.asarray(at_limits(torques, self.truth["saturated"], limits)[:, self.joint])

    def swings_s(self, part: slice) -> Vector:
        """Return when the torque got from one limit to the other one, s."""
        at = np.flatnonzero(self.sides[part])
        changed = np.diff(self.sides[part][at]) != 0.0
        return np.asarray(self.times_s[part][at[1:][changed]])

    @cached_property
    def swings_hz(self) -> float | None:
        """Frequency of swings by half of the bound or more, faster than the reference's own."""
        before = slice(self.first, self.tick + 1)
        errors, times_s = self.errors_rad[before], self.times_s[before]
        if not np.isfinite(errors).all():
            return None
        turns = turning_points(errors)
        is_large = np.abs(np.diff(errors[turns])) >= MOSTLY * abs(errors[-1])
        of_reference = len(turning_points(self.wanted_rad[before]))
        if is_large.sum() < max(_FEWEST_SWINGS, _TIMES_REFERENCE * of_reference):
            return None
        return float(0.5 / np.median(np.diff(times_s[turns])[is_large]))

    @cached_property
    def rising(self) -> slice:
        """The ticks in which the error rose from half of its size at the loss."""
        sizes = np.abs(self.errors_rad[self.acting : self.tick + 1])
        small = np.flatnonzero(sizes <= 0.5 * sizes[-1])
        return slice(self.acting + (int(small[-1]) if small.size else 0), self.tick + 1)

    @cached_property
    def is_too_weak(self) -> bool:
        """Whether the joint's torque was at its limit against the error for most of its rise."""
        against = self.sides[self.rising] * np.sign(self.errors_rad[self.rising]) < 0.0
        return bool(against.mean() > MOSTLY)

    @cached_property
    def reflex(self) -> str | None:
        """The first stop that the robot's own controller decided before the loss."""
        found = self.run.last_values(Role.PLANT, EventKind.COUNTS).get("reflexes", [])
        lost_s = float(self.times_s[self.tick])
        return next(
            (f"{e['kind']} at {e['time_s']:.3f} s" for e in found if e["time_s"] <= lost_s), None
        )

    @cached_property
    def is_starved(self) -> bool:
        """Whether the law had nothing left to send for most of the time in which the error rose."""
        ended = self.run.last_values(Role.CONTROLLER, EventKind.ENDED)
        stretches_s = ended.get("starved", {}).get("stretches_s", [])
        if not stretches_s:
            return False
        rising_s = self.times_s[self.rising]
        begins, ends = np.transpose(stretches_s)
        within = np.searchsorted(begins, rising_s, "right") - 1
        return bool(((within >= 0) & (rising_s <= ends[within])).mean() >= MOSTLY)

    @cached_property
    def oldest_s(self) -> float:
        """Age of the oldest command that was in force in the last moments."""
        recent = slice(self._tick_before(LATELY_S), self.tick + 1)
        return 1e-9 * float(self.truth["command_age_ns"][recent].max())

    @cached_property
    def is_after_late_command(self) -> bool:
        """Whether a command in force in the last moments was much older than usual before."""
        usual_ns = np.median(self.truth["command_age_ns"][self.first : self.tick + 1])
        return bool(1e9 * self.oldest_s > max(MUCH_OLDER * usual_ns, usual_ns + LATE_NS))

    @cached_property
    def is_jittery(self) -> bool:
        """Whether the age of commands varied by much more than their arrival in steps makes it."""
        setup = self.run.setup
        cycle_ns = max(setup.grid.period_ns, 1e9 * setup.scenario.plant.interface.true_period_s)
        ages_ns = self.truth["command_age_ns"][self.first : self.tick + 1]
        return bool(np.ptp(ages_ns) > _UNEVEN * cycle_ns)

    @cached_property
    def delay_s(self) -> float:
        """Time from a state until the command in force at the loss, which answers it."""
        return 1e-9 * float(self.truth["command_age_ns"][self.tick])

    @cached_property
    def arisen_share(self) -> float:
        """Share of the error that arose after the state which the command in force answers."""
        at_s, error = self.times_s[self.tick] - self.delay_s, float(self.errors_rad[self.tick])
        share = 1.0 - float(np.interp(at_s, self.times_s, self.errors_rad)) / error
        return share if np.isfinite(error) else 0.0

    @cached_property
    def is_early(self) -> bool:
        """Whether the law had less than two of its delays to act."""
        lasted_s = float(self.times_s[self.tick] - self.times_s[self.acting])
        return lasted_s <= _FEW_DELAYS * self.delay_s

    @cached_property
    def divergence(self) -> Growth | None:
        """Exponential growth with which the error left its bounds; None for none."""
        around, joint = slice(self.acting, self.end), self.joint
        errors, torques = self.errors_rad[around], self.truth["torque"][around, joint]
        if not np.isfinite(errors).all() or rows_after_gaps(self.run, self.times_s[around]).size:
            return None
        rate_hz = self.run.setup.scenario.rate_hz
        return divergence(errors, torques, self.tick - self.acting, rate_hz)

    @cached_property
    def lag_s(self) -> float | None:
        """Time by which the joint followed its reference late; None for no constant time."""
        before = slice(self.first, self.tick + 1)
        errors, period_s = self.errors_rad[before], 1e-9 * self.run.setup.grid.period_ns
        is_known = len(errors) > 1 and bool(np.isfinite(errors).all())
        if not is_known or len(self.swings_s(before)) >= SWUNG_BACK:
            return None
        return lag_s(errors, self.wanted_rad, period_s, _A_LITTLE_MORE * self.own_lag_s)

    def late_errors_rad(self, late_s: float) -> Vector:
        """Return the error of an arm that follows the joint's reference late, at every tick."""
        wanted = self.truth["position"][:, self.joint] - self.errors_rad
        return np.asarray(np.interp(self.times_s - late_s, self.times_s, wanted) - wanted)

    def is_error_of_lag(self, late_s: float) -> bool:
        """Whether half of the last error or more is that of a lag, beside an initial offset."""
        late, error = self.late_errors_rad(late_s)[self.tick], self.errors_rad[self.tick]
        return bool(late * error > 0.0 and is_mostly(late / error, 1.0))

    def is_lag_enough(self, late_s: float) -> bool:
        """Whether the error of a lag alone leaves the bounds until shortly after the loss."""
        size = np.abs(self.errors_rad)
        alone = np.abs(self.late_errors_rad(late_s)) * bound_usage(self.run)[:, self.joint] >= size
        return bool(alone[self.acting : self.end].any())
