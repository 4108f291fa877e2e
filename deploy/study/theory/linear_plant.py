"""The arm of a scenario at its start as a linear system, ẋ = A x + B τ, y = C x.

Rigid gears: M q̈ + D q̇ + ∂G/∂q q = τ. Elastic gears, with rotors θ of inertia J:

    J θ̈ + D θ̇ + k (θ − q) + d (θ̇ − q̇) = τ,    M q̈ + ∂G/∂q q = k (θ − q) + d (θ̇ − q̇).

Actuators may lag, and drives may close a loop of their own around the reference, which is at rest.
Dry friction and cogging are no linear torques, and left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bus_schema.arrays import Matrix
from bus_schema.drive_feedback import no_drive_feedback
from controller.manipulator_model import ManipulatorModel
from deploy.scenario.setup import Setup
from plant_emulator.arm.drive_train import drive_trains, friction_table
from plant_emulator.configuration import PlantConfiguration


@dataclass(frozen=True)
class LinearPlant:
    """A linear system from torques to measured positions and velocities.

    Attributes:
        dynamics: A, shape (states, states).
        inputs: B, shape (states, joints).
        outputs: C, shape (2 joints, states): positions, then velocities.
        inertia: that of arm and rotors, shape (joints, joints), kg m².
    """

    dynamics: Matrix
    inputs: Matrix
    outputs: Matrix
    inertia: Matrix


def linear_plant(setup: Setup) -> LinearPlant:
    """Return a scenario's arm at its start, with payload, rotors, gears, friction and gravity."""
    plant, controller = setup.scenario.plant, setup.scenario.controller
    trains = drive_trains(plant.actuator, setup.robot, setup.grid.substep_s)
    train, joints = trains.joints, setup.robot.joints
    model = ManipulatorModel(setup.robot, payload_kg=plant.payload_kg)
    mass = model.mass_matrix(setup.start_position_rad)
    weight = model.gravity_stiffness(setup.start_position_rad)
    rotors = np.diag(train["rotor_kg_m2"])
    friction = np.diag(friction_table(plant.friction, train["saturation_nm"])["viscous_nm_s"])
    if trains.is_elastic:
        gear, damper = np.diag(train["stiffness_nm_rad"]), np.diag(train["damping_nm_s"])
        between = np.array([[1.0, -1.0], [-1.0, 1.0]])
        inertia = _on_the_diagonal(rotors, mass)
        stiffness = np.kron(between, gear) + _on_the_diagonal(0.0 * mass, weight)
        damping = np.kron(between, damper) + _on_the_diagonal(friction, 0.0 * mass)
    else:
        inertia, stiffness, damping = mass + rotors, weight, friction
    drive = setup.drive if controller.drive_feedback.enabled else no_drive_feedback(joints)
    feedback = np.zeros((joints, 2 * len(inertia)))
    feedback[:, :joints] = np.diag(drive.stiffness_nm_rad)
    feedback[:, len(inertia) :][:, :joints] = np.diag(drive.damping_nm_s)
    dynamics, inputs = _actuated(*_mechanics(inertia, stiffness, damping, joints), feedback, plant)
    outputs = np.zeros((2 * joints, len(dynamics)))
    first = joints if trains.is_elastic and plant.actuator.encoder_side == "link" else 0
    outputs[:joints, first:][:, :joints] = np.eye(joints)
    outputs[joints:, len(inertia) + first :][:, :joints] = np.eye(joints)
    return LinearPlant(dynamics, inputs, outputs, mass + rotors)


def _mechanics(
    inertia: Matrix, stiffness: Matrix, damping: Matrix, joints: int
) -> tuple[Matrix, Matrix]:
    """Return A and B of masses, the first of which are driven."""
    masses = len(inertia)
    answer = np.linalg.inv(inertia)
    dynamics, inputs = np.zeros((2 * masses, 2 * masses)), np.zeros((2 * masses, joints))
    dynamics[:masses, masses:] = np.eye(masses)
    dynamics[masses:] = -answer @ np.hstack([stiffness, damping])
    inputs[masses:] = answer[:, :joints]
    return dynamics, inputs


def _actuated(
    dynamics: Matrix, inputs: Matrix, feedback: Matrix, plant: PlantConfiguration
) -> tuple[Matrix, Matrix]:
    """Return A and B with the drives' own feedback, and with actuators that lag."""
    if not (lag_s := plant.actuator.lag_s):
        return dynamics - inputs @ feedback, inputs
    own = np.eye(len(feedback)) / lag_s
    return (
        np.block([[dynamics, inputs], [-own @ feedback, -own]]),
        np.vstack([np.zeros_like(inputs), own]),
    )


def _on_the_diagonal(first: Matrix, second: Matrix) -> Matrix:
    return np.block([[first, np.zeros_like(first)], [np.zeros_like(first), second]])
