"""Computation of the numbers in ``summary.json`` from the data of a run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from bus_schema.arrays import PERCENTILES, Matrix, Vector, percentiles
from bus_schema.messages import topics
from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Role
from controller.manipulator_model import ManipulatorModel, spread_positions
from deploy.judge.bounds import all_damage, judge_bounds, may_have_moved, plant_count
from deploy.judge.chunks import chunks
from deploy.judge.findings.chattering import chatter_shares
from deploy.judge.findings.growing import growths, longest_growth_time_s
from deploy.judge.findings.identified import identified
from deploy.judge.findings.link_delays import measured_link
from deploy.judge.findings.loss_reason import loss_reason
from deploy.judge.findings.ranges import beyond_ranges
from deploy.judge.findings.stalls import longest_stall_ms
from deploy.judge.findings.vibration import vibrations
from deploy.judge.joint_lag import lag_ms
from deploy.judge.recorded_ticks import KnownTicks, known_ticks, longest_run, rows_after_gaps
from deploy.judge.run_data import RunData, stamps_s
from deploy.judge.tip_error import tip_error_mm
from deploy.judge.torques import torques
from deploy.judge.verdict import decide, with_verdict
from deploy.scenario.setup import Setup

UNAUTHENTICATED = (
    "without link.security, the check of the commander protects against mistakes, but not against"
    " someone who copies the commander's id"
)
_SHORTEST_S = 1e-6
_UNTESTED: dict[str, Any] = {
    "growing": [], "not_tested_below_hz": None, "not_tested_slower_s": None,
}  # fmt: skip
_MOST_GAPS = 20
_largest_inertias: dict[tuple[str, float, bytes], float] = {}
"""By arm, payload and weights: the runs of a study mostly share them."""
_CHANNEL = ("sent", "delivered", "lost", "duplicated", "reordered")


def summarise(run: RunData) -> dict[str, Any]:
    """Return the summary of a run, ready for JSON."""
    setup = run.setup
    outcome = run.last_values(Role.PLANT, EventKind.ENDED)
    known, tracking = known_ticks(run), _tracking(run)
    duration_s = known.ticks * setup.grid.period_ns * 1e-9
    wall_s = float(outcome.get("wall_s", 0.0))
    faults, bounds = run.faults(), judge_bounds(run)
    lost = loss_reason(run)
    is_ended = bool(outcome.get("completed", False)) and known.ticks >= setup.ticks
    damage = all_damage(run, bounds)
    verdict = decide(
        faults,
        is_judged=bounds["violation_fraction"] is not None and may_have_moved(run, known),
        was_outside=bool(bounds["violation_fraction"] or plant_count(run).get("outside")),
        is_known=run.complete and not damage and not known.missing,
        is_ended=is_ended,
    )
    summary = {
        "scenario": setup.scenario.name,
        "law": run.controller,
        "clock": run.clock,
        "link": run.link,
        "duration_s": duration_s,
        "ticks": known.ticks,
        "completed": is_ended and run.complete and not damage,
        "faults": faults,
        "real_time_factor": duration_s / wall_s if wall_s > _SHORTEST_S else None,
        "seed_used": _is_seed_used(run),
        "bounds": bounds,
        "loss": None if lost is None else {**lost._asdict(), "reason": lost.reason.value},
        "tracking": tracking,
        "lag_ms": lag_ms(run),
        "tip_error_mm": tip_error_mm(run),
        "beyond_ranges": beyond_ranges(run),
        **(_UNTESTED if known.missing else _growing(run)),
        "vibrating": [] if known.missing else _vibrating(run),
        "torque": _torque(run),
        "timing": _timing(run, known, outcome.get("stolen_ms")),
        "transport": _transport(run),
        "chunks": chunks(run),
        "limits": _limits(run),
        "reflexes": run.last_values(Role.PLANT, EventKind.COUNTS).get("reflexes", []),
        "identified": identified(run),
        "recorder": {
            "messages": run.messages,
            "lost": None if run.lost is None else sum(run.lost.values()),
            "lost_by_topic": None if run.lost is None else dict(run.lost),
            "complete": run.complete,
        },
        "recording": _recording(run, known, damage, tracking["settling_time_s"]),
        "commander": _commander(run),
        "digest": run.digest,
        "motion": run.motion,
    }
    return with_verdict(summary, verdict)


def _is_seed_used(run: RunData) -> bool | None:
    """Whether plant or controller drew random numbers; None if that is not known."""
    flags = [
        run.last_values(role, EventKind.ENDED).get("seed_used")
        for role in (Role.PLANT, Role.CONTROLLER)
    ]
    return True if True in flags else flags[0] if run.clock != "realtime" else None


def _tracking(run: RunData) -> dict[str, Any]:
    errors, times_s = run.true_errors_rad, run.times_s(topics.PLANT_TRUTH)
    judged = errors[times_s >= run.setup.scenario.metrics.from_s]
    return {
        "joint_names": list(run.setup.robot.joint_names),
        "rms_rad": np.sqrt((judged**2).mean(axis=0)).tolist() if len(judged) else None,
        "max_abs_rad": np.abs(judged).max(axis=0).tolist() if len(judged) else None,
        "settling_time_s": settling_times_s(errors, times_s, run.setup.funnel.final_rad),
        "settling_bound_s": settling_bound_s(run.setup),
    }


def _growing(run: RunData) -> dict[str, Any]:
    """Return the joints whose error grows exponentially, and which growth is not tested."""
    positions = run.tables[topics.PLANT_TRUTH.name]["position"]
    rate_hz = run.setup.scenario.rate_hz
    found = growths(run.true_errors_rad, positions, rate_hz)
    duration_s, is_tested = len(positions) / rate_hz, found.not_tested_below_hz is not None
    return {
        "growing": _by_joint(run, found.joints),
        "not_tested_below_hz": found.not_tested_below_hz,
        "not_tested_slower_s": longest_growth_time_s(duration_s) if is_tested else None,
    }


def _vibrating(run: RunData) -> list[dict[str, Any]]:
    """Return the joints whose torque swings between its limits."""
    truth, setup = run.tables[topics.PLANT_TRUTH.name], run.setup
    found = vibrations(
        truth["torque"], truth["saturated"], setup.largest_torques_nm, setup.scenario.rate_hz
    )
    return _by_joint(run, found)


def _by_joint(run: RunData, found: Sequence[Any]) -> list[dict[str, Any]]:
    """Return the findings of joints, ready for JSON; None stands for a joint without one."""
    return [
        {"joint": joint, **asdict(each)}
        for joint, each in zip(run.setup.robot.joint_names, found, strict=True)
        if each is not None
    ]


def settling_times_s(errors: Matrix, times_s: Vector, band_rad: Vector) -> list[float | None]:
    """Return the time when each joint's error last entered ±band to stay; null if it never did."""
    settled: list[float | None] = []
    for error, band in zip(errors.T, band_rad, strict=True):
        outside = np.flatnonzero(np.abs(error) > band)
        entered = outside[-1] + 1 if outside.size else 0
        settled.append(float(times_s[entered]) if entered < len(times_s) else None)
    return settled


def settling_bound_s(setup: Setup) -> float | None:
    """Return the law's bound for this arm with its payload, s; None for a law without one.

    It uses the largest inertia in positions spread over all joint ranges, not only on the
    reference: one bound for every start.
    """
    robot, payload_kg = setup.robot, setup.scenario.plant.payload_kg

    def largest_inertia(weights: Vector) -> float:
        arm = (robot.text, payload_kg, weights.tobytes())
        if arm not in _largest_inertias:
            model = ManipulatorModel(robot, payload_kg=payload_kg)
            _largest_inertias[arm] = model.largest_inertia(spread_positions(robot), weights)
        return _largest_inertias[arm]

    return setup.scenario.controller.settling_bound_s(setup.gains, largest_inertia)


def _torque(run: RunData) -> dict[str, Any]:
    truth = run.tables[topics.PLANT_TRUTH.name]
    times_s, effort, after_gaps = torques(run)
    follows = ~np.isin(np.arange(1, len(times_s)), after_gaps)
    left_out_s = np.abs(np.diff(times_s))[~follows].sum()
    duration_s = np.ptp(times_s) - left_out_s if follows.any() else 0.0  # answers may be unordered
    if not duration_s > 0.0:
        return dict.fromkeys(
            ("total_variation_nm_per_s", "share_above_50_hz", "rms_nm", "peak_nm",
             "saturated_fraction")
        )  # fmt: skip
    variation = np.abs(np.diff(effort, axis=0))[follows].sum(axis=0) / duration_s
    return {
        "total_variation_nm_per_s": variation.tolist(),
        "share_above_50_hz": chatter_shares(effort, run.setup.scenario.rate_hz, after_gaps),
        "rms_nm": np.sqrt((effort**2).mean(axis=0)).tolist(),
        "peak_nm": np.abs(effort).max(axis=0).tolist(),
        "saturated_fraction": float(truth["saturated"].mean()) if len(truth) else None,
    }


def _recording(
    run: RunData, known: KnownTicks, damage: list[str], settled_s: Sequence[float | None]
) -> dict[str, Any]:
    """Describe how complete the recording is.

    It includes the torque time missing in gaps, and which settling times are upper limits.
    """
    skipped = run.tables[topics.PLANT_TRUTH.name]["timing.skipped"]
    torque_times_s, _, after_gaps = torques(run)
    steps_s = np.abs(np.diff(torque_times_s, prepend=torque_times_s[:1]))
    times_s = run.times_s(topics.PLANT_TRUTH)
    behind_gaps_s = set(times_s[rows_after_gaps(run, times_s)].tolist())
    return {
        "damage": damage,
        "rejected": dict(run.rejected),
        "notes": run.notes,
        "ticks_known": known.known,
        "ticks_skipped": int(skipped.max(initial=0)),
        "gaps_s": known.gaps_s[:_MOST_GAPS],
        "torque_left_out_s": float(steps_s[after_gaps].sum()),
        "settling_is_latest": [time_s in behind_gaps_s for time_s in settled_s],
    }


def _timing(run: RunData, known: KnownTicks, stolen_ms: float | None) -> dict[str, Any]:
    truth = run.tables[topics.PLANT_TRUTH.name]
    missed = truth["deadline_met"] == 0
    misses = int(missed.sum())
    return {
        **{name: percentiles(values_us) for name, values_us in times_us(run).items()},
        "deadline_misses": misses,
        "deadline_miss_longest_run": longest_run(missed, rows_after_gaps(run, stamps_s(truth))),
        "success_rate": 1.0 - misses / known.known if known.known else None,
        "stolen_ms": stolen_ms if run.clock == "realtime" else None,  # costs nothing elsewhere
        "longest_stall_ms": longest_stall_ms(run),
    }


def times_us(run: RunData) -> dict[str, Vector]:
    """Return all values of every measured time, µs, by its name in the summary."""
    truth = run.tables[topics.PLANT_TRUTH.name]
    in_nanoseconds = {
        "round_trip_us": truth["round_trip_ns"],
        "command_age_us": truth["command_age_ns"],
        "state_age_us": truth["state_age_ns"],
        "control_step_us": run.tables[topics.CONTROL_STATUS.name]["timing.step_ns"],
        "wakeup_lateness_us": truth["timing.lateness_ns"],
    }
    # negative: there is none
    return {name: values[values >= 0] * 1e-3 for name, values in in_nanoseconds.items()}


def _limits(run: RunData) -> dict[str, Any]:
    """Return how often each side met each limit: the controller by torques, the plant by ticks."""
    return {
        "controller": run.last_values(Role.CONTROLLER, EventKind.ENDED).get("limits"),
        "plant": run.last_values(Role.PLANT, EventKind.COUNTS).get("limits"),
    }


def _transport(run: RunData) -> dict[str, Any]:
    counts = run.last_values(Role.PLANT, EventKind.COUNTS)
    always: dict[str, Any] = {**dict.fromkeys(_CHANNEL), "rejected": {}}
    unknown = {
        "delay_ms": dict.fromkeys(("mean", *PERCENTILES)),
        "loss_burst": dict.fromkeys(("mean", "longest")),
    }
    channels = {name: always | (counts.get(name) or unknown) for name in ("uplink", "downlink")}
    for name, measured in measured_link(run).items():
        channels[name].pop("curves", None)  # for the report alone
        channels[name]["measured_ms"] = percentiles(measured.delays_ms)
    return channels | {name: counts[name] for name in ("can", "playout") if name in counts}


def _commander(run: RunData) -> dict[str, Any]:
    """Describe the security of "one commander": whether senders had to prove their identity."""
    if run.link != "zenoh":
        return {"authenticated": None, "note": None}
    is_authenticated = run.setup.scenario.link.security.enabled
    return {
        "authenticated": is_authenticated,
        "note": None if is_authenticated else UNAUTHENTICATED,
    }
