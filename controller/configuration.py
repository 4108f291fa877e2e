"""Sections ``controller``, ``funnel`` and ``reference`` of a scenario, and what they build."""

from __future__ import annotations

import itertools
import math
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator

from bus_schema.arrays import Matrix, Vector
from bus_schema.configuration import (
    ConfigurationError,
    NonNegative,
    PerJoint,
    PerJointPositive,
    Positive,
    StrictModel,
    expand,
    expand_fields,
)
from bus_schema.robot_description import RobotDescription
from controller.compensation.delay_compensation import DelayCompensation
from controller.control_law import ControlLaw
from controller.funnel import Funnel
from controller.laws import LAWS
from controller.laws.custom import build_custom, is_custom
from controller.laws.fixed_time_model_based import FixedTimeModelBasedGains
from controller.laws.fixed_time_neural import FixedTimeNeuralGains
from controller.laws.ftsmc import FtsmcGains
from controller.laws.pid import PidGains
from controller.laws.settling import LargestInertia
from controller.laws.smc import SmcGains
from controller.laws.tsmc import TsmcGains
from controller.manipulator_model import ManipulatorModel
from controller.reference import CartesianPath, JointSinusoids, MinimumJerk, Reference


class FunnelConfiguration(StrictModel):
    """The prescribed performance: how wide the funnel starts, how fast and how far it closes.

    The funnel opens to ``convergence_scale × |e(0)| + convergence_margin_rad`` on the side of the
    initial error e(0) and to ``overshoot_scale × |e(0)| + overshoot_margin_rad`` on the other, but
    never beyond ``widest_rad``; both sides close to ``final_rad`` at ``rate_per_s``.
    """

    convergence_scale: NonNegative = 1.2
    convergence_margin_rad: NonNegative = 0.05
    overshoot_scale: NonNegative = 0.4
    overshoot_margin_rad: NonNegative = 0.03
    widest_rad: Positive = 1.5
    final_rad: PerJointPositive = Field(default_factory=lambda: np.array([0.01]))
    rate_per_s: Positive = 4.0

    def build(self, initial_error_rad: Vector) -> Funnel:
        """The funnel for an initial error, shape (joints,).

        Raises:
            ConfigurationError: the initial error is outside, or a side would have to widen.
        """
        joints = initial_error_rad.size
        final = expand(self.final_rad, joints, "funnel.final_rad")
        size = np.abs(initial_error_rad)
        near = self.convergence_scale * size + self.convergence_margin_rad
        far = self.overshoot_scale * size + self.overshoot_margin_rad
        near, far = np.minimum(near, self.widest_rad), np.minimum(far, self.widest_rad)
        if np.any(size >= near):
            joint = int(np.argmax(size - near))
            raise ConfigurationError(
                "robot.initial_offset_rad",
                initial_error_rad.tolist(),
                f"the initial error of joint {joint + 1} must lie inside the funnel, which opens"
                f" to {near[joint]:.4g} rad there",
            )
        if np.any(far < final) or np.any(near < final):
            raise ConfigurationError(
                "funnel.final_rad", final.tolist(), "must not exceed the bounds at time zero"
            )
        above = initial_error_rad >= 0.0
        return Funnel(
            np.where(above, near, far), np.where(above, far, near), final, self.rate_per_s
        )


class AxisConfiguration(StrictModel):
    """One Cartesian axis: offset + velocity t + amplitude sin(frequency t + phase)."""

    offset_m: float
    velocity_m_s: float = 0.0
    amplitude_m: float = 0.0
    frequency_rad_s: float = 0.0
    phase_rad: float = 0.0


class CartesianPathConfiguration(StrictModel):
    """A path of the tool of a yaw-pitch-pitch arm in the base frame."""

    kind: Literal["cartesian_path"]
    x: AxisConfiguration
    y: AxisConfiguration
    z: AxisConfiguration

    def build(self, robot: RobotDescription) -> Reference:
        axes = np.array([list(axis.model_dump().values()) for axis in (self.x, self.y, self.z)])
        return CartesianPath(axes, *ManipulatorModel(robot).yaw_pitch_pitch_lengths())


class SinusoidConfiguration(StrictModel):
    """One sinusoid for every joint."""

    amplitude_rad: PerJoint
    frequency_rad_s: PerJoint
    phase_rad: PerJoint = Field(default_factory=lambda: np.zeros(1))


class JointSinusoidsConfiguration(StrictModel):
    """A sum of sinusoids about a centre, for any arm."""

    kind: Literal["joint_sinusoids"]
    centre_rad: PerJoint
    terms: Annotated[list[SinusoidConfiguration], Field(min_length=1)]

    def build(self, robot: RobotDescription) -> Reference:
        def column(index: int, name: str) -> Vector:
            key = f"reference.terms.{index}.{name}"
            return expand(getattr(self.terms[index], name), robot.joints, key)

        names = ("amplitude_rad", "frequency_rad_s", "phase_rad")
        terms = [
            np.stack([column(index, name) for name in names], axis=-1)
            for index in range(len(self.terms))
        ]
        centre = expand(self.centre_rad, robot.joints, "reference.centre_rad")
        return JointSinusoids(centre, np.array(terms))


class WaypointConfiguration(StrictModel):
    """Where the arm rests at a time."""

    time_s: NonNegative
    position_rad: PerJoint


class MinimumJerkConfiguration(StrictModel):
    """Rest-to-rest moves through waypoints, for any arm."""

    kind: Literal["minimum_jerk"]
    waypoints: Annotated[list[WaypointConfiguration], Field(min_length=1)]

    @field_validator("waypoints")
    @classmethod
    def _in_order(cls, waypoints: list[WaypointConfiguration]) -> list[WaypointConfiguration]:
        times = [waypoint.time_s for waypoint in waypoints]
        if any(b <= a for a, b in itertools.pairwise(times)):
            raise ValueError("waypoints with increasing time_s")
        return waypoints

    def build(self, robot: RobotDescription) -> Reference:
        positions = [
            expand(waypoint.position_rad, robot.joints, f"reference.waypoints.{i}.position_rad")
            for i, waypoint in enumerate(self.waypoints)
        ]
        times = np.array([waypoint.time_s for waypoint in self.waypoints])
        return MinimumJerk(times, np.array(positions))


ReferenceConfiguration = Annotated[
    CartesianPathConfiguration | JointSinusoidsConfiguration | MinimumJerkConfiguration,
    Field(discriminator="kind"),
]


class GainsConfiguration(StrictModel):
    """Gains by law. A law without an entry derives its gains from the arm's nominal inertia.

    Attributes:
        custom: keyword arguments for a law of the user's own.
    """

    fixed_time_neural: FixedTimeNeuralGains | None = None
    fixed_time_model_based: FixedTimeModelBasedGains | None = None
    pid: PidGains | None = None
    smc: SmcGains | None = None
    tsmc: TsmcGains | None = None
    ftsmc: FtsmcGains | None = None
    custom: dict[str, Any] = Field(default_factory=dict)


class DelayCompensationConfiguration(StrictModel):
    """Prediction of the state in which a command will act, for any law.

    Attributes:
        enabled: whether the law sees the predicted state instead of the measured one.
        observer_bandwidth_rad_s: how fast disturbances are learned that the nominal model misses.
        learn_friction: whether Coulomb friction is told apart from other disturbances.
    """

    enabled: bool = False
    observer_bandwidth_rad_s: Positive = 60.0
    learn_friction: bool = True


class ControllerConfiguration(StrictModel):
    """The controller.

    Attributes:
        law: name of the control law, or ``module:Class`` for one of the user's own.
        gains: gains by law.
        model_scale: factor on the masses and inertias of the nominal model.
        torque_rate_limit_nm_s: largest change of a torque per second; none by default.
    """

    law: str = "fixed_time_neural"
    gains: GainsConfiguration = GainsConfiguration()
    model_scale: Positive = 1.0
    torque_rate_limit_nm_s: PerJointPositive | None = None
    delay_compensation: DelayCompensationConfiguration = DelayCompensationConfiguration()

    @field_validator("law")
    @classmethod
    def _known(cls, law: str) -> str:
        if law not in LAWS and not is_custom(law):
            raise ValueError(f"one of {', '.join(LAWS)}, or module:Class for a law of your own")
        return law

    def build_gains(self, robot: RobotDescription, positions_rad: Matrix) -> Any:
        """The gains of the configured law, expanded to the robot's joints.

        Args:
            robot: the arm.
            positions_rad: joint positions on the planned motion, shape (samples, joints), by whose
                inertia gains are sized that the scenario does not give.
        """
        if self.law not in LAWS:
            return self.gains.custom
        gains = getattr(self.gains, self.law)
        if gains is None:
            model = self.nominal_model(robot)
            gains = LAWS[self.law].gains.from_inertia(model.governing_inertia(positions_rad))
        return expand_fields(gains, robot.joints, f"controller.gains.{self.law}")

    def build_law(self, gains: Any, robot: RobotDescription) -> ControlLaw:
        """The configured law with gains from `build_gains`.

        Raises:
            ConfigurationError: a law of the user's own cannot be made.
        """
        model = self.nominal_model(robot)
        if self.law not in LAWS:
            return build_custom(self.law, gains, model)
        return LAWS[self.law].build(gains, model, robot.effort_limits_nm)

    def nominal_model(self, robot: RobotDescription) -> ManipulatorModel:
        """What the controller believes about the arm."""
        return ManipulatorModel(robot, scale=self.model_scale)

    def build_compensation(
        self, robot: RobotDescription, least_horizon_ms: float
    ) -> DelayCompensation | None:
        """The configured delay compensation; None for none.

        Args:
            robot: the arm.
            least_horizon_ms: no torque acts sooner than this after the state it answers.
        """
        settings = self.delay_compensation
        if not settings.enabled:
            return None
        return DelayCompensation(
            self.nominal_model(robot),
            observer_bandwidth_rad_s=settings.observer_bandwidth_rad_s,
            learn_friction=settings.learn_friction,
            least_horizon_ns=round(least_horizon_ms * 1e6),
        )

    def settling_bound_s(self, gains: Any, largest_inertia: LargestInertia) -> float | None:
        """Bound on the law's settling time, s; None for a law that has none."""
        bound = LAWS[self.law].settling_bound_s if self.law in LAWS else None
        value = bound(gains, largest_inertia) if bound is not None else math.inf
        return value if math.isfinite(value) else None

    def torque_rate_limits(self, joints: int) -> Vector:
        """Torque rate limit per joint, N m/s; inf for none."""
        if self.torque_rate_limit_nm_s is None:
            return np.full(joints, np.inf)
        key = "controller.torque_rate_limit_nm_s"
        return expand(self.torque_rate_limit_nm_s, joints, key)
