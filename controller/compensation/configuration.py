"""Sections ``controller.delay_compensation`` and ``controller.drive_feedback`` of a scenario."""

from __future__ import annotations

from typing import Annotated, Literal, cast

from pydantic import BeforeValidator, Field

from bus_schema.configuration import NonNegative, Positive, StrictModel
from bus_schema.registry import KnownNameIn
from controller.compensation.command_timeline import LONGEST_HORIZON_NS
from controller.compensation.delay_compensation import ADAPTIVE

LONGEST_HORIZON_MS = 1e-6 * LONGEST_HORIZON_NS
LONGEST_BRIDGE_MS = 1000.0
"""Longest time for which a command may bridge the loss of later ones."""


def _check_bridge(value: object) -> object:
    # A union of types would report each of its parts, by names that no scenario has.
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if value != "auto" and not (is_number and 0.0 <= cast(float, value) <= LONGEST_BRIDGE_MS):
        raise ValueError(f"a number of ms from 0 to {LONGEST_BRIDGE_MS:g}, or auto")
    return value


class DelayCompensationConfiguration(StrictModel):
    """Prediction of the state in which a command will act, for any law.

    Attributes:
        enabled: whether the law sees the predicted state instead of the measured one.
        predictor: ``adaptive``, or a rival that learns nothing of the arm's model: ``smith``,
            ``communication_disturbance_observer`` or ``hold_prediction``.
        observer_bandwidth_rad_s: bandwidth of the observer for model errors and disturbances, or of
            a rival's filter; ``hold_prediction`` has none.
        learn_friction: whether Coulomb friction is identified too (``adaptive`` only).
        identify_model: whether inertia, payload, viscous friction and actuator lag are identified
            while the arm moves (``adaptive`` only).
        expected_round_trip_ms: round trip to assume until the first command is in force; by default
            what the sections of both directions say. An automatic play-out is this long from the
            start, and never shorter.
        bridge_ms: each command also holds predicted torques for this time after it acts; they act
            while later commands are lost. Needs an automatic play-out. ``auto``: 200, but at most
            ``plant.command_timeout_ms``, where commands may come too late (``adaptive`` only).
    """

    enabled: bool = False
    predictor: Annotated[str, KnownNameIn("predictors")] = ADAPTIVE
    observer_bandwidth_rad_s: Positive = 60.0
    learn_friction: bool = True
    identify_model: bool = True
    expected_round_trip_ms: Annotated[NonNegative, Field(le=LONGEST_HORIZON_MS)] | None = None
    bridge_ms: Annotated[float | Literal["auto"], BeforeValidator(_check_bridge)] = "auto"

    @property
    def learns_model(self) -> bool:
        """Whether anything of the arm's model is identified while it moves."""
        return self.predictor == ADAPTIVE and self.identify_model

    @property
    def learns_friction(self) -> bool:
        """Whether Coulomb friction is identified while the arm moves."""
        return self.predictor == ADAPTIVE and self.learn_friction


class DriveFeedbackConfiguration(StrictModel):
    """Targets for drives that close their own loop; for any law.

    Attributes:
        enabled: whether commands contain targets and torques, and the emulated drives use both.
        bandwidth_rad_s: bandwidth ω of the drive loop; stiffness is I ω², damping 2 I ω, with the
            joint's inertia I.
    """

    enabled: bool = False
    bandwidth_rad_s: Positive = 100.0
