"""Mimic joints in Bullet: gears between two joints of one arm."""

from __future__ import annotations

import ctypes
from collections.abc import Callable

from bus_schema.urdf.joints import Follower
from plant_emulator.physics.bullet.library import DOUBLE, INT, POINTER, JointInfo, function, setter

_GEAR = 6
_LARGEST_FORCE = 1e9

_couple = function("InitCreateUserConstraintCommand", POINTER, POINTER, INT, INT, INT, INT, POINTER)
_couple_id = function("GetStatusUserConstraintUniqueId", INT, POINTER)
_change_couple = function("InitChangeUserConstraintCommand", POINTER, POINTER, INT)
_set_gear_ratio = setter("InitChangeUserConstraintSetGearRatio", DOUBLE)
_set_gear_force = setter("InitChangeUserConstraintSetMaxForce", DOUBLE)
_set_gear_erp = setter("InitChangeUserConstraintSetERP", DOUBLE)
_set_gear_offset = setter("InitChangeUserConstraintSetRelativePositionTarget", DOUBLE)


def tie(
    server: int, body: int, links: tuple[int, int], follower: Follower, submit: Callable[[int], int]
) -> None:
    """Tie a joint to another one: q = multiplier × q of the leader + offset.

    The solver keeps their speeds tied in every step; an error in position fades in a few steps.

    Args:
        server: the physics server.
        body: the arm there.
        links: numbers of the joint that follows and of its leader.
        follower: how it follows.
        submit: has a command carried out; gives its status.
    """
    link, leader = links
    info = JointInfo(joint_type=_GEAR)
    info.parent_frame[6] = info.child_frame[6] = 1.0  # no rotation
    create = _couple(server, body, link, body, leader, ctypes.addressof(info))
    change = _change_couple(server, _couple_id(submit(create)))
    _set_gear_ratio(change, -follower.multiplier)
    _set_gear_offset(change, follower.offset)
    _set_gear_force(change, _LARGEST_FORCE)
    _set_gear_erp(change, 1.0)
    submit(change)
