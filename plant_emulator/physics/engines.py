"""The table of physics engines.

A new engine is one class after `ArmPhysics`, one line here, and its name in
`PhysicsConfiguration.engine`. It is imported when a scenario uses it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module, metadata
from importlib.util import find_spec
from typing import cast

from bus_schema.configuration import ConfigurationError
from plant_emulator.configuration import Integrator, PlantConfiguration
from plant_emulator.physics.engine import ArmPhysics

_KEY = "plant.physics.engine"


@dataclass(frozen=True)
class PhysicsEngine:
    """A physics engine, installed or not.

    Attributes:
        title: its name in sentences.
        distribution: the Python package that brings it; the module is called the same.
        place: its arm, as ``module:class``.
        integrators: the rules by which it integrates motion.
        has_window: whether it can show the arm while it moves.
        has_rotors: whether it knows motors: their inertia, elastic gears and cogging.
    """

    title: str
    distribution: str
    place: str
    integrators: tuple[Integrator, ...]
    has_window: bool = False
    has_rotors: bool = False

    @property
    def is_installed(self) -> bool:
        """Whether this Python has the engine, which is not imported for that."""
        return find_spec(self.distribution) is not None

    @property
    def version(self) -> str:
        return _version(self.distribution)

    @property
    def arm_type(self) -> type[ArmPhysics]:
        """The class of its arms."""
        module, name = self.place.split(":")
        return cast("type[ArmPhysics]", getattr(import_module(module), name))


ENGINES = {
    "bullet": PhysicsEngine(
        "Bullet", "pybullet", "plant_emulator.physics.bullet.arm:BulletArm",
        ("semi_implicit_euler",), has_window=True,
    ),
    "mujoco": PhysicsEngine(
        "MuJoCo", "mujoco", "plant_emulator.physics.mujoco_arm:MujocoArm",
        ("semi_implicit_euler", "runge_kutta_4"), has_rotors=True,
    ),
}  # fmt: skip
DEFAULT_ENGINE = "bullet"


_version = lru_cache(metadata.version)  # which reads files


def engine_name(plant: PlantConfiguration) -> str:
    """Name of the engine in force.

    Where a scenario names none: Bullet if it is installed and has what the motors ask for.
    """
    default = ENGINES[DEFAULT_ENGINE]
    is_enough = default.is_installed and not plant.actuator.has_rotors
    return plant.physics.engine or (DEFAULT_ENGINE if is_enough else "mujoco")


def physics_text(plant: PlantConfiguration) -> str:
    """Engine and integrator in force."""
    return f"{ENGINES[engine_name(plant)].title}, {plant.physics.integrator}"


def physics_in_force(plant: PlantConfiguration) -> str:
    """The same with the engine's version, where it is installed."""
    engine = ENGINES[engine_name(plant)]
    version = f" {engine.version}" if engine.is_installed else ""
    return f"{engine.title}{version}, {plant.physics.integrator}"


def default_note(plant: PlantConfiguration) -> str:
    """That the engine is not the default one, where a scenario names none; else nothing."""
    default = ENGINES[DEFAULT_ENGINE]
    is_second_choice = plant.physics.engine is None and not default.is_installed
    return f" ({default.title} is not installed)" if is_second_choice else ""


def engine_in_force(plant: PlantConfiguration) -> PhysicsEngine:
    """The engine of a scenario's plant, installed and able to do what the scenario asks of it.

    Raises:
        ConfigurationError: it is not installed, or has no such integrator or no window.
    """
    name = engine_name(plant)
    engine, integrator = ENGINES[name], plant.physics.integrator
    if not engine.is_installed:
        installed = [other for other, each in ENGINES.items() if each.is_installed]
        allowed = (
            f"{engine.title} is not installed (pip install {engine.distribution}); installed:"
            f" {', '.join(installed) or 'no engine'}"
        )
        raise ConfigurationError(_KEY, name, allowed)
    if integrator not in engine.integrators:
        others = [key for key, each in ENGINES.items() if integrator in each.integrators]
        allowed = (
            f"must be {' or '.join(engine.integrators)} with {engine.title};"
            f" {_KEY}={' or '.join(others)} has it"
        )
        raise ConfigurationError("plant.physics.integrator", integrator, allowed, [_KEY])
    if plant.actuator.has_rotors and not engine.has_rotors:
        allowed = "must be mujoco, or left out, where plant.actuator has rotors, gears or cogging"
        raise ConfigurationError(_KEY, name, allowed, ["plant.actuator"])
    if plant.gui and not engine.has_window:
        raise ConfigurationError("plant.gui", True, f"{engine.title} has no window here", [_KEY])
    return engine
