"""Rigid-body dynamics of an arm for compiled code."""

from controller.rigid_bodies.dynamics import RigidBodies, inverse_dynamics, mass_and_load
from controller.rigid_bodies.vectors import invert

__all__ = ["RigidBodies", "inverse_dynamics", "invert", "mass_and_load"]
