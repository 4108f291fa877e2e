"""Section ``plant`` of a scenario: how the emulated arm differs from an ideal one."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from bus_schema.arrays import Vector
from bus_schema.configuration import (
    NonNegative,
    Number,
    PerJointNonNegative,
    PerJointPositive,
    Positive,
    StrictModel,
    Whole,
    expand,
)
from bus_schema.drive_feedback import DriveGains
from bus_schema.registry import NameIn
from plant_emulator.interfaces.configuration import InterfaceConfiguration


def _zero() -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.zeros(1)


class FrictionConfiguration(StrictModel):
    """Joint friction: (Coulomb + Stribeck excess) tanh(q̇ / smoothing velocity) + viscous q̇.

    Attributes:
        enabled: false for no friction.
        coulomb_nm: dry friction at speed.
        coulomb_share: further dry friction, as a share of the URDF's effort limit.
        load_share: further dry friction, as a share of the torque that the gear transmits.
        viscous_nm_s: friction per rad/s.
        viscous_share_s: further viscous friction, as a share of the effort limit per rad/s.
        stribeck_nm: dry friction beyond Coulomb's near standstill.
        stribeck_velocity_rad_s: speed over which that excess decays.
        smoothing_velocity_rad_s: speed over which dry friction changes its sign.
    """

    enabled: bool = True
    coulomb_nm: PerJointNonNegative = Field(default_factory=_zero)
    coulomb_share: PerJointNonNegative = Field(default_factory=_zero)
    load_share: PerJointNonNegative = Field(default_factory=_zero)
    viscous_nm_s: PerJointNonNegative = Field(default_factory=_zero)
    viscous_share_s: PerJointNonNegative = Field(default_factory=_zero)
    stribeck_nm: PerJointNonNegative = Field(default_factory=_zero)
    stribeck_velocity_rad_s: PerJointPositive = Field(default_factory=lambda: np.array([0.1]))
    smoothing_velocity_rad_s: PerJointPositive = Field(default_factory=lambda: np.array([0.01]))


class _Term(StrictModel):
    """Attributes: joint: name of the joint, or ``all``."""

    joint: str


class ConstantTerm(_Term):
    """A constant torque."""

    kind: Literal["constant"]
    torque_nm: Number


class SineTerm(_Term):
    """amplitude sin(frequency t + phase)."""

    kind: Literal["sine"]
    amplitude_nm: Number
    frequency_rad_s: Positive
    phase_rad: Number = 0.0


class StepTerm(_Term):
    """A constant torque that starts at a given time."""

    kind: Literal["step"]
    torque_nm: Number
    start_s: NonNegative


class PulseTerm(_Term):
    """A constant torque for a limited time.

    Attributes:
        duration_s: length of the pulse.
    """

    kind: Literal["pulse"]
    torque_nm: Number
    start_s: NonNegative
    duration_s: Positive


class NoiseTerm(_Term):
    """Noise of a given strength between two frequencies, drawn from the scenario's seed."""

    kind: Literal["noise"]
    rms_nm: NonNegative
    lowest_hz: Positive
    highest_hz: Positive


DisturbanceTerm = Annotated[
    ConstantTerm | SineTerm | StepTerm | PulseTerm | NoiseTerm, Field(discriminator="kind")
]


class DisturbanceConfiguration(StrictModel):
    """External torques that oppose the actuators: the sum of the terms.

    Attributes:
        scale: factor on the torques of all terms.
    """

    enabled: bool = True
    scale: NonNegative = 1.0
    terms: tuple[DisturbanceTerm, ...] = ()


class EncoderConfiguration(StrictModel):
    """Encoders that measure the joints for the controller.

    Attributes:
        resolution_rad: positions are whole multiples of this; 0 for exact positions.
        velocity_noise_rad_s: standard deviation of white noise on velocities.
    """

    resolution_rad: PerJointNonNegative = Field(default_factory=_zero)
    velocity_noise_rad_s: PerJointNonNegative = Field(default_factory=_zero)


ROTOR_INERTIA_S2_RAD = 0.008
"""Inertia of a geared rotor over the joint's largest torque, kg m² per N m, where it is unknown.

Our estimate; motors of the same torque differ by a factor of 3 and more.
"""


class ActuatorConfiguration(StrictModel):
    """The drive train between a commanded torque and the link: motor, gear and encoder.

    All values refer to the joint, on the output side of the gear. Rotor inertia, elastic gear and
    cogging need MuJoCo; Bullet has none of them.

    Attributes:
        saturation_nm: largest torque; by default the URDF's effort limits.
        delay_ms: dead time between a command's arrival and its effect, in whole physics steps; the
            drives' own loops do not have it. Delay compensation knows it. Not over CAN.
        lag_ms: time constant of the torque loop; 0 for none.
        current_loop_hz: bandwidth f of the torque loop, another way to write lag_ms = 1 / (2π f).
        rated_speed_rad_s: up to this speed the largest torque is available; by default half of
            no_load_speed_rad_s.
        no_load_speed_rad_s: above the rated speed the largest torque falls, to zero at this speed;
            no limit by default.
        rotor_inertia_kg_m2: inertia of the rotor times the gear ratio squared; 0 for none. The
            controller's nominal model includes it, see controller.rotor_scale.
        gear_stiffness_nm_rad: stiffness of the gear between rotor and link; rigid by default.
        gear_resonance_hz: alternative to the stiffness: first resonance of the arm at its start
            with the rotors held. The stiffness of each gear is then proportional to the joint's
            largest torque.
        gear_damping_nm_s: damping of an elastic gear.
        encoder_side: where positions and velocities are measured if the gear is elastic: at the
            ``motor``, as drives do, or at the ``link``; there no law can damp the oscillation
            between motor and link.
        cogging_nm: amplitude of the cogging torque, which pulls the rotor to its poles.
        cogging_periods: periods of that torque per turn of the joint.
    """

    saturation_nm: PerJointPositive | None = None
    delay_ms: Annotated[NonNegative, Field(le=1e3)] = 0.0
    lag_ms: NonNegative = 0.0
    current_loop_hz: Positive | None = None
    rated_speed_rad_s: PerJointNonNegative | None = None
    no_load_speed_rad_s: PerJointPositive | None = None
    rotor_inertia_kg_m2: PerJointNonNegative = Field(default_factory=_zero)
    gear_stiffness_nm_rad: PerJointPositive | None = None
    gear_resonance_hz: Positive | None = None
    gear_damping_nm_s: PerJointNonNegative = Field(default_factory=_zero)
    encoder_side: Literal["link", "motor"] = "motor"
    cogging_nm: PerJointNonNegative = Field(default_factory=_zero)
    cogging_periods: Positive = 100.0

    @model_validator(mode="after")
    def _check(self) -> ActuatorConfiguration:
        if self.current_loop_hz is not None and self.lag_ms:
            raise ValueError("with lag_ms or current_loop_hz, not both: they have the same meaning")
        if self.rated_speed_rad_s is not None and self.no_load_speed_rad_s is None:
            raise ValueError("with no_load_speed_rad_s if rated_speed_rad_s is given")
        has_stiffness, has_resonance = (
            each is not None for each in (self.gear_stiffness_nm_rad, self.gear_resonance_hz)
        )
        if has_stiffness and has_resonance:
            raise ValueError("with gear_stiffness_nm_rad or gear_resonance_hz, not both")
        if self.gear_damping_nm_s.any() and not (has_stiffness or has_resonance):
            raise ValueError("with gear_stiffness_nm_rad if gear_damping_nm_s is given")
        return self

    @property
    def lag_s(self) -> float:
        """Time constant of the torque loop, s; 0 for none."""
        if self.current_loop_hz is None:
            return self.lag_ms * 1e-3
        return 1.0 / (2.0 * math.pi * self.current_loop_hz)

    def delay_steps(self, substep_s: float) -> int:
        """Return the dead time in whole physics steps."""
        return round(1e-3 * self.delay_ms / substep_s)

    @property
    def has_rotors(self) -> bool:
        """Whether a feature is enabled that only an engine with rotors has."""
        return self.gear_stiffness_nm_rad is not None or bool(
            self.rotor_inertia_kg_m2.any() or self.cogging_nm.any()
        )

    def rotor_inertia(self, joints: int) -> Vector:
        """Return the inertia of each joint's rotor, shape (joints,), kg m².

        Raises:
            ConfigurationError: the number of values is neither 1 nor that of the joints.
        """
        return expand(self.rotor_inertia_kg_m2, joints, "plant.actuator.rotor_inertia_kg_m2")

    def rigid_rotor_inertia(self, joints: int) -> Vector | None:
        """Return rotor inertias behind rigid gears; None for elastic gears or no inertia."""
        is_rigid = self.gear_stiffness_nm_rad is None and self.rotor_inertia_kg_m2.any()
        return self.rotor_inertia(joints) if is_rigid else None


Integrator = Literal["semi_implicit_euler", "runge_kutta_4"]


class PhysicsConfiguration(StrictModel):
    """Physics engine of the rigid bodies.

    Attributes:
        engine: by default Bullet if it is installed, otherwise MuJoCo.
        integrator: the rule over a physics step; torques are evaluated at its start, with
            ``runge_kutta_4`` those of elastic gears and cogging in mid-step. MuJoCo has both.
    """

    engine: Annotated[str, NameIn("engines")] | None = None
    integrator: Integrator = "semi_implicit_euler"


class DriveLoopConfiguration(StrictModel):
    """A drive loop, closed at the motor drives around targets that are sent with the torques.

    Attributes:
        enabled: whether the drives accept targets; true with ``controller.drive_feedback.enabled``.
        stiffness_nm_rad: torque per rad of distance to the target; by default derived from the
            arm's inertia and ``controller.drive_feedback.bandwidth_rad_s``.
        damping_nm_s: torque per rad/s of difference in speed; likewise.
        encoder: the drives' own encoders.
    """

    enabled: bool = False
    stiffness_nm_rad: PerJointNonNegative | None = None
    damping_nm_s: PerJointNonNegative | None = None
    encoder: EncoderConfiguration = EncoderConfiguration()

    def gains(self, derived: DriveGains) -> DriveGains:
        """Return the gains given here; where none is given, the derived ones.

        Raises:
            ConfigurationError: the number of values is neither 1 nor that of the joints.
        """
        joints, key = derived.damping_nm_s.size, "plant.drive_feedback"
        if self.stiffness_nm_rad is not None:
            stiffness = expand(self.stiffness_nm_rad, joints, f"{key}.stiffness_nm_rad")
            derived = derived._replace(stiffness_nm_rad=stiffness)
        if self.damping_nm_s is not None:
            damping = expand(self.damping_nm_s, joints, f"{key}.damping_nm_s")
            derived = derived._replace(damping_nm_s=damping)
        return derived


class PlantConfiguration(StrictModel):
    """The emulated arm.

    Attributes:
        substeps: physics steps per tick.
        payload_kg: point mass at the tip that the nominal model does not include.
        payload_share: further payload, as a share of the heaviest mass that the arm holds in any
            posture, at most its own moved mass.
        command_timeout_ms: time without a valid command after which the arm is stopped; by default
            it survives an outage of 100 ms.
        safe_stop: how it is stopped: by the brakes, by damping torques, or by zero torque.
        stop_damping_nm_s: torque per rad/s of the ``damping`` stop.
        stop_duration_s: time that a run continues after a safe stop.
        gui: open the physics engine's window (Bullet has one).
    """

    substeps: Annotated[Whole, Field(ge=1, le=100)] = 4
    payload_kg: Annotated[NonNegative, Field(le=1e6)] = 0.0
    payload_share: Annotated[NonNegative, Field(le=1)] = 0.0
    command_timeout_ms: Positive = 200.0
    safe_stop: Literal["brake", "damping", "zero_torque"] = "brake"
    stop_damping_nm_s: PerJointPositive = Field(default_factory=lambda: np.array([20.0]))
    stop_duration_s: NonNegative = 0.5
    gui: bool = False
    physics: PhysicsConfiguration = PhysicsConfiguration()
    friction: FrictionConfiguration = FrictionConfiguration()
    disturbance: DisturbanceConfiguration = DisturbanceConfiguration()
    encoder: EncoderConfiguration = EncoderConfiguration()
    actuator: ActuatorConfiguration = ActuatorConfiguration()
    drive_feedback: DriveLoopConfiguration = DriveLoopConfiguration()
    interface: InterfaceConfiguration = InterfaceConfiguration()
