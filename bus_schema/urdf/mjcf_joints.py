"""Drives of the joints of a compiled MJCF model, and joints that are no arm's own.

Importing this module imports MuJoCo, so import it where it is used.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any

from bus_schema.arrays import Vector
from bus_schema.errors import RobotDescriptionError
from bus_schema.mujoco_library import mujoco
from bus_schema.urdf.checks import shortened

_AFFINE = mujoco.mjtBias.mjBIAS_AFFINE
_TARGET, _EQUALITY, _WRAP = mujoco.mjtTrn, mujoco.mjtEq, mujoco.mjtWrap
_CUT_SHARE = 0.5
_MOBILE_JOINTS = 3
"""So many joints of one body on the world are those of a mobile base: along, across and about."""


@dataclass
class JointActuators:
    """Limits and gains that the actuators of a joint have there; inf where there is no limit.

    Attributes:
        effort: N m or N.
        velocity: rad/s or m/s, of velocity servos.
        lower: rad or m, the lower end of the range of the joint and of its position servos.
        upper: the upper end.
        stiffness: N m/rad or N/m, of position servos.
        damping: N m s/rad or N s/m, of all servos.
    """

    effort: float = 0.0
    velocity: float = math.inf
    lower: float = -math.inf
    upper: float = math.inf
    stiffness: float = 0.0
    damping: float = 0.0

    def limit_range(self, ends: Vector) -> None:
        """Keep the part of the range that lies between both ends."""
        self.lower, self.upper = max(self.lower, ends.min()), min(self.upper, ends.max())

    def add(self, actuator: Any) -> None:
        """Add an actuator of the joint.

        Its force is gain · control + bias[0] + bias[1] · length + bias[2] · speed, the length being
        the joint's position times the gear. A motor has a gain alone. A servo comes to rest where
        the force is zero.
        """
        gear, bias = float(actuator.gear[0]), actuator.biasprm
        forces = actuator.gainprm[0] * actuator.ctrlrange
        is_limited = bool(actuator.ctrllimited[0]) and gear != 0.0
        has_own_state = bool(actuator.dyntype[0])  # its control is no force and no target
        largest = abs(actuator.forcerange).max() if actuator.forcelimited[0] else math.inf
        if is_limited and not (actuator.gaintype[0] or actuator.biastype[0] or has_own_state):
            largest = min(largest, abs(forces).max())
        self.effort += abs(gear) * largest if gear else 0.0
        if actuator.gaintype[0] or actuator.biastype[0] != _AFFINE:
            return
        self.stiffness -= bias[1] * gear**2
        self.damping -= bias[2] * gear**2
        if is_limited and not has_own_state:
            if bias[1] < 0.0:
                self.limit_range((forces + bias[0]) / (-bias[1] * gear))
            elif bias[2] < 0.0:
                speeds = abs((forces + bias[0]) / (bias[2] * gear))
                self.velocity = min(self.velocity, speeds.max())


def drives_of(
    model: Any, driven: Collection[str] | None, hold: Collection[str]
) -> tuple[dict[int, JointActuators], list[str]]:
    """Return the drives of joints by number, and warnings about those that are held.

    All joints have one if the file has no actuator.

    Args:
        model: the compiled model.
        driven: names of the joints to drive; None for those with an actuator that nothing couples.
        hold: names of joints that have a drive in any case, since they are held at a given pose.

    Raises:
        RobotDescriptionError: an actuator drives neither a joint nor a tendon.
    """
    held = {} if driven is not None else dict(_held(model))
    free = range(0 if model.nu else model.njnt)
    drives = {joint: JointActuators(effort=math.inf) for joint in free}
    for actuator in map(model.actuator, range(model.nu)):
        target = _TARGET(actuator.trntype[0])
        if target in (_TARGET.mjTRN_JOINT, _TARGET.mjTRN_JOINTINPARENT):
            drives.setdefault(int(actuator.trnid[0]), JointActuators()).add(actuator)
        elif target != _TARGET.mjTRN_TENDON:
            name = shortened(actuator.name)
            raise RobotDescriptionError(f"actuator {name!r} must drive a joint or a tendon")
    for joint in range(model.njnt):
        if model.joint(joint).name in (*(driven or ()), *hold):
            held.pop(joint, None)
            drives.setdefault(joint, JointActuators(effort=math.inf))
    drives = {joint: drive for joint, drive in drives.items() if joint not in held}
    cut = []
    for joint, drive in drives.items():
        if model.jnt_limited[joint]:
            drive.limit_range(own := model.jnt_range[joint])
            if drive.upper - drive.lower < _CUT_SHARE * (own.max() - own.min()):
                ends = f"{drive.lower:.3g} … {drive.upper:.3g} of {own.min():.3g} … {own.max():.3g}"
                cut.append(f"{model.joint(joint).name} ({ends})")
        if model.jnt_actfrclimited[joint]:
            drive.effort = min(drive.effort, abs(model.jnt_actfrcrange[joint]).max())
    for joint in range(model.njnt):
        if joint not in drives:
            held.setdefault(joint, "no actuator drives them; they are held")
    groups = {why: [model.joint(j).name for j in held if held[j] == why] for why in held.values()}
    notes = [f"{', '.join(names)}: {why}" for why, names in groups.items()]
    if cut:
        notes.append(f"ctrlrange of actuators leaves less than half of the range: {', '.join(cut)}")
    return drives, notes


def _held(model: Any) -> Iterator[tuple[int, str]]:
    """Return joints that are not driven as those of an arm, and why."""
    coupled = "tendons or equality constraints couple them; held as one rigid body with its mass"
    for group in (*_tied(model), *_on_tendons(model)):
        yield from ((joint, coupled) for joint in sorted(group))
    for body in range(1, model.nbody):
        joints = range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body])
        if model.body_parentid[body] == 0 and len(joints) >= _MOBILE_JOINTS:
            yield from ((joint, "those of a mobile base; held") for joint in joints)


def _tied(model: Any) -> Iterator[set[int]]:
    """Return joints that equality constraints couple."""
    for kind, first, second, objects, active in zip(
        model.eq_type, model.eq_obj1id, model.eq_obj2id, model.eq_objtype, model.eq_active0,
        strict=True,
    ):  # fmt: skip
        if not active:
            continue
        if _EQUALITY(kind) == _EQUALITY.mjEQ_JOINT:
            yield {joint for joint in (int(first), int(second)) if joint >= 0}
        elif _EQUALITY(kind) in (_EQUALITY.mjEQ_CONNECT, _EQUALITY.mjEQ_WELD):
            ends = [int(first), int(second)]
            if mujoco.mjtObj(objects) == mujoco.mjtObj.mjOBJ_SITE:
                ends = [int(model.site_bodyid[site]) for site in ends]
            if 0 not in ends and not any(model.body_mocapid[end] >= 0 for end in ends):
                yield _between(model, ends)


def _on_tendons(model: Any) -> Iterator[set[int]]:
    """Return joints that each tendon moves."""
    for first, number in zip(model.tendon_adr, model.tendon_num, strict=True):
        wraps = range(first, first + number)
        kinds, objects = list(map(_WRAP, model.wrap_type)), model.wrap_objid
        yield {int(objects[i]) for i in wraps if kinds[i] == _WRAP.mjWRAP_JOINT}
        sites = [objects[i] for i in wraps if kinds[i] == _WRAP.mjWRAP_SITE]
        yield _between(model, [int(model.site_bodyid[site]) for site in sites])


def _between(model: Any, bodies: list[int]) -> set[int]:
    """Return the joints on the ways between bodies: they close a chain."""
    ways: list[set[int]] = []
    for end in bodies:
        way: set[int] = set()
        body = end
        while body > 0:
            first = int(model.body_jntadr[body])
            way.update(range(first, first + int(model.body_jntnum[body])))
            body = int(model.body_parentid[body])
        ways.append(way)
    return {joint for way in ways for joint in way if not all(joint in each for each in ways)}
