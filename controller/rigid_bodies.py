"""Rigid-body dynamics of an arm for compiled code, which cannot call pinocchio.

The same numbers as `ManipulatorModel`'s, to rounding, in a twentieth of its time. All vectors are
written in the base frame, about its origin: there the spatial inertias of bodies that move together
simply add, and nothing is transformed from joint to joint. After Featherstone, Rigid Body Dynamics
Algorithms (2008), sections 5.3 (recursive Newton–Euler) and 6.2 (composite rigid bodies).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.compiled import compiled

Vec = tuple[float, float, float]


class RigidBodies(NamedTuple):
    """How the moving bodies of an arm hang together; body i is what joint i moves.

    What they weigh stands in inertia tables, shape (joints, 10), a row for each body in the frame
    of its joint: mass, mass times centre of mass (x, y, z), rotational inertia about the joint's
    origin (xx, xy, yy, xz, yz, zz). All of it is linear in mass: tables can be scaled and added.

    Attributes:
        outwards: numbers of the bodies such that each comes after its parent; shape (joints,).
        parents: number of the body that carries joint i, −1 for the base; shape (joints,).
        rotations: of joint i's frame in the frame of its parent, at zero; shape (joints, 3, 3).
        origins: of joint i's frame there, m; shape (joints, 3).
        axes: unit axis of joint i in its own frame, shape (joints, 3).
        slides: whether joint i moves along its axis, not about it; shape (joints,).
        gravity: m/s², in the base frame; shape (3,).
    """

    outwards: NDArray[np.int64]
    parents: NDArray[np.int64]
    rotations: NDArray[np.float64]
    origins: Matrix
    axes: Matrix
    slides: NDArray[np.bool_]
    gravity: Vector


@compiled
def _add(a: Vec, b: Vec) -> Vec:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@compiled
def _scaled(factor: float, a: Vec) -> Vec:
    return factor * a[0], factor * a[1], factor * a[2]


@compiled
def _dot(a: Vec, b: Vec) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def _cross(a: Vec, b: Vec) -> Vec:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@compiled
def _get(table: Matrix, row: int) -> Vec:
    return table[row, 0], table[row, 1], table[row, 2]


@compiled
def _put(table: Matrix, row: int, a: Vec) -> None:
    table[row, 0], table[row, 1], table[row, 2] = a


@compiled
def _rotated(rotation: Matrix, a: Vec) -> Vec:
    return (
        rotation[0, 0] * a[0] + rotation[0, 1] * a[1] + rotation[0, 2] * a[2],
        rotation[1, 0] * a[0] + rotation[1, 1] * a[1] + rotation[1, 2] * a[2],
        rotation[2, 0] * a[0] + rotation[2, 1] * a[1] + rotation[2, 2] * a[2],
    )


class _Placed(NamedTuple):
    """An arm in a posture, in the base frame.

    Attributes:
        axes: z, shape (joints, 3); 0 for joints that slide.
        moments: o × z of the joints' origins o, shape (joints, 3): with z, the joint's screw. For
            joints that slide, their direction.
        masses: shape (joints,).
        first: mass times centre of mass, shape (joints, 3).
        second: rotational inertia about the base's origin, shape (joints, 6), order as above.
    """

    axes: Matrix
    moments: Matrix
    masses: Vector
    first: Matrix
    second: Matrix


@compiled
def _turned(rotation: Matrix, axis: Vec, angle: float, out: Matrix) -> None:
    """`rotation` followed by a turn about an axis (Rodrigues' formula), into `out`."""
    c, s = math.cos(angle), math.sin(angle)
    x, y, z = axis
    d = 1.0 - c
    for row in range(3):
        a, b, e = rotation[row, 0], rotation[row, 1], rotation[row, 2]
        along = d * (a * x + b * y + e * z)
        out[row, 0] = c * a + s * (b * z - e * y) + along * x
        out[row, 1] = c * b + s * (e * x - a * z) + along * y
        out[row, 2] = c * e + s * (a * y - b * x) + along * z


@compiled
def _place(bodies: RigidBodies, inertia: Matrix, position: Vector) -> _Placed:
    joints = position.size
    placed = _Placed(
        np.empty((joints, 3)), np.empty((joints, 3)), np.empty(joints),
        np.empty((joints, 3)), np.empty((joints, 6)),
    )  # fmt: skip
    frames, origins, fixed = np.empty((joints, 3, 3)), np.empty((joints, 3)), np.empty((3, 3))
    for i in bodies.outwards:
        parent, origin = bodies.parents[i], _get(bodies.origins, i)
        if parent < 0:
            fixed[:] = bodies.rotations[i]
        else:
            for row in range(3):
                for column in range(3):
                    total = 0.0
                    for k in range(3):
                        total += frames[parent, row, k] * bodies.rotations[i, k, column]
                    fixed[row, column] = total
            origin = _add(_get(origins, parent), _rotated(frames[parent], origin))
        axis = _get(bodies.axes, i)
        z = _rotated(fixed, axis)
        if bodies.slides[i]:
            frames[i] = fixed
            origin = _add(origin, _scaled(position[i], z))
            _put(placed.axes, i, (0.0, 0.0, 0.0))
            _put(placed.moments, i, z)
        else:
            _turned(fixed, axis, position[i], frames[i])
            _put(placed.axes, i, z)
            _put(placed.moments, i, _cross(origin, z))
        _put(origins, i, origin)
        _place_inertia(inertia[i], frames[i], origin, i, placed)
    return placed


@compiled
def _place_inertia(own: Vector, frame: Matrix, o: Vec, i: int, placed: _Placed) -> None:
    """Write the inertia of body i, given in its joint's frame, about the base's origin."""
    mass = own[0]
    moment = _rotated(frame, (own[1], own[2], own[3]))
    placed.masses[i] = mass
    _put(placed.first, i, _add(_scaled(mass, o), moment))
    # R I Rᵀ by the columns of I Rᵀ
    x = _rotated(frame, (own[4], own[5], own[7]))
    y = _rotated(frame, (own[5], own[6], own[8]))
    z = _rotated(frame, (own[7], own[8], own[9]))
    trace = mass * _dot(o, o) + 2.0 * _dot(o, moment)
    index = 0
    for column in range(3):
        for row in range(column + 1):
            turned = (
                frame[column, 0] * x[row] + frame[column, 1] * y[row] + frame[column, 2] * z[row]
            )
            shift = -mass * o[row] * o[column] - o[row] * moment[column] - moment[row] * o[column]
            placed.second[i, index] = turned + shift + (trace if row == column else 0.0)
            index += 1


@compiled
def _angular_momentum(second: Vector, first: Vec, turning: Vec, velocity: Vec) -> Vec:
    """About the base's origin, of a body with this twist."""
    x, y, z = turning
    spin = (
        second[0] * x + second[1] * y + second[3] * z,
        second[1] * x + second[2] * y + second[4] * z,
        second[3] * x + second[4] * y + second[5] * z,
    )
    return _add(spin, _cross(first, velocity))


@compiled
def inverse_dynamics(
    bodies: RigidBodies, inertia: Matrix, position: Vector, velocity: Vector,
    acceleration: Vector, out: Vector,
) -> None:  # fmt: skip
    """M(q) q̈ + C(q, q̇) q̇ + G(q) into `out`, N m.

    Args:
        bodies: the arm.
        inertia: its inertia table, shape (joints, 10).
        position: q, rad, shape (joints,).
        velocity: q̇, rad/s.
        acceleration: q̈, rad/s².
        out: shape (joints,).
    """
    placed = _place(bodies, inertia, position)
    _recursive_newton_euler(bodies, placed, velocity, acceleration, out)


@compiled
def _recursive_newton_euler(
    bodies: RigidBodies, placed: _Placed, velocity: Vector, acceleration: Vector, out: Vector
) -> None:
    joints = velocity.size
    twists, rates = np.empty((2, joints, 3)), np.empty((2, joints, 3))
    forces = np.empty((2, joints, 3))
    for i in bodies.outwards:
        z, s, parent = _get(placed.axes, i), _get(placed.moments, i), bodies.parents[i]
        turning, moving = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        d_turning = (0.0, 0.0, 0.0)
        # the base accelerates upwards, which weighs the same as gravity
        d_moving = (-bodies.gravity[0], -bodies.gravity[1], -bodies.gravity[2])
        if parent >= 0:
            turning, moving = _get(twists[0], parent), _get(twists[1], parent)
            d_turning, d_moving = _get(rates[0], parent), _get(rates[1], parent)
        v, a = velocity[i], acceleration[i]
        d_turning = _add(d_turning, _add(_scaled(a, z), _scaled(v, _cross(turning, z))))
        carried = _add(_cross(turning, s), _cross(moving, z))
        d_moving = _add(d_moving, _add(_scaled(a, s), _scaled(v, carried)))
        turning, moving = _add(turning, _scaled(v, z)), _add(moving, _scaled(v, s))
        _put(twists[0], i, turning)
        _put(twists[1], i, moving)
        _put(rates[0], i, d_turning)
        _put(rates[1], i, d_moving)
        mass, first, second = placed.masses[i], _get(placed.first, i), placed.second[i]
        momentum = _add(_scaled(mass, moving), _cross(turning, first))
        spin = _angular_momentum(second, first, turning, moving)
        force = _add(_scaled(mass, d_moving), _cross(d_turning, first))
        torque = _angular_momentum(second, first, d_turning, d_moving)
        _put(forces[0], i, _add(force, _cross(turning, momentum)))
        _put(forces[1], i, _add(torque, _add(_cross(turning, spin), _cross(moving, momentum))))
    for i in bodies.outwards[::-1]:
        force, torque = _get(forces[0], i), _get(forces[1], i)
        out[i] = _dot(_get(placed.axes, i), torque) + _dot(_get(placed.moments, i), force)
        parent = bodies.parents[i]
        if parent >= 0:
            _put(forces[0], parent, _add(_get(forces[0], parent), force))
            _put(forces[1], parent, _add(_get(forces[1], parent), torque))


@compiled
def mass_and_load(
    bodies: RigidBodies, inertia: Matrix, position: Vector, velocity: Vector,
    mass: Matrix, load: Vector,
) -> None:  # fmt: skip
    """M(q) into `mass`, kg m², and C(q, q̇) q̇ + G(q) into `load`, N m.

    Args:
        bodies: the arm.
        inertia: its inertia table, shape (joints, 10).
        position: q, rad, shape (joints,).
        velocity: q̇, rad/s.
        mass: shape (joints, joints).
        load: shape (joints,).
    """
    placed = _place(bodies, inertia, position)
    _recursive_newton_euler(bodies, placed, velocity, np.zeros(velocity.size), load)
    _composite_rigid_bodies(bodies, placed, mass)


@compiled
def _composite_rigid_bodies(bodies: RigidBodies, placed: _Placed, mass: Matrix) -> None:
    """M(q) into `mass`; leaves in `placed` each body together with all that it carries."""
    mass[:] = 0.0
    for i in bodies.outwards[::-1]:
        first, second = _get(placed.first, i), placed.second[i]
        z, s = _get(placed.axes, i), _get(placed.moments, i)
        momentum = _add(_scaled(placed.masses[i], s), _cross(z, first))
        spin = _angular_momentum(second, first, z, s)
        j = i
        while j >= 0:
            along = _dot(_get(placed.axes, j), spin) + _dot(_get(placed.moments, j), momentum)
            mass[i, j] = mass[j, i] = along
            j = bodies.parents[j]
        parent = bodies.parents[i]
        if parent >= 0:
            placed.masses[parent] += placed.masses[i]
            placed.first[parent] += placed.first[i]
            placed.second[parent] += placed.second[i]


@compiled
def invert(mass: Matrix, inverse: Matrix) -> None:
    """M⁻¹ into `inverse` by Cholesky's M = L Lᵀ; `mass` keeps its values."""
    n = mass.shape[0]
    lower = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            total = mass[i, j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            lower[i, j] = math.sqrt(total) if i == j else total / lower[j, j]
    for column in range(n):
        for i in range(n):
            total = 1.0 if i == column else 0.0
            for k in range(i):
                total -= lower[i, k] * inverse[k, column]
            inverse[i, column] = total / lower[i, i]
        for i in range(n - 1, -1, -1):
            total = inverse[i, column]
            for k in range(i + 1, n):
                total -= lower[k, i] * inverse[k, column]
            inverse[i, column] = total / lower[i, i]
