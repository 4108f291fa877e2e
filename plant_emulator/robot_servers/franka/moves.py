"""Kinds of moves of the research interface, and what moves the arm in each."""

from __future__ import annotations

from enum import StrEnum
from typing import Any

import numpy as np

from bus_schema.arrays import Matrix, Vector
from plant_emulator.interfaces.franka import FrankaMotionSettings, FrankaVelocitySettings
from plant_emulator.interfaces.franka_torque import FrankaTorque, FrankaTorqueSettings
from plant_emulator.interfaces.interface import FreeTorque, RobotInterface, Stoppable
from plant_emulator.interfaces.settings import InterfaceSettings


class Kind(StrEnum):
    """Kind of the targets that a client sends."""

    POSITION = "position"
    VELOCITY = "velocity"
    TORQUE = "torque"


class ExternalTorque(Stoppable):
    """Torques of a client, to which the robot adds that of gravity.

    The limit of the rate holds from the first torque on, as a step from 0: libfranka's limiter
    takes its steps from ``tau_J_d``, the desired torque without gravity. A torque that ends the
    move does not act.

    Args:
        torques: checks and holds them.

    Attributes:
        torque_nm: that acts besides gravity's, shape (joints,).
    """

    def __init__(self, torques: FrankaTorque) -> None:
        self._torques = torques

    def start(self, position_rad: Vector) -> None:
        self.torque_nm: Vector = np.zeros(position_rad.size)
        self._torques.start(position_rad, self.torque_nm)

    def step(self, target: Matrix | None, measured: Matrix) -> FreeTorque:
        torque_nm = self._torques.step(target, measured)
        self.reflex = self._torques.reflex
        if self.reflex is None:
            self.torque_nm = torque_nm
        return FreeTorque(self.torque_nm)


def interface_for(kind: Kind, settings: InterfaceSettings, period_s: float) -> RobotInterface:
    """Return what moves the arm: with the given settings, or the usual ones of another kind."""
    if kind is Kind.TORQUE:
        given = settings if isinstance(settings, FrankaTorqueSettings) else FrankaTorqueSettings()
        return ExternalTorque(given.build(period_s))
    values = settings.model_dump() if isinstance(settings, FrankaMotionSettings) else {}
    chosen = FrankaVelocitySettings if kind is Kind.VELOCITY else FrankaMotionSettings
    return chosen(**values).build(period_s)


def rows_of(kind: Kind, target: Any) -> Matrix:
    """Return a record of `bus_schema.franka.states.TARGET` as an interface's target."""
    if kind is Kind.TORQUE:
        return np.array([target["tau_J_d"]])
    return np.array([target["q_c"], target["dq_c"]])
