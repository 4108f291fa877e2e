"""Torque of a run: size, travel and limits."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from bus_schema.messages import topics
from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Role
from deploy.judge.findings.chattering import chatter_shares
from deploy.judge.motion.torques import torques
from deploy.judge.result.section import Column, PerJoint, Section
from deploy.judge.run_data import RunData


class Torque(Section):
    """Commanded torques; where drives close loops of their own, the delivered ones.

    Attributes:
        total_variation_nm_per_s: sum of |Δτ| over the duration, per joint
        share_above_50_hz: share of the torque variation's power above 50 Hz, per joint
        rms_nm: RMS of the torque, per joint
        peak_nm: largest torque, per joint
        saturated_fraction: share of ticks at which any actuator saturated
    """

    total_variation_nm_per_s: Annotated[PerJoint | None, Column()]
    share_above_50_hz: Annotated[PerJoint | None, Column()]
    rms_nm: Annotated[PerJoint | None, Column()]
    peak_nm: Annotated[PerJoint | None, Column()]
    saturated_fraction: Annotated[float | None, Column()]


class Limits(Section):
    """Limits that torques met.

    Attributes:
        controller: torques that the controller clipped, by limit
        plant: ticks at which the plant met a limit, by limit
    """

    controller: dict[str, int] | None
    plant: dict[str, int] | None


def torque(run: RunData) -> Torque:
    """Return the torques of a run."""
    truth = run.tables[topics.PLANT_TRUTH.name]
    times_s, effort, after_gaps = torques(run)
    follows = ~np.isin(np.arange(1, len(times_s)), after_gaps)
    left_out_s = np.abs(np.diff(times_s))[~follows].sum()
    duration_s = np.ptp(times_s) - left_out_s if follows.any() else 0.0  # answers may be unordered
    if not duration_s > 0.0:
        return Torque(**dict.fromkeys(Torque.model_fields))
    variation = np.abs(np.diff(effort, axis=0))[follows].sum(axis=0) / duration_s
    return Torque(
        total_variation_nm_per_s=variation.tolist(),
        share_above_50_hz=chatter_shares(effort, run.setup.scenario.rate_hz, after_gaps),
        rms_nm=np.sqrt((effort**2).mean(axis=0)).tolist(),
        peak_nm=np.abs(effort).max(axis=0).tolist(),
        saturated_fraction=float(truth["saturated"].mean()) if len(truth) else None,
    )


def limits(run: RunData) -> Limits:
    """Return how often each side met each limit."""
    return Limits(
        controller=run.last_values(Role.CONTROLLER, EventKind.ENDED).get("limits"),
        plant=run.last_values(Role.PLANT, EventKind.COUNTS).get("limits"),
    )
