"""MuJoCo as a physics engine: compiled code calls MuJoCo's C function for each step."""

from __future__ import annotations

import ctypes
import xml.etree.ElementTree as ET
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Matrix, Vector
from bus_schema.errors import RobotDescriptionError
from bus_schema.mujoco_library import mujoco
from bus_schema.robot_description import RobotDescription
from bus_schema.runtime.compiled import bind, c_function, compiled
from bus_schema.urdf.joints import Follower
from bus_schema.urdf.resolved import PAYLOAD_LINK
from plant_emulator.arm.drive_train import place_rotors
from plant_emulator.arm.joint_torques import TOTAL, TorqueTables, joint_torques
from plant_emulator.physics.engine import ArmPhysics, ArmSpecification

_INTEGRATORS = {
    "semi_implicit_euler": mujoco.mjtIntegrator.mjINT_EULER,
    "runge_kutta_4": mujoco.mjtIntegrator.mjINT_RK4,
}
_SWITCHED_OFF = ("CONTACT", "LIMIT", "EULERDAMP", "AUTORESET", "SENSOR", "ACTUATION")
_HELD_KG_M2 = 1e12
"""Inertia of a joint that its brake holds: any torque moves it less than rounding does."""
_HARDEST = 0.9999
"""The hardest constraint that MuJoCo accepts."""


def _step_function() -> Any:
    """Return ``mj_step`` for compiled code; None if MuJoCo's package has another layout."""
    found = sorted(Path(mujoco.__file__).parent.glob("libmujoco.*"))
    if not (found and hasattr(mujoco.MjModel, "_address") and hasattr(mujoco.MjData, "_address")):
        return None
    return c_function(ctypes.CDLL(str(found[0])), "mj_step", "void", "uintp", "uintp")


step = _step_function()


class Bodies(NamedTuple):
    """Handles of an arm for compiled code.

    Attributes:
        model: address of MuJoCo's model.
        data: address of its state.
        places: index of each joint in MuJoCo's lists, shape (joints,).
        positions: MuJoCo's array, rad; this and the next three have shape (joints and mimic
            joints,).
        velocities: rad/s.
        torques: N m.
        inertia: inertia of rotors and brakes at each joint, kg m².
    """

    model: int
    data: int
    places: NDArray[np.int64]
    positions: Vector
    velocities: Vector
    torques: Vector
    inertia: Vector


class MujocoArm(ArmPhysics):
    """An arm in its own world, without contacts, joint limits or MuJoCo's own damping.

    Brakes are ideal: a braked joint stops at once and does not slip. The other joints take the
    impulse of that stop.

    Raises:
        RobotDescriptionError: MuJoCo cannot load the arm.
    """

    def __init__(self, specification: ArmSpecification) -> None:
        super().__init__(specification)
        robot, grid = specification.robot, specification.grid
        model = _compiled_model(robot, specification.loaded_kg)
        model.opt.timestep = grid.substep_s
        model.opt.integrator = _INTEGRATORS[specification.integrator]
        self._model, self._data = model, mujoco.MjData(model)
        self._robot = robot
        places = np.array([model.joint(name).id for name in robot.joint_names])
        rotors, data = specification.rotor_inertia_kg_m2, self._data
        self._rotors: Vector = np.zeros(robot.joints) if rotors is None else rotors
        model_at, data_at = (0, 0) if step is None else (model._address, data._address)
        self._bodies = Bodies(
            model_at, data_at, places, data.qpos, data.qvel, data.qfrc_applied, model.dof_armature
        )
        self._add_inertia(self._rotors)
        tables, period_ns = self._torques.tables, grid.period_ns
        fixed = (self._bodies, self.motion, period_ns, grid.substeps, tables)
        self._advance: Callable[[int, int], tuple[bool, int]] = (
            partial(_advance_slowly, model, data, *fixed)
            if step is None
            else bind(_advance, *fixed, free=["int64", "int64"])
        )
        if specification.loaded_kg != self.payload_kg:
            self.carry(self.payload_kg)

    @staticmethod
    def check(robot: RobotDescription, payload_kg: float, *, gui: bool) -> None:  # noqa: ARG004
        """Check that MuJoCo can load an arm; a successful check is not repeated."""
        _checked(robot.path, robot.resolved_urdf(payload_kg, "none"), robot.followers)

    def place(self, position: Vector) -> None:
        bodies = self._bodies
        for name, placed in self._robot.joint_positions(position).items():
            bodies.positions[self._model.joint(name).id] = placed
        self._rest()
        _read(bodies, self.motion)
        if (trains := self._torques.tables.trains).is_elastic:
            mujoco.mj_forward(self._model, self._data)
            place_rotors(trains, position, self._data.qfrc_bias[bodies.places])

    def hold(self, joints: Sequence[bool]) -> None:
        model, data, bodies = self._model, self._data, self._bodies
        momentum = np.zeros(model.nv)
        mujoco.mj_forward(model, data)
        mujoco.mj_mulM(model, data, momentum, bodies.velocities)
        self._add_inertia(np.where(joints, _HELD_KG_M2, self._rotors))
        # A brake acts on its own joint only: the momentum along the free ones is kept.
        mujoco.mj_forward(model, data)
        mujoco.mj_solveM(model, data, bodies.velocities[None], momentum[None])
        _read(bodies, self.motion)

    def _add_inertia(self, inertia_kg_m2: Vector) -> None:
        """Set the inertia of rotors and brakes at each joint, shape (joints,)."""
        self._bodies.inertia[self._bodies.places] = inertia_kg_m2
        if self._model.dof_simplenum.any():  # a constant of MuJoCo contains it
            mujoco.mj_setConst(self._model, mujoco.MjData(self._model))

    def carry(self, payload_kg: float) -> None:
        super().carry(payload_kg)
        self._model.body(_renamed(PAYLOAD_LINK)).mass = payload_kg
        mujoco.mj_setConst(self._model, mujoco.MjData(self._model))

    def advance(self, first: int, end: int) -> None:
        saturated, hits = self._advance(first, end)
        self._torques.note(saturated=saturated, hits=hits)

    def advance_braked(self, substeps: int) -> None:  # noqa: ARG002 (they hold for any time)
        self._rest()
        _read(self._bodies, self.motion)

    def close(self) -> None:
        """Do nothing: there is nothing to free."""

    def _rest(self) -> None:
        self._bodies.velocities[:] = 0.0


@compiled
def _advance(
    bodies: Bodies, motion: Matrix, period_ns: int, substeps: int, tables: TorqueTables,
    first: int, end: int,
) -> tuple[bool, int]:  # fmt: skip
    saturated, hits = False, 0
    for number in range(first, end):
        saturated, new_hits = _apply(bodies, motion, period_ns, substeps, tables, number)
        hits |= new_hits
        step(bodies.model, bodies.data)
        _read(bodies, motion)
    return saturated, hits


def _advance_slowly(
    model: Any, data: Any, bodies: Bodies, motion: Matrix, period_ns: int, substeps: int,
    tables: TorqueTables, first: int, end: int,
) -> tuple[bool, int]:  # fmt: skip
    """Compute the same bits by MuJoCo's Python function, for builds without its addresses."""
    saturated, hits = False, 0
    for number in range(first, end):
        saturated, new_hits = _apply(bodies, motion, period_ns, substeps, tables, number)
        hits |= new_hits
        mujoco.mj_step(model, data)
        _read(bodies, motion)
    return saturated, hits


@compiled
def _apply(
    bodies: Bodies, motion: Matrix, period_ns: int, substeps: int, tables: TorqueTables, number: int
) -> tuple[bool, int]:
    """Apply the torques of a substep; return the result of `joint_torques`."""
    found = joint_torques(motion, (number * period_ns // substeps) * 1e-9, tables)
    for i in range(motion.shape[1]):
        bodies.torques[bodies.places[i]] = tables.torques_nm[TOTAL, i]
    return found


@compiled
def _read(bodies: Bodies, motion: Matrix) -> None:
    """Read positions and velocities of the joints; braked joints stand still."""
    for i in range(motion.shape[1]):
        place = bodies.places[i]
        if bodies.inertia[place] == _HELD_KG_M2:
            bodies.velocities[place] = 0.0
        motion[0, i] = bodies.positions[place]
        motion[1, i] = bodies.velocities[place]


def _compiled_model(robot: RobotDescription, payload_kg: float) -> Any:
    """Return a new model of an arm.

    Raises:
        RobotDescriptionError: MuJoCo cannot load it.
    """
    return _compiled(robot.path, robot.resolved_urdf(payload_kg, "none"), robot.followers)


def _compiled(path: Path, urdf: str, followers: tuple[Follower, ...]) -> Any:
    try:
        spec = mujoco.MjSpec.from_string(_for_mujoco(urdf))
        for name in (*_SWITCHED_OFF, *(() if followers else ("CONSTRAINT",))):
            spec.option.disableflags |= int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}"))
        for follower in followers:
            _tie(spec, follower)
        return spec.compile()
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise RobotDescriptionError(f"{path}: MuJoCo: {reason}") from error


_checked = lru_cache(maxsize=16)(_compiled)


@lru_cache(maxsize=16)
def _for_mujoco(urdf: str) -> str:
    """Return a resolved URDF in MuJoCo's terms: joints without limits, links unchanged.

    Links are renamed, as MuJoCo has a body called ``world``.
    """
    root = ET.fromstring(urdf)
    for joint in root.findall("joint"):
        if joint.get("type") == "revolute":
            joint.set("type", "continuous")
        for child in [*joint.findall("limit"), *joint.findall("dynamics")]:
            joint.remove(child)
        for end in [*joint.findall("parent"), *joint.findall("child")]:
            end.set("link", _renamed(end.get("link", "")))
    for link in root.findall("link"):
        link.set("name", _renamed(link.get("name", "")))
    settings = {"fusestatic": "false", "balanceinertia": "false", "boundmass": "0"}
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", settings)
    return ET.tostring(root, encoding="unicode")


def _renamed(link: str) -> str:
    return f"link {link}"


def _tie(spec: Any, follower: Follower) -> None:
    """Couple a joint to another one: q = multiplier × q of the leader + offset."""
    tie = spec.add_equality()
    tie.type = mujoco.mjtEq.mjEQ_JOINT
    tie.name1, tie.name2 = follower.name, follower.leader
    tie.data[:2] = follower.offset, follower.multiplier
    tie.solimp[:2] = _HARDEST
