"""Rigid-body dynamics of an arm for compiled code, which cannot call pinocchio.

The results equal `ManipulatorModel`'s, except for rounding, in a twentieth of its time. All vectors
are written in the base frame, about its origin: there the spatial inertias of bodies that move
together add, without transformations from joint to joint. After Featherstone, Rigid Body Dynamics
Algorithms (2008), sections 5.3 (recursive Newton–Euler) and 6.2 (composite rigid bodies).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.compiled import assign, compiled, scratch
from controller.rigid_bodies.vectors import (
    Vec,
    add,
    cross,
    dot,
    get,
    put,
    rotated,
    scaled,
    turned,
)

ROTOR = 10
"""Column of an inertia table for the rotors."""


class RigidBodies(NamedTuple):
    """Kinematic structure of an arm; body i is moved by joint i: driven joints, then mimic joints.

    A joint's position is factor × that of the driven joint that it follows, or is, + offset.
    Masses are in inertia tables, shape (bodies, 11), with a row for each body in its joint's frame:
    mass, mass times centre of mass (x, y, z), rotational inertia about the joint's origin (xx, xy,
    yy, xz, yz, zz), and the inertia of the joint's rotor. All of it is linear in mass: tables can
    be scaled and added.

    Attributes:
        outwards: numbers of the bodies, each after its parent; shape (bodies,).
        parents: number of the body that carries joint i, −1 for the base; shape (bodies,).
        rotations: of joint i's frame in the frame of its parent, at zero; shape (bodies, 3, 3).
        origins: of joint i's frame there, m; shape (bodies, 3).
        axes: unit axis of joint i in its own frame, shape (bodies, 3).
        slides: whether joint i is prismatic; shape (bodies,).
        leaders: number of the driven joint that joint i follows, or is; shape (bodies,).
        factors: shape (bodies,).
        offsets: shape (bodies,), rad or m.
        gravity: m/s², in the base frame; shape (3,).
    """

    outwards: NDArray[np.int64]
    parents: NDArray[np.int64]
    rotations: NDArray[np.float64]
    origins: Matrix
    axes: Matrix
    slides: NDArray[np.bool_]
    leaders: NDArray[np.int64]
    factors: Vector
    offsets: Vector
    gravity: Vector


class _Placed(NamedTuple):
    """An arm in a posture, in the base frame.

    Attributes:
        axes: z, shape (bodies, 3); 0 for prismatic joints.
        moments: o × z of the joints' origins o, shape (bodies, 3): with z, the joint's screw. For
            prismatic joints, their direction.
        masses: shape (bodies,).
        first: mass times centre of mass, shape (bodies, 3).
        second: rotational inertia about the base's origin, shape (bodies, 6), order as above.
    """

    axes: Matrix
    moments: Matrix
    masses: Vector
    first: Matrix
    second: Matrix


@compiled
def _place(bodies: RigidBodies, inertia: Matrix, position: Vector, placed: _Placed) -> None:
    count = bodies.parents.size
    frames, origins, fixed = scratch((count, 3, 3)), scratch((count, 3)), scratch((3, 3))
    for i in bodies.outwards:
        parent, origin = bodies.parents[i], get(bodies.origins, i)
        if parent < 0:
            assign(fixed, bodies.rotations[i])
        else:
            for row in range(3):
                for column in range(3):
                    total = 0.0
                    for k in range(3):
                        total += frames[parent, row, k] * bodies.rotations[i, k, column]
                    fixed[row, column] = total
            origin = add(get(origins, parent), rotated(frames[parent], origin))
        axis = get(bodies.axes, i)
        z = rotated(fixed, axis)
        moved = bodies.factors[i] * position[bodies.leaders[i]] + bodies.offsets[i]
        if bodies.slides[i]:
            assign(frames[i], fixed)
            origin = add(origin, scaled(moved, z))
            put(placed.axes, i, (0.0, 0.0, 0.0))
            put(placed.moments, i, z)
        else:
            turned(fixed, axis, moved, frames[i])
            put(placed.axes, i, z)
            put(placed.moments, i, cross(origin, z))
        put(origins, i, origin)
        _place_inertia(inertia[i], frames[i], origin, i, placed)


@compiled
def _place_inertia(own: Vector, frame: Matrix, o: Vec, i: int, placed: _Placed) -> None:
    """Write the inertia of body i, given in its joint's frame, about the base's origin."""
    mass = own[0]
    moment = rotated(frame, (own[1], own[2], own[3]))
    placed.masses[i] = mass
    put(placed.first, i, add(scaled(mass, o), moment))
    # R I Rᵀ by the columns of I Rᵀ
    x = rotated(frame, (own[4], own[5], own[7]))
    y = rotated(frame, (own[5], own[6], own[8]))
    z = rotated(frame, (own[7], own[8], own[9]))
    trace = mass * dot(o, o) + 2.0 * dot(o, moment)
    index = 0
    for column in range(3):
        for row in range(column + 1):
            along = (
                frame[column, 0] * x[row] + frame[column, 1] * y[row] + frame[column, 2] * z[row]
            )
            shift = -mass * o[row] * o[column] - o[row] * moment[column] - moment[row] * o[column]
            placed.second[i, index] = along + shift + (trace if row == column else 0.0)
            index += 1


@compiled
def _momentum(placed: _Placed, i: int, turning: Vec, moving: Vec) -> tuple[Vec, Vec]:
    """Return linear momentum, and angular about the base's origin, of body i with this twist."""
    x, y, z = turning
    first, second = get(placed.first, i), placed.second[i]
    spin = (
        second[0] * x + second[1] * y + second[3] * z,
        second[1] * x + second[2] * y + second[4] * z,
        second[3] * x + second[4] * y + second[5] * z,
    )
    linear = add(scaled(placed.masses[i], moving), cross(turning, first))
    return linear, add(spin, cross(first, moving))


@compiled
def _along(placed: _Placed, i: int, linear: Vec, angular: Vec) -> float:
    """Return the component of a force and a torque, or of a momentum, along joint i's axis."""
    return dot(get(placed.axes, i), angular) + dot(get(placed.moments, i), linear)


@compiled
def inverse_dynamics(
    bodies: RigidBodies, inertia: Matrix, position: Vector, velocity: Vector,
    acceleration: Vector, out: Vector,
) -> None:  # fmt: skip
    """Write M(q) q̈ + C(q, q̇) q̇ + G(q) into `out`, N m.

    Args:
        bodies: the arm.
        inertia: its inertia table, shape (bodies, 11).
        position: q, rad, shape (joints,).
        velocity: q̇, rad/s.
        acceleration: q̈, rad/s².
        out: shape (joints,).
    """
    count = bodies.parents.size
    placed = _Placed(
        scratch((count, 3)), scratch((count, 3)), scratch(count),
        scratch((count, 3)), scratch((count, 6)),
    )  # fmt: skip
    _place(bodies, inertia, position, placed)
    _recursive_newton_euler(bodies, placed, velocity, acceleration, out)
    for i in range(out.size):
        out[i] += inertia[i, ROTOR] * acceleration[i]


@compiled
def _recursive_newton_euler(
    bodies: RigidBodies, placed: _Placed, velocity: Vector, acceleration: Vector, out: Vector
) -> None:
    count = bodies.parents.size
    twists, rates, forces = scratch((2, count, 3)), scratch((2, count, 3)), scratch((2, count, 3))
    for i in bodies.outwards:
        z, s, parent = get(placed.axes, i), get(placed.moments, i), bodies.parents[i]
        turning, moving = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        d_turning = (0.0, 0.0, 0.0)
        # an upward acceleration of the base equals gravity
        d_moving = (-bodies.gravity[0], -bodies.gravity[1], -bodies.gravity[2])
        if parent >= 0:
            turning, moving = get(twists[0], parent), get(twists[1], parent)
            d_turning, d_moving = get(rates[0], parent), get(rates[1], parent)
        factor, leader = bodies.factors[i], bodies.leaders[i]
        v, a = factor * velocity[leader], factor * acceleration[leader]
        d_turning = add(d_turning, add(scaled(a, z), scaled(v, cross(turning, z))))
        carried = add(cross(turning, s), cross(moving, z))
        d_moving = add(d_moving, add(scaled(a, s), scaled(v, carried)))
        turning, moving = add(turning, scaled(v, z)), add(moving, scaled(v, s))
        put(twists[0], i, turning)
        put(twists[1], i, moving)
        put(rates[0], i, d_turning)
        put(rates[1], i, d_moving)
        momentum, spin = _momentum(placed, i, turning, moving)
        force, torque = _momentum(placed, i, d_turning, d_moving)
        put(forces[0], i, add(force, cross(turning, momentum)))
        put(forces[1], i, add(torque, add(cross(turning, spin), cross(moving, momentum))))
    out[:] = 0.0
    for i in bodies.outwards[::-1]:
        force, torque = get(forces[0], i), get(forces[1], i)
        out[bodies.leaders[i]] += bodies.factors[i] * _along(placed, i, force, torque)
        parent = bodies.parents[i]
        if parent >= 0:
            put(forces[0], parent, add(get(forces[0], parent), force))
            put(forces[1], parent, add(get(forces[1], parent), torque))


@compiled
def mass_and_load(
    bodies: RigidBodies, inertia: Matrix, position: Vector, velocity: Vector,
    mass: Matrix, load: Vector,
) -> None:  # fmt: skip
    """Write M(q) into `mass`, kg m², and C(q, q̇) q̇ + G(q) into `load`, N m.

    Args:
        bodies: the arm.
        inertia: its inertia table, shape (bodies, 11).
        position: q, rad, shape (joints,).
        velocity: q̇, rad/s.
        mass: shape (joints, joints).
        load: shape (joints,).
    """
    count = bodies.parents.size
    placed = _Placed(
        scratch((count, 3)), scratch((count, 3)), scratch(count),
        scratch((count, 3)), scratch((count, 6)),
    )  # fmt: skip
    _place(bodies, inertia, position, placed)
    still = scratch(velocity.size)
    still[:] = 0.0
    _recursive_newton_euler(bodies, placed, velocity, still, load)
    _composite_rigid_bodies(bodies, placed, mass)
    _add_rotors(inertia, mass)


@compiled
def mass_matrix(bodies: RigidBodies, inertia: Matrix, position: Vector, mass: Matrix) -> None:
    """Write M(q) into `mass`, kg m², shape (joints, joints); the rest as for `mass_and_load`."""
    count = bodies.parents.size
    placed = _Placed(
        scratch((count, 3)), scratch((count, 3)), scratch(count),
        scratch((count, 3)), scratch((count, 6)),
    )  # fmt: skip
    _place(bodies, inertia, position, placed)
    _composite_rigid_bodies(bodies, placed, mass)
    _add_rotors(inertia, mass)


@compiled
def _add_rotors(inertia: Matrix, mass: Matrix) -> None:
    """Add the rotors, each of which turns only with its own joint."""
    for i in range(mass.shape[0]):
        mass[i, i] += inertia[i, ROTOR]


@compiled
def _composite_rigid_bodies(bodies: RigidBodies, placed: _Placed, mass: Matrix) -> None:
    """Write M(q) into `mass`; combine each body in `placed` with the bodies it carries."""
    mass[:] = 0.0
    for i in bodies.outwards[::-1]:
        momentum, spin = _momentum(placed, i, get(placed.axes, i), get(placed.moments, i))
        j = i
        while j >= 0:
            first, second = bodies.leaders[i], bodies.leaders[j]
            felt = bodies.factors[i] * bodies.factors[j] * _along(placed, j, momentum, spin)
            mass[first, second] += felt
            if j != i:
                mass[second, first] += felt
            j = bodies.parents[j]
        parent = bodies.parents[i]
        if parent >= 0:
            placed.masses[parent] += placed.masses[i]
            _add_to(placed.first[parent], placed.first[i])
            _add_to(placed.second[parent], placed.second[i])


@compiled
def _add_to(sums: Vector, values: Vector) -> None:
    """Add values to sums; with ``+=``, numba compiles its message about shapes."""
    for k in range(values.size):
        sums[k] += values[k]
