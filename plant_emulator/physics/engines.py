"""The physics engines: classes that implement `ArmPhysics`, imported when a scenario uses them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from importlib import metadata
from importlib.util import find_spec
from pkgutil import resolve_name
from typing import cast

from bus_schema.configuration import ConfigurationError
from bus_schema.registry import Registry
from plant_emulator.configuration import Integrator, PlantConfiguration
from plant_emulator.physics.engine import ArmPhysics

_KEY = "plant.physics.engine"


@dataclass(frozen=True)
class PhysicsEngine:
    """A physics engine, installed or not.

    Attributes:
        title: its name in sentences.
        distribution: its Python package; the module has the same name.
        place: its class of arms, as ``module:class``.
        integrators: its rules of integration.
        extra: the extra of funnel-hil that installs it; empty for none.
        has_window: whether it can show the moving arm in a window.
        has_rotors: whether it models motors: their inertia, elastic gears and cogging.
    """

    title: str
    distribution: str
    place: str
    integrators: tuple[Integrator, ...]
    extra: str = ""
    has_window: bool = False
    has_rotors: bool = False

    @property
    def is_installed(self) -> bool:
        """Whether this Python has the engine; it is not imported for that."""
        return find_spec(self.distribution) is not None

    @property
    def installed_by(self) -> str:
        """The command that installs it."""
        package = f"'funnel-hil[{self.extra}]'" if self.extra else self.distribution
        return f"pip install {package}"

    @property
    def version(self) -> str:
        return _version(self.distribution)

    @property
    def arm_type(self) -> type[ArmPhysics]:
        """Class of its arms.

        Raises:
            ConfigurationError: it cannot be imported.
        """
        try:
            return cast("type[ArmPhysics]", resolve_name(self.place))
        except (ImportError, AttributeError) as error:
            allowed = f"{self.place} cannot be loaded: {type(error).__name__}: {error}"
            raise ConfigurationError(_KEY, self.title, allowed) from error


_SHIPPED = {
    "bullet": PhysicsEngine(
        "Bullet", "pybullet", "plant_emulator.physics.bullet.arm:BulletArm",
        ("semi_implicit_euler",), extra="bullet", has_window=True,
    ),
    "mujoco": PhysicsEngine(
        "MuJoCo", "mujoco", "plant_emulator.physics.mujoco_arm:MujocoArm",
        ("semi_implicit_euler", "runge_kutta_4"), has_rotors=True,
    ),
}  # fmt: skip
ENGINES: Registry[PhysicsEngine] = Registry("engines", _KEY, PhysicsEngine, _SHIPPED)
DEFAULT_ENGINE = "bullet"


_version = lru_cache(metadata.version)  # reads files


def engine_name(plant: PlantConfiguration) -> str:
    """Return the name of the engine in force.

    If a scenario names none: Bullet, if it is installed and has the features that the motors need.
    """
    default = ENGINES[DEFAULT_ENGINE]
    is_enough = default.is_installed and not plant.actuator.has_rotors
    return plant.physics.engine or (DEFAULT_ENGINE if is_enough else "mujoco")


def physics_text(plant: PlantConfiguration) -> str:
    """Describe engine and integrator in force."""
    return f"{ENGINES[engine_name(plant)].title}, {plant.physics.integrator}"


def physics_in_force(plant: PlantConfiguration) -> str:
    """Describe them with the engine's version, if it is installed."""
    engine = ENGINES[engine_name(plant)]
    version = f" {engine.version}" if engine.is_installed else ""
    return f"{engine.title}{version}, {plant.physics.integrator}"


def default_note(plant: PlantConfiguration) -> str:
    """Return a note if the default engine is not installed, and a scenario names none."""
    default = ENGINES[DEFAULT_ENGINE]
    is_second_choice = plant.physics.engine is None and not default.is_installed
    return f" ({default.title} is not installed)" if is_second_choice else ""


def engine_in_force(plant: PlantConfiguration) -> PhysicsEngine:
    """Return the engine of a scenario's plant, installed and able to run the scenario.

    Raises:
        ConfigurationError: it is not installed, or lacks the integrator or a window.
    """
    name = engine_name(plant)
    engine, integrator = ENGINES[name], plant.physics.integrator
    if not engine.is_installed:
        installed = [other for other, each in ENGINES.usable().items() if each.is_installed]
        allowed = (
            f"{engine.title} is not installed ({engine.installed_by}); installed:"
            f" {', '.join(installed) or 'no engine'}"
        )
        raise ConfigurationError(_KEY, name, allowed)
    if integrator not in engine.integrators:
        engines = ENGINES.usable().items()
        others = [key for key, each in engines if integrator in each.integrators]
        allowed = (
            f"must be {' or '.join(engine.integrators)} with {engine.title};"
            f" {_KEY}={' or '.join(others)} has it"
        )
        raise ConfigurationError("plant.physics.integrator", integrator, allowed, [_KEY])
    if plant.actuator.has_rotors and not engine.has_rotors:
        allowed = (
            "must be mujoco, or left out, if plant.actuator has rotors, elastic gears or cogging"
        )
        raise ConfigurationError(_KEY, name, allowed, ["plant.actuator"])
    if plant.gui and not engine.has_window:
        raise ConfigurationError(
            "plant.gui", True, f"{engine.title} has no window in funnel-hil", [_KEY]
        )
    return engine
