"""A physics engine without an arm: each joint turns a flywheel of 1 kg m²."""

from __future__ import annotations

from plant_emulator.physics.engines import PhysicsEngine

FLYWHEELS = PhysicsEngine(
    title="Flywheels",
    distribution="funnel_hil_example",
    place="funnel_hil_example.flywheels:Flywheels",
    integrators=("semi_implicit_euler",),
)
