"""The whole way from logs to an identified arm, with what the logs do not show."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Vector
from bus_schema.errors import InputError
from bus_schema.robot_description import RobotDescription
from controller.manipulator_model import ManipulatorModel
from deploy.measure.identify.base_parameters import SEEN, Z_95, Grouping, grouping
from deploy.measure.identify.currents import Constants, constants_by_weight, payload_of
from deploy.measure.identify.fit import Fit, fit, prior_of
from deploy.measure.identify.identified import Identified
from deploy.measure.identify.not_seen import not_seen
from deploy.measure.identify.quality import residual_notes
from deploy.measure.identify.regression import ROTOR, Trial, split, trial_of
from deploy.measure.identify.robot_log import RobotLog, read_robot_log
from deploy.measure.identify.signals import checked, cutoff_hz, moves, samples_of
from deploy.measure.identify.warnings import warnings_of
from deploy.measure.latency import find_latency
from deploy.scenario.starter import Drives, drives_of

_LEAST_MOVING = 0.5
_SURELY, _NOTABLE = 5.0, 0.02
_LONGEST_S = 0.3


@dataclass(frozen=True)
class Wishes:
    """Options of an identification.

    Attributes:
        columns: as `read_robot_log` takes them.
        unit: of times in tables whose columns do not name it; None for seconds.
        degrees: whether positions and velocities are in degrees.
        link_side: whether the torques are measured beyond the gears, where rotors do not act.
        held_out: share at the end of each log that is not fitted, if there are no `tests`.
        constants: N m/A of each joint, if they are known.
        payload_kg: mass of the payload, if it is known.
    """

    columns: Mapping[str, str | None] = field(default_factory=dict)
    unit: str | None = None
    degrees: bool = False
    link_side: bool = False
    held_out: float = 1.0 / 3.0
    constants: Vector | None = None
    payload_kg: float | None = None


def identify(
    files: Sequence[Path], tests: Sequence[Path], loaded: Path | None, robot: RobotDescription,
    wishes: Wishes,
) -> Identified:  # fmt: skip
    """Identify an arm from its logs.

    Args:
        files: logs to fit.
        tests: logs to test the fit on; without, the end of each of `files`.
        loaded: a log with a payload.
        robot: the arm.
        wishes: how.

    Raises:
        InputError: a log cannot be used; the message says what would do.
    """
    model, drives, notes = ManipulatorModel(robot), drives_of(robot), list[str]()
    groups = [_logs_of(each, robot, wishes, notes) for each in (*files, *tests)]
    fitted, tested = (sum(map(len, g)) for g in (groups[: len(files)], groups[len(files) :]))
    if loaded:
        groups.append(_logs_of(loaded, robot, wishes, notes))
        if len(groups[-1]) > 1:
            raise InputError(f"--payload {loaded}: must have one motion, has several episodes")
    logs = list(chain.from_iterable(groups))
    if len({log.is_current for log in logs}) > 1:
        raise InputError("identify: all logs must have torques, or all currents")
    if wishes.constants is not None and not logs[0].is_current:
        raise logs[0].refusal("has torques: --current-constants is for logs of currents")
    cutoff = float(np.median([cutoff_hz(log) for log in logs]))
    trials = [trial_of(samples_of(log, cutoff), model) for log in logs]
    _require_motion(trials[:fitted], robot, logs)
    notes += [note for trial in trials for note in trial.samples.notes]
    training, held_out = _parts(trials, fitted, tested, wishes.held_out)
    constants = _constants(logs, training, model, wishes.constants)
    factors = np.ones(robot.joints) if constants is None else constants.nm_per_a
    beyond_gears = prior_of(model, _without_estimated_friction(drives))
    prior = beyond_gears if wishes.link_side else prior_of(model, drives)
    rotors = np.full(robot.joints, not wishes.link_side)
    found = fit(training, prior, factors, rotors)
    group = grouping(model)
    if (without := _without_rotor(found, group)).any():
        prior = beyond_gears if without.all() else prior
        found = fit(training, prior, factors, rotors & ~without)
        named = ", ".join(np.array(robot.joint_names)[without])
        notes.append(
            f"the torques of {named} show no rotor, as torques beyond the gears (--link-side):"
            " estimates are used"
        )
    together = trials[: fitted + tested]
    _require_one_payload(found, together, model, [log.path for log in logs])
    payload = payload_of(found, trials[-1], wishes.payload_kg) if loaded else None
    if payload is not None and payload.nm_per_a is not None:
        apart = np.nanmedian(payload.nm_per_a / factors) - 1.0
        notes.append(
            f"current constants by the payload differ by {apart:+.1%} (median) from those by the"
            " weight of the robot's file"
        )
    notes += residual_notes(found, held_out, robot.joint_names)
    result = Identified(
        robot, model, group, drives, found, training, held_out,
        ([each.name for each in files], [each.name for each in tests]), constants, payload,
        _dead_time(logs), [], list(dict.fromkeys(notes)), [],
    )  # fmt: skip
    result.not_seen.extend(not_seen(result))
    result.warnings.extend(warnings_of(result))
    return result


def _logs_of(
    path: Path, robot: RobotDescription, wishes: Wishes, notes: list[str]
) -> list[RobotLog]:
    """Return the episodes of a file that are long enough, checked, and note what was changed."""
    log = read_robot_log(path, robot.joint_names, wishes.columns, wishes.unit)
    every = (_in_radians(log) if wishes.degrees else log).episodes()
    chosen = [each for each in every if each.is_long] or every[:1]
    if short := len(every) - len(chosen):
        notes.append(f"{path.name}: {short} of {len(every)} episodes are too short, and left out")
    found = [checked(each, robot) for each in chosen]
    notes += chain.from_iterable(changed for _, changed in found)
    return [each for each, _ in found]


def _without_estimated_friction(drives: Drives) -> Drives:
    """Return drives without friction that is estimated from torques: motors have it, links hardly.

    Estimates are shares; a file, or a data sheet, has newton metres.
    """
    given = {key: each for key, each in drives.friction.items() if "_share" not in key}
    return drives._replace(friction=given)


def _in_radians(log: RobotLog) -> RobotLog:
    def turned(values: np.ndarray | None) -> np.ndarray | None:
        return None if values is None else np.radians(values)

    return replace(
        log, position=np.radians(log.position), velocity=turned(log.velocity),
        command=turned(log.command),
    )  # fmt: skip


def _require_motion(trials: list[Trial], robot: RobotDescription, logs: list[RobotLog]) -> None:
    """Refuse logs in which too few joints move."""
    moving = np.any([moves(each.samples.velocity) for each in trials], axis=0)
    if moving.mean() >= _LEAST_MOVING:
        return
    slow = ", ".join(np.array(robot.joint_names)[~moving])
    raise logs[0].refusal(
        f"too slow: {slow} never move faster than 0.05 rad/s in both directions, which friction and"
        " weight need; funnel-hil identify --design FILE writes a trajectory that shows all joints"
    )


def _parts(
    trials: list[Trial], files: int, tests: int, held_out: float
) -> tuple[list[Trial], list[Trial]]:
    """Return what is fitted, and what is held out."""
    if tests:
        return trials[:files], trials[files : files + tests]
    parts = [split(each, held_out) for each in trials[:files]]
    return [early for early, _ in parts], [late for _, late in parts]


def _constants(
    logs: list[RobotLog], training: list[Trial], model: ManipulatorModel, given: Vector | None
) -> Constants | None:
    if not logs[0].is_current:
        return None
    if given is not None:
        return Constants(given, np.full(given.size, math.nan))
    return constants_by_weight(training, model)


def _without_rotor(found: Fit, group: Grouping) -> NDArray[np.bool_]:
    """Return whether each joint's torque is seen to be that of no rotor, shape (joints,).

    Where no motion tells a rotor from its link, it is none only if all others are.
    """
    sd = found.terms_sd[:, ROTOR]
    is_none = (found.terms[:, ROTOR] < Z_95 * sd) & (sd < SEEN * found.prior.terms_sd[:, ROTOR])
    is_none &= found.has_term[:, ROTOR]
    apart = ~group.of_rotor.any(axis=1)
    return np.where(apart, is_none, is_none[apart].all() if apart.any() else is_none)


def _require_one_payload(
    found: Fit, trials: list[Trial], model: ManipulatorModel, paths: list[Path]
) -> None:
    """Refuse logs of which some carry a payload and others do not."""
    if len(trials) < 2:
        return
    masses = [payload_of(found, each, None).kg for each in trials]
    heavy = int(np.argmax([kg for kg, _ in masses]))
    light = int(np.argmin([kg for kg, _ in masses]))
    more = masses[heavy][0] - masses[light][0]
    unsure = (masses[heavy][1] + masses[light][1]) / Z_95
    if more > _SURELY * unsure and more > _NOTABLE * model.moved_kg:
        raise InputError(
            f"{paths[heavy]}: carries about {more:.2g} kg more than {paths[light]}: logs must have"
            " the same payload; --payload takes one that has another"
        )


def _dead_time(logs: list[RobotLog]) -> tuple[float, float] | None:
    """Return the dead time from commanded to measured positions; None where no log shows it."""
    found = []
    for log in logs:
        if log.command is None:
            continue
        for command, response in zip(log.command.T, log.position.T, strict=True):
            if np.isfinite(command).all():
                with contextlib.suppress(ValueError):  # this joint does not show it
                    each = find_latency(log.times_s, command, response, _LONGEST_S, is_held=False)
                    found.append(each.dead_time_s)
    if not found:
        return None
    middle = np.median([value for value, _ in found])
    return float(middle), float(np.median([half for _, half in found]))
