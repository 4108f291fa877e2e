"""Drives of the joints of a compiled MJCF model, and joints that are no arm's own.

Importing this module imports MuJoCo, so import it where it is used.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from typing import Any

from bus_schema.errors import RobotDescriptionError
from bus_schema.foreign_text import quoted
from bus_schema.mujoco_library import mujoco
from bus_schema.urdf.mjcf.actuators import ONE_SIDED, Actuator
from bus_schema.urdf.mjcf.joint_actuators import JointActuators, Omissions

_GROUPS = 31
"""Groups of actuators that a file can disable."""
_TARGET, _EQUALITY, _WRAP = mujoco.mjtTrn, mujoco.mjtEq, mujoco.mjtWrap
_CUT_SHARE = 0.5
_MOBILE_JOINTS = 3
"""So many joints of one body on the world are those of a mobile base: along, across and about."""


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
    held, omitted = {} if driven is not None else dict(_held(model)), Omissions()
    drives = _actuated(model, omitted)
    for joint in range(model.njnt):
        if model.joint(joint).name in (*(driven or ()), *hold):
            held.pop(joint, None)
            drives.setdefault(joint, JointActuators(effort=math.inf))
    drives = {joint: drive for joint, drive in drives.items() if joint not in held}
    cut = _limit(model, drives, omitted)
    for joint in range(model.njnt):
        if joint not in drives:
            held.setdefault(joint, "no actuator drives them; they are held")
    _add_joints(model, drives, omitted)
    groups = {why: [model.joint(j).name for j in held if held[j] == why] for why in held.values()}
    notes = [f"{', '.join(names)}: {why}" for why, names in groups.items()]
    if cut:
        notes.append(f"ctrlrange of actuators leaves less than half of the range: {', '.join(cut)}")
    return drives, [*notes, *omitted.sentences(drives), *_of_all(model, drives)]


def _limit(model: Any, drives: Mapping[int, JointActuators], omitted: Omissions) -> list[str]:
    """Limit drives by the limits of their joints; return the joints that lose much range."""
    cut = []
    for joint, drive in drives.items():
        name = model.joint(joint).name
        if model.jnt_limited[joint]:
            drive.limit_range(own := model.jnt_range[joint])
            if drive.upper - drive.lower < _CUT_SHARE * (own.max() - own.min()):
                ends = f"{drive.lower:.3g} … {drive.upper:.3g} of {own.min():.3g} … {own.max():.3g}"
                cut.append(f"{name} ({ends})")
        if model.jnt_actfrclimited[joint]:
            forces = model.jnt_actfrcrange[joint]
            drive.effort = min(drive.effort, abs(forces).max())
            if forces.sum():
                omitted.add("actuatorfrcrange", f"joint {name}", ONE_SIDED)
    return cut


def _actuated(model: Any, omitted: Omissions) -> dict[int, JointActuators]:
    """Return the drives of joints by number, as the actuators are; of all if there is none.

    Raises:
        RobotDescriptionError: an actuator drives neither a joint nor a tendon.
    """
    found: list[Actuator] = []
    has_tendon = False
    for number in range(model.nactuator):
        name = model.actuator(number).name or number
        target = _TARGET(int(model.actuator_trntype[number]))
        if _is_disabled(model, number):
            why = "its group is disabled (actuatorgroupdisable); it is left out"
            omitted.add("group", f"actuator {name}", why)
        elif target in (_TARGET.mjTRN_JOINT, _TARGET.mjTRN_JOINTINPARENT):
            found.append(Actuator(model, number, omitted))
        elif target == _TARGET.mjTRN_TENDON:
            has_tendon = True
        elif target == _TARGET.mjTRN_BODY:
            omitted.add("adhesion", f"actuator {name}")
        else:
            raise RobotDescriptionError(
                f"actuator {quoted(str(name))} must drive a joint or a tendon"
            )
    drives = {each.joint: JointActuators() for each in found if each.has_input}
    if not drives and not has_tendon:
        drives = {joint: JointActuators(effort=math.inf) for joint in range(model.njnt)}
    for each in found:
        if each.joint in drives:
            each.add_to(drives[each.joint])
    return drives


def _is_disabled(model: Any, number: int) -> bool:
    group = int(model.actuator_group[number])
    return 0 <= group < _GROUPS and bool(model.opt.disableactuator >> group & 1)


def _add_joints(model: Any, drives: Mapping[int, JointActuators], omitted: Omissions) -> None:
    """Add inertia and friction of the joints themselves to their drives."""
    for joint, drive in drives.items():
        place, name = int(model.jnt_dofadr[joint]), f"joint {model.joint(joint).name}"
        drive.rotor_inertia += float(model.dof_armature[place])
        drive.viscous += float(model.dof_damping[place])
        drive.coulomb += float(model.dof_frictionloss[place])
        if model.dof_dampingpoly[place].any():
            omitted.add("quadratic and cubic damping", name)
        if model.jnt_stiffness[joint] or model.jnt_stiffnesspoly[joint].any():
            omitted.add("stiffness", name)


def _of_all(model: Any, drives: Mapping[int, JointActuators]) -> Iterator[str]:
    """Return warnings about what differs among joints, and is the same for all of them here."""
    for name, unit, scale in (("delay", "ms", 1e3), ("lag", "ms", 1e3), ("cogging_periods", "", 1)):
        values = {model.joint(joint).name: getattr(each, name) for joint, each in drives.items()}
        if len({*values.values()}) > 1:
            shown = ", ".join(f"{scale * each:g} of {joint}" for joint, each in values.items())
            what = name.replace("_", " ")
            yield f"{what} of actuators: {shown}: the largest, {scale * max(values.values()):g}" + (
                f" {unit} is that of all joints here"
            )


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
