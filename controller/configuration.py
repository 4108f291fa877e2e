"""Section ``controller`` of a scenario, and the controller's parts built from it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

from bus_schema.arrays import Vector
from bus_schema.configuration import (
    ConfigurationError,
    NonNegative,
    Number,
    PerJointPositive,
    Positive,
    StrictModel,
    Whole,
    expand,
    expand_fields,
)
from bus_schema.drive_feedback import DriveGains
from bus_schema.registry import NameIn
from bus_schema.robot_description import RobotDescription
from controller.chunks.answer import NEAR, BetweenAnswers, Holding
from controller.chunks.configuration import ChunksConfiguration
from controller.compensation.arm_belief import nominal_arm
from controller.compensation.command_timeline import HorizonSettings
from controller.compensation.configuration import (
    DelayCompensationConfiguration,
    DriveFeedbackConfiguration,
)
from controller.compensation.delay_compensation import (
    COMMUNICATION_DISTURBANCE_OBSERVER,
    DelayCompensation,
)
from controller.compensation.model_identification import identification
from controller.control_law import ControlLaw
from controller.external.external_law import (
    ExternalLaw,
    ExternalLawConfiguration,
    ExternalTargetLaw,
)
from controller.law_choice import PROCESS, GainsByLaw, Word, is_law_name, program_name
from controller.laws import LAWS, likely_law
from controller.laws.custom import EXTERNAL, LeftOut, are_left_out, build_custom, is_custom
from controller.laws.settling import LargestInertia
from controller.manipulator_model import ManipulatorModel
from controller.policies.configuration import PolicyServerConfiguration, is_address
from controller.policies.served_law import ServedLaw
from controller.policies.served_policy import ServedPolicy
from controller.slow_law import AnswerTiming, ChunkRules, SlowLaw

USUAL_ANSWER_TIMEOUT_S = 60.0


class ControllerConfiguration(StrictModel):
    """The controller.

    Attributes:
        law: name of the control law, ``module:Class`` for your own law, ``external`` for a law
            in a program, or the address of a policy server, ``lerobot://host:port`` or
            ``openpi://host:port``; ``process`` if a process is given.
        process: your own controller on the bus instead of a law: a program and its arguments,
            started in the current folder, without a shell.
        gains: gains by law. A law without an entry derives its gains from the arm's nominal
            inertia.
        external: the program of law ``external``.
        policy_server: what the client of a policy server sends, and how long it waits.
        model: URDF or MJCF file with the masses of the nominal model, for the same joints; by
            default those of the arm.
        model_scale: factor on masses and inertias of the nominal model, including rotors.
        rotor_scale: further factor on the rotor inertias of the nominal model.
        torque_rate_limit_nm_s: largest change of a torque per second; none by default.
        every: the law runs at every n-th state; the torque is held in between. In lockstep, the
            plant waits for a process only at these states.
        inference_ms: time that the law takes for an answer, while the loop continues.
        inference_jitter_ms: random change of that time, uniform within ± this
            value, drawn from the seed.
        first_inference_ms: the same for the first question while the arm moves, which many policies
            answer more slowly; by default like the others. The answer that releases the arm acts at
            once.
        answer_timeout_s: longest wall time in which a custom law that is slower than the loop must
            answer, or the run stops; null for any.
        between_answers: targets for the drives until the next row of an answer: ``hold`` them, or
            ``linear``: continue at their velocity.
        chunks: how a law is asked whose answers are chunks of actions, and how a new chunk takes
            over; by default, the law is always asked again and a new chunk takes over at once.
        preview_ms: how far ahead laws for positions and velocities read the reference: ``auto`` for
            the round trip and the lag of the robot's own controller.
        clock_ppm: how much faster the control loop's clock runs than the run's, against which the
            robot's own has ``plant.interface.clock_ppm``.
    """

    law: Annotated[str, NameIn("laws")] = "fixed_time_adaptive"
    process: Annotated[tuple[Word, ...] | None, Field(min_length=1, validate_default=True)] = None
    gains: GainsByLaw = Field(default_factory=dict, validate_default=True)
    external: ExternalLawConfiguration | None = None
    policy_server: PolicyServerConfiguration = PolicyServerConfiguration()
    model: str | None = None
    model_scale: Annotated[Number, Field(ge=1e-6, le=1e6)] = 1.0
    rotor_scale: NonNegative = 1.0
    torque_rate_limit_nm_s: PerJointPositive | None = None
    every: Annotated[Whole, Field(ge=1, le=10_000)] = 1
    inference_ms: Annotated[NonNegative, Field(le=10_000)] = 0.0
    inference_jitter_ms: Annotated[NonNegative, Field(le=10_000)] = 0.0
    first_inference_ms: Annotated[NonNegative, Field(le=10_000)] | None = None
    answer_timeout_s: Positive | None = USUAL_ANSWER_TIMEOUT_S
    between_answers: BetweenAnswers = "hold"
    chunks: ChunksConfiguration | None = None
    preview_ms: Annotated[NonNegative, Field(le=10_000)] | Literal["auto"] = "auto"
    clock_ppm: Annotated[Number, Field(ge=-1e4, le=1e4)] = 0.0
    delay_compensation: DelayCompensationConfiguration = DelayCompensationConfiguration()
    drive_feedback: DriveFeedbackConfiguration = DriveFeedbackConfiguration()

    @model_validator(mode="before")
    @classmethod
    def _process_has_no_law(cls, given: Any) -> Any:
        if isinstance(given, dict) and given.get("process") is not None:
            return {**given, "law": PROCESS}
        return given

    @field_validator("law")
    @classmethod
    def _known(cls, law: str) -> str:
        if not is_law_name(law):
            raise ValueError(
                f"one of {', '.join(LAWS)}, module:Class for your own law, {EXTERNAL} for your"
                " own program, or a policy server as lerobot://host:port or openpi://host:port"
                f"{likely_law(law)}"
            )
        return law

    @model_validator(mode="after")
    def _has_a_program(self) -> ControllerConfiguration:
        if self.law == EXTERNAL and self.external is None:
            raise ValueError(
                f"law {EXTERNAL} needs external.command, the program and its arguments"
            )
        return self

    @field_validator("process")
    @classmethod
    def _is_there(cls, process: Any, info: ValidationInfo) -> Any:
        if process is None and info.data.get("law") == PROCESS:
            raise ValueError(f"a program and its arguments if controller.law is {PROCESS}")
        return process

    @model_validator(mode="after")
    def _predictor_serves(self) -> ControllerConfiguration:
        settings = self.delay_compensation
        is_network = settings.predictor == COMMUNICATION_DISTURBANCE_OBSERVER
        if settings.enabled and is_network and self.drive_feedback.enabled:
            raise ValueError(
                f"delay_compensation.predictor must not be {settings.predictor} while"
                " drive_feedback.enabled is true: it does not see the torques of the drive loops"
            )
        return self

    @field_validator(
        "torque_rate_limit_nm_s",
        "delay_compensation",
        "inference_ms",
        "inference_jitter_ms",
        "first_inference_ms",
    )
    @classmethod
    def _takes_effect(cls, value: Any, info: ValidationInfo) -> Any:
        is_default = value == cls.model_fields[str(info.field_name)].default
        is_off = is_default or not getattr(value, "enabled", True)
        if not is_off and info.data.get("law") == PROCESS:
            raise ValueError("left out or off: it does not apply to controller.process")
        return value

    @property
    def _rows(self) -> int:
        """Rows of an answer, as far as the scenario says; a law in Python may answer with more."""
        return self.external.rows if self.law == EXTERNAL and self.external is not None else 1

    @property
    def name(self) -> str:
        """Name of the controller: the law, or the program of the process."""
        return self.law if self.process is None else f"{PROCESS}: {program_name(self.process)}"

    def build_gains(self, robot: RobotDescription, inertia_kg_m2: Vector) -> Any:
        """Return the gains of the configured law, expanded to the robot's joints.

        Args:
            robot: the arm.
            inertia_kg_m2: nominal inertia that governs each joint, shape (joints,); sizes the gains
                that the scenario does not give.

        Raises:
            ConfigurationError: the number of a gain's values does not fit the arm, or the law
                cannot be loaded.
        """
        if self.law in (EXTERNAL, PROCESS) or is_address(self.law):
            return {}
        if self.law not in LAWS:
            return self.gains["custom"]
        entry, gains = LAWS[self.law], self.gains.get(self.law)
        if gains is None:
            gains = entry.gains.from_inertia(inertia_kg_m2)
        return expand_fields(gains, robot.joints, f"controller.gains.{self.law}")

    def build_law(
        self, gains: Any, robot: RobotDescription, rotors_kg_m2: Vector | None = None
    ) -> ControlLaw:
        """Return the configured law with gains from `build_gains`; rotors as for `nominal_model`.

        Raises:
            ConfigurationError: a user's law cannot be created, or the controller is a process.
        """
        if self.law == PROCESS:
            allowed = "must be the name of a law: only `run` and studies start a process"
            raise ConfigurationError("controller.law", self.law, allowed)
        if self.law == EXTERNAL:
            if are_left_out():
                return LeftOut(robot.joints)
            assert self.external is not None  # ensured by a validator
            law_type = ExternalTargetLaw if self.external.targets else ExternalLaw
            return law_type(self.external, robot.effort_limits_nm)
        if is_address(self.law):
            return self._served_policy(robot.joint_names)
        model = self.nominal_model(robot, rotors_kg_m2)
        if self.law not in LAWS:
            return build_custom(self.law, gains, model)
        return LAWS[self.law].build(gains, model, robot.effort_limits_nm)

    def _served_policy(self, joint_names: Sequence[str]) -> ControlLaw:
        if are_left_out():
            return LeftOut(len(joint_names))
        chunks = self.chunks
        if chunks is None or chunks.horizon is None or chunks.period_ms is None:
            given = None if chunks is None else chunks.model_dump(exclude_unset=True)
            allowed = (
                "must have horizon, the actions of an answer, and period_ms, the time between two"
                " of them, with a policy server"
            )
            raise ConfigurationError("controller.chunks", given, allowed, ["controller.law"])
        return ServedPolicy(
            self.law, self.policy_server, joint_names, chunks.horizon, 1e-3 * chunks.period_ms
        )

    def nominal_model(
        self,
        robot: RobotDescription,
        rotors_kg_m2: Vector | None = None,
        *,
        payload_kg: float = 0.0,
    ) -> ManipulatorModel:
        """Return the controller's nominal model of the arm.

        Args:
            robot: the arm.
            rotors_kg_m2: true inertia of each joint's rotor, shape (joints,); None for no rotors.
            payload_kg: point mass at the tip.
        """
        if rotors_kg_m2 is not None:
            rotors_kg_m2 = self.model_scale * self.rotor_scale * rotors_kg_m2
        return ManipulatorModel(
            robot,
            scale=self.model_scale,
            payload_kg=payload_kg,
            rotor_inertia_kg_m2=rotors_kg_m2,
        )

    def build_compensation(
        self,
        robot: RobotDescription,
        inertia_kg_m2: Vector,
        drive: DriveGains,
        horizon: HorizonSettings,
        rotors_kg_m2: Vector | None = None,
    ) -> DelayCompensation | None:
        """Return the configured delay compensation; None if it is disabled.

        Args:
            robot: the arm.
            inertia_kg_m2: nominal inertia that governs each joint, shape (joints,).
            drive: gains of the drives' own loops.
            horizon: how the time from a state until its torque acts is chosen.
            rotors_kg_m2: as for `nominal_model`.
        """
        settings = self.delay_compensation
        if not settings.enabled:
            return None
        nominal = self.nominal_model(robot, rotors_kg_m2)
        loaded = self.nominal_model(robot, rotors_kg_m2, payload_kg=1.0)
        return DelayCompensation(
            nominal_arm(nominal, loaded, robot.effort_limits_nm),
            identification(
                inertia_kg_m2,
                robot.effort_limits_nm,
                model=settings.learns_model,
                friction=settings.learns_friction,
                rotors=rotors_kg_m2 is not None and bool(rotors_kg_m2.any()),
            ),
            drive,
            observer_bandwidth_rad_s=settings.observer_bandwidth_rad_s,
            horizon=horizon,
            predictor=settings.predictor,
        )

    def paced(
        self, law: ControlLaw, period_s: float, seed: int, takes: str, velocities_rad_s: Vector
    ) -> ControlLaw:
        """The law as often as it is to be asked.

        Args:
            law: the configured law.
            period_s: of the control loop.
            seed: of the scenario.
            takes: what the robot takes of the law's answers: ``torque``, ``position`` or
                ``velocity``.
            velocities_rad_s: largest speeds of the joints, shape (joints,).

        Raises:
            ConfigurationError: ``between_answers`` would have no effect, or a merge of chunks
                cannot work.
        """
        inference_s, jitter_s = 1e-3 * self.inference_ms, 1e-3 * self.inference_jitter_ms
        first_s = inference_s if self.first_inference_ms is None else 1e-3 * self.first_inference_ms
        is_slow = self.chunks is not None or self.every > 1 or self._rows > 1
        is_slow = is_slow or max(inference_s, jitter_s, first_s) > 0.0
        between = self.between_answers
        sends_targets = self.drive_feedback.enabled or takes != "torque"
        if between != "hold" and not (is_slow and sends_targets):
            allowed = (
                "must be hold, unless controller.drive_feedback.enabled is true or a robot takes"
                " the law's targets, and one of controller.every and controller.external.rows above"
                " 1, controller.inference_ms above 0 or controller.chunks"
            )
            raise ConfigurationError("controller.between_answers", between, allowed)
        limit_s = self.answer_timeout_s if is_custom(self.law) and is_slow else None
        if limit_s is None and self.answer_timeout_s not in (None, USUAL_ANSWER_TIMEOUT_S):
            allowed = (
                "must be left out, unless a custom law is slower than the loop, as with chunks"
            )
            key = "controller.answer_timeout_s"
            raise ConfigurationError(key, self.answer_timeout_s, allowed, ["controller.law"])
        if not is_slow:
            return law
        holding = Holding(between, keeps_velocity=takes == "velocity")
        timing = AnswerTiming(
            self.every, inference_s, jitter_s, holding, period_s, seed, first_s,
            limit_s,
        )  # fmt: skip
        chunks = self.chunks
        if chunks is None:
            return SlowLaw(law, timing)
        merge = chunks.build(period_s, max(first_s, inference_s + jitter_s), velocities_rad_s)
        rules = ChunkRules(
            merge, chunks.action_period_s(period_s), chunks.horizon, chunks.share_left,
            chunks.ask_every, chunks.align,
        )  # fmt: skip
        if isinstance(law, ServedPolicy):
            return ServedLaw(law, timing, rules)
        return SlowLaw(law, timing, rules)

    def answer_age_s(self, period_s: float) -> float:
        """Return the mean age of an answer of one row in force.

        Args:
            period_s: of the control loop.
        """
        inference_s = 1e-3 * self.inference_ms
        between = self.every * max(1, math.ceil(inference_s / (self.every * period_s) - NEAR))
        return inference_s + 0.5 * (between - 1) * period_s

    @property
    def knows_inference_time(self) -> bool:
        """Whether answers act after the configured time, not after the one a server took."""
        return not is_address(self.law) or self.policy_server.inference == "configured"

    def largest_answer_age_s(self, period_s: float) -> float | None:
        """Return d + s, the largest age of the observation behind an answer in force.

        d is the longest inference time, s the time from one question to the next, which is at least
        d, as one question at a time is open. None for chunks whose horizon the law chooses, and for
        measured inference times.

        Args:
            period_s: of the control loop.
        """
        longest_ms = max(self.inference_ms + self.inference_jitter_ms, self.first_inference_ms or 0)
        delay_s, states_s = 1e-3 * longest_ms, self.every * period_s
        between_s = 0.0 if self.chunks is None else self.chunks.between_questions_s(period_s)
        if between_s is None or not self.knows_inference_time:
            return None
        if self.chunks is not None and self.chunks.acts_on_arrival:
            between_s += delay_s
        states = math.ceil(max(between_s, delay_s) / states_s - NEAR)
        return delay_s + max(1, states) * states_s

    def settling_bound_s(self, gains: Any, largest_inertia: LargestInertia) -> float | None:
        """Return the bound on the law's settling time, s; None for a law without one."""
        bound = LAWS[self.law].settling_bound_s if self.law in LAWS else None
        value = bound(gains, largest_inertia) if bound is not None else math.inf
        return value if math.isfinite(value) else None

    def torque_rate_limits(self, joints: int) -> Vector:
        """Return the torque rate limit per joint, N m/s; inf for none."""
        if self.torque_rate_limit_nm_s is None:
            return np.full(joints, np.inf)
        key = "controller.torque_rate_limit_nm_s"
        return expand(self.torque_rate_limit_nm_s, joints, key)
