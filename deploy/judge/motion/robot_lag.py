"""The lag of a robot that takes positions or velocities, and where it comes from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.link.channel_configuration import ChannelConfiguration, Outage
from bus_schema.messages import topics
from controller.laws import LAWS
from controller.outer_laws.streaming import Streaming
from deploy.judge.motion.joint_lag import follows, lags_s
from deploy.judge.motion.tip_error import tips_apart_m
from deploy.judge.result.section import Section
from deploy.judge.run_data import ROBOT_SERVER, RunData
from deploy.scenario.robot_interface import own_lag_s, preview_s, uncovered_lag_s
from plant_emulator.interfaces.settings import TORQUE

_MS, _MM = 1e3, 1e3
_LEAST_LAG_S = 0.01
"""Of a robot whose own lag is unknown: its drives."""
_SOME_LOST = 3.0
"""Cycles from one target to the next, where some are lost."""


class RobotLag(Section):
    """Parts of the lag of a robot that takes positions or velocities.

    Attributes:
        own_ms: lag of the robot's own controller at a constant speed; 0 if it is unknown
        preview_ms: how far ahead the controller reads the reference; null for a controller that is
            not a shipped law of positions or velocities
        without_preview_ms: lag of the joint that is furthest behind, if the same motion came later
            by the preview; null without one, and for a law with a loop of its own
        tip_rms_mm: RMS of the tip's error that is due to the lags of ``lag_ms`` alone
        late_ms: mean age of the commands in force beyond their age without losses; null where that
            is unknown, as with jitter, a trace, TCP, in real time and for laws slower than the loop
        late_tip_rms_mm: RMS of the tip's error that is due to these ages alone, at every tick and
            smoothed as by the robot's own lag; null for robots whose lag changes with the number of
            targets that arrive
    """

    own_ms: float
    preview_ms: float | None
    without_preview_ms: float | None
    tip_rms_mm: float | None
    late_ms: float | None
    late_tip_rms_mm: float | None


def uncovered_lag_of(run: RunData) -> float:
    """Return the robot's own lag for which nothing makes up, s; a client's program is not known."""
    own_lag = own_lag_s if run.link == ROBOT_SERVER else uncovered_lag_s
    return own_lag(run.setup)


def robot_lag(run: RunData, lags_ms: Sequence[float | None]) -> RobotLag | None:
    """Return the parts of a robot's lag; None for a robot that takes torques.

    Args:
        run: the run.
        lags_ms: of its joints; None where the reference rests.
    """
    scenario = run.setup.scenario
    interface = scenario.plant.interface
    if interface.takes == TORQUE:
        return None
    needs_all = interface.lag_s(_SOME_LOST * interface.true_period_s) is None
    late_s = _late_s(run)
    reads_ahead = run.controller in LAWS and LAWS[run.controller].gives != TORQUE
    ahead_s = preview_s(run.setup, run.setup.link) if reads_ahead else None
    lags = np.array([0.0 if each is None else each for each in lags_ms])
    return RobotLag(
        own_ms=_MS * own_lag_s(run.setup),
        preview_ms=None if ahead_s is None else _MS * ahead_s,
        without_preview_ms=_without_preview_ms(run, ahead_s) if ahead_s else None,
        tip_rms_mm=_tip_rms_mm(run, lags),
        late_ms=None if late_s is None else _MS * float(late_s[follows(run)].mean()),
        late_tip_rms_mm=None if needs_all or late_s is None else _late_tip_rms_mm(run, late_s),
    )


def _late_s(run: RunData) -> Vector | None:
    """Return by how much losses made the command in force older at each tick; None if unknown."""
    ages_ns, rows = run.tables[topics.PLANT_TRUTH.name]["command_age_ns"], follows(run)
    if not rows.any() or not _has_constant_age(run):
        return None
    without_ns = ages_ns[ages_ns >= 0].min()  # of each command that has just arrived
    return np.asarray(np.maximum(1e-9 * (ages_ns - without_ns), 0.0))


def _has_constant_age(run: RunData) -> bool:
    """Whether commands in force would all have the same age if no message were lost."""
    scenario, link = run.setup.scenario, run.setup.link
    is_varied = run.clock == "realtime" or link.transport != "udp" or link.plays_automatically
    controller, period_s = scenario.controller, 1e-9 * run.setup.grid.period_ns
    is_slow = controller.chunks is not None or controller.answer_age_s(period_s) > 0.0
    if is_varied or is_slow or run.controller not in LAWS or scenario.faults:
        return False
    return _only_loses(link.uplink) and _only_loses(link.downlink)


def _only_loses(way: ChannelConfiguration) -> bool:
    """Whether a direction delays all messages equally that it does not lose."""
    without = way.model_copy(update={"loss": 0.0, "burst_loss": None, "schedule": ()})
    return without.is_constant and all(isinstance(each, Outage) for each in way.schedule)


def _without_preview_ms(run: RunData, ahead_s: float) -> float | None:
    """Return the lag of the motion if it came later by the preview; None for a law with a loop."""
    if LAWS[run.controller].build is not Streaming:
        return None
    times_s, rows = run.times_s(topics.PLANT_TRUTH), follows(run)
    moved = run.tables[topics.PLANT_TRUTH.name]["position"]
    wanted = (moved - run.true_errors_rad)[rows]
    later = [np.interp(times_s[rows] - ahead_s, times_s, joint) for joint in moved.T]
    lags = lags_s(np.transpose(later) - wanted, run.reference_velocities_rad_s[rows])
    known = lags[np.isfinite(lags)]
    return _MS * float(known.max()) if len(known) else None


def _tip_rms_mm(run: RunData, lags_ms: NDArray[np.float64]) -> float | None:
    """Return the RMS distance of the tip from the reference's where joints have lags alone.

    None where that is not known, or no joint moves the tip.
    """
    rows = follows(run)
    positions = run.tables[topics.PLANT_TRUTH.name]["position"]
    wanted = (positions - run.true_errors_rad)[rows]
    late = wanted - lags_ms / _MS * run.reference_velocities_rad_s[rows]
    return _rms_apart_mm(run, late, wanted, moves=bool(lags_ms.any()))


def _late_tip_rms_mm(run: RunData, late_s: Vector) -> float | None:
    """Return the RMS distance of the tip from the reference's where commands are late alone.

    A robot with a lag of T responds to a late command as a mean over some 2 T.
    """
    rows, times_s = follows(run), run.times_s(topics.PLANT_TRUTH)
    lag_s = max(own_lag_s(run.setup), _LEAST_LAG_S)
    box = np.ones(1 + min(len(times_s) - 1, round(2e9 * lag_s / run.setup.grid.period_ns)))
    smooth_s = np.convolve(late_s, box / box.size)[: len(late_s)]
    wanted = run.tables[topics.PLANT_TRUTH.name]["position"] - run.true_errors_rad
    late = np.transpose([np.interp(times_s - smooth_s, times_s, joint) for joint in wanted.T])
    return _rms_apart_mm(run, late[rows], wanted[rows], moves=bool(late_s.any()))


def _rms_apart_mm(run: RunData, late: Matrix, wanted: Matrix, *, moves: bool) -> float | None:
    """Return the RMS distance of tips; None where it is unknown, or no joint moves the tip."""
    if not len(late) or not np.isfinite(late).all():
        return None
    away_m = tips_apart_m(run.setup.robot, late, wanted)
    return _MM * float(np.sqrt((away_m**2).mean())) if away_m.any() or not moves else None
