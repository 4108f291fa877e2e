"""The schema of a scenario file."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from bus_schema.configuration import NonNegative, Number, PerJoint, StrictModel, Whole
from bus_schema.limits import LimitsConfiguration
from bus_schema.link.configuration import LinkConfiguration
from controller.configuration import ControllerConfiguration
from controller.funnel import FunnelConfiguration
from controller.reference_configuration import ReferenceConfiguration
from deploy.scenario.uncertainty import Uncertainty
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.faults.kinds import ScheduledFault

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=100)]
"""Part of the names of folders with results."""


def _as_text(value: object) -> object:
    """Return a number or truth value as xacro writes it."""
    return str(value).lower() if isinstance(value, bool | int | float) else value


LONGEST_S = 86_400
"""Longest duration of a run, a day."""
_Argument = Annotated[str, Field(max_length=1000), BeforeValidator(_as_text)]
_Angle = Annotated[Number, Field(ge=-6.3, le=6.3)]


class RobotConfiguration(StrictModel):
    """The arm.

    Attributes:
        urdf: a path (relative to the scenario file), the name of a shipped robot, or
            ``pybullet_data:`` with a path inside that package.
        joints: names of the joints to drive, all others are held; None for all that turn or slide,
            except the fingers of grippers.
        repair: replace all impossible inertias, even those far off.
        xacro: values of the arguments of a xacro file, by name, such as ``{ur_type: ur10e}``.
        include: folders with packages or files that the arm's file refers to.
        mass_kg: mass of the whole arm, over which estimated inertias are spread where its file
            gives none; by default 1000 kg/m³ of its shapes.
        hold: positions of joints that are held, by name, such as ``{torso_lift_joint: 0.2}``, in
            rad or m; other joints that are not driven are held at zero.
        base_rpy_rad: orientation in which the base is mounted: roll, pitch and yaw, as in a URDF's
            ``rpy``; by default the base is upright. Cartesian paths stay in the frame of
            the base.
        drive_data: source of the numbers of plant.actuator and plant.friction, for reports; the
            mark ESTIMATED causes a warning.
        initial_offset_rad: joint positions at the start, relative to the reference.
    """

    urdf: str
    joints: Annotated[tuple[str, ...], Field(min_length=1)] | None = None
    repair: bool = False
    xacro: dict[str, _Argument] | None = None
    include: Annotated[tuple[str, ...], Field(max_length=20)] | None = None
    mass_kg: Annotated[Number, Field(gt=0, le=1e5)] | None = None
    hold: Annotated[dict[str, Number], Field(max_length=127)] | None = None
    base_rpy_rad: tuple[_Angle, _Angle, _Angle] | None = None
    drive_data: Annotated[str, Field(max_length=1000)] | None = None
    initial_offset_rad: PerJoint = Field(default_factory=lambda: np.zeros(1))


class MetricsConfiguration(StrictModel):
    """Settings of the evaluation.

    Attributes:
        from_s: start of the RMS and largest errors; a shorter run uses its second half.
    """

    from_s: NonNegative = 2.0


class ScenarioConfiguration(StrictModel):
    """A whole experiment.

    The section `uncertainty` does not affect a run; studies draw plants from it.
    """

    name: Name
    duration_s: Annotated[Number, Field(gt=0, le=LONGEST_S)]
    rate_hz: Annotated[Number, Field(ge=10, le=10_000)] = 1000.0
    clock: Literal["realtime", "lockstep"] = "realtime"
    seed: Annotated[Whole, Field(ge=0)] = 0
    robot: RobotConfiguration
    reference: ReferenceConfiguration
    funnel: FunnelConfiguration = FunnelConfiguration()
    controller: ControllerConfiguration = ControllerConfiguration()
    link: LinkConfiguration = LinkConfiguration()
    plant: PlantConfiguration = PlantConfiguration()
    limits: LimitsConfiguration = LimitsConfiguration()
    metrics: MetricsConfiguration = MetricsConfiguration()
    faults: tuple[ScheduledFault, ...] = ()
    uncertainty: Uncertainty = Field(default_factory=dict)
