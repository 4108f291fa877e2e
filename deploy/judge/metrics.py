"""The result of a run: all figures in ``summary.json``, from the data of the run."""

from __future__ import annotations

from typing import Annotated, Any, Self

from bus_schema.messages.run_event import EventKind
from bus_schema.messages.topics import Role
from deploy.judge.bounds import Bounds, all_damage, judge_bounds, may_have_moved, plant_count
from deploy.judge.findings.identified import identified
from deploy.judge.findings.loss_reason import LossReason, loss_reason
from deploy.judge.findings.ranges import BeyondRange, beyond_ranges
from deploy.judge.motion.chunks import Chunks, chunks
from deploy.judge.motion.joint_lag import lag_ms
from deploy.judge.motion.robot_lag import RobotLag, robot_lag
from deploy.judge.motion.tip_error import TipError, tip_error_mm
from deploy.judge.recorded_ticks import known_ticks
from deploy.judge.reported_values import Reflex
from deploy.judge.result.oscillation import (
    Growing,
    Vibrating,
    growing,
    growths_of,
    not_tested_slower_s,
    vibrating,
)
from deploy.judge.result.recording import (
    Commander,
    Recorder,
    Recording,
    commander,
    recorder,
    recording,
)
from deploy.judge.result.section import Column, Section
from deploy.judge.result.timing import Timing, timing
from deploy.judge.result.torque import Limits, Torque, limits, torque
from deploy.judge.result.tracking import Tracking, tracking
from deploy.judge.result.transport import Transport, transport
from deploy.judge.run_data import RunData
from deploy.judge.verdict import Verdict, decide

_SHORTEST_S = 1e-6


class RunResult(Section):
    """The result of a run.

    Attributes:
        scenario: name of the scenario
        law: name of the law or of the controller process
        clock: ``realtime``, ``lockstep`` or ``virtual`` (one process)
        link: ``zenoh``, ``can`` or ``in_process``
        duration_s: simulated time that was judged
        ticks: control periods of the run, including those that a late plant skipped
        completed: whether the run reached its end and the recording is complete
        faults: one sentence per fault, causes before consequences
        real_time_factor: simulated time over wall time
        seed_used: whether the run drew random numbers, so that another seed gives another run; null
            if that is not known, and in real time
        loss: why the run left its funnel; null if it did not
        lag_ms: how far each joint is behind its reference, ms: least squares of the true error
            against the reference's velocity while commands move the arm, from ``metrics.from_s``
            on; negative ahead of it, null where it rests
        robot_lag: where the lag of a robot that takes positions or velocities comes from; null for
            others
        beyond_ranges: joints that pass an end of their range by much; MuJoCo has no end stops
        growing: joints whose error grows exponentially over the last half of the run
        not_tested_below_hz: slower oscillations may grow unseen, as the run is too short; null if
            nothing was tested
        not_tested_slower_s: growth that takes longer than this for a factor of e is not seen
        vibrating: joints whose torque swings between its limits over the last half of the run
        chunks: of a law slower than the loop; null for other laws
        reflexes: stops that the robot's own controller decided
        robot_server: only with ``robot-server`` — interface, ticks for which the host was late
            (``skipped``), counts of what the client asked for, when it gave its first and its
            last target, stops of the robot, and the lateness of the network's relay
        identified: model values identified by delay compensation, with the true ones; null without
            compensation
        digest: SHA-256 over delivered joint states and commands; equal for equal runs
        motion: SHA-256 over the true positions, velocities and torques; equal for equal motions,
            however messages were delayed
        verdict: ``kept``, ``lost``, ``unknown``, ``faulted``, ``interrupted`` or ``nothing``
        confirmation: only with ``--confirm`` — the same run on other physics
        tested_with: only in a folder — the test behind the result, for comparisons with others
    """

    only_sometimes = frozenset({"confirmation", "tested_with", "robot_server"})
    scenario: Annotated[str, Column(of_any_part=True)]
    law: Annotated[str, Column(of_any_part=True)]
    clock: str
    link: str
    duration_s: Annotated[float, Column(of_any_part=True)]
    ticks: Annotated[int, Column(of_any_part=True)]
    completed: Annotated[bool, Column(of_any_part=True)]
    faults: list[str]
    real_time_factor: float | None
    seed_used: Annotated[bool | None, Column(of_any_part=True)]
    bounds: Bounds
    loss: Annotated[LossReason | None, Column("loss_{}")]
    tracking: Tracking
    lag_ms: list[float | None]
    robot_lag: RobotLag | None
    tip_error_mm: Annotated[TipError, Column("tip_{}_mm")]
    beyond_ranges: list[BeyondRange]
    growing: Annotated[list[Growing], Column(kind="bool")]
    not_tested_below_hz: Annotated[float | None, Column()]
    not_tested_slower_s: float | None
    vibrating: Annotated[list[Vibrating], Column(kind="bool")]
    torque: Torque
    timing: Timing
    transport: Transport
    chunks: Chunks | None
    limits: Limits
    reflexes: list[Reflex]
    robot_server: dict[str, Any] | None = None
    identified: dict[str, Any] | None
    recorder: Recorder
    recording: Recording
    commander: Commander
    digest: Annotated[str, Column(of_any_part=True)]
    motion: Annotated[str, Column()]
    verdict: Annotated[Verdict, Column(of_any_part=True)] = Verdict.NOTHING
    confirmation: list[dict[str, Any]] | None = None
    tested_with: dict[str, Any] | None = None

    def replaced(self, **figures: Any) -> Self:
        """Return the result with other values of some figures."""
        return self.model_copy(update=figures)

    def with_verdict(self, verdict: Verdict) -> Self:
        """Return the result with a verdict, and with its consequences."""
        is_judged = self.bounds.violation_fraction is not None
        ended = is_judged and verdict not in (Verdict.FAULTED, Verdict.INTERRUPTED)
        bounds = self.bounds.model_copy(update={"kept": verdict is Verdict.KEPT})
        return self.replaced(verdict=verdict, completed=self.completed and ended, bounds=bounds)


def judge(run: RunData) -> RunResult:
    """Return the result of a run."""
    setup = run.setup
    outcome = run.last_values(Role.PLANT, EventKind.ENDED)
    known, errors = known_ticks(run), tracking(run)
    duration_s = known.ticks * setup.grid.period_ns * 1e-9
    wall_s = float(outcome.get("wall_s", 0.0))
    faults, bounds, lags_ms, loss = run.faults(), judge_bounds(run), lag_ms(run), loss_reason(run)
    is_ended = bool(outcome.get("completed", False)) and known.ticks >= setup.ticks
    damage = all_damage(run, bounds)
    grown = growths_of(run, is_known=not known.missing)
    verdict = decide(
        faults,
        is_judged=bounds.violation_fraction is not None and may_have_moved(run, known),
        was_outside=bool(bounds.violation_fraction or plant_count(run).get("outside")),
        is_known=run.complete and not damage and not known.missing,
        is_ended=is_ended,
    )
    result = RunResult(
        scenario=setup.scenario.name,
        law=run.controller,
        clock=run.clock,
        link=run.link,
        duration_s=duration_s,
        ticks=known.ticks,
        completed=is_ended and run.complete and not damage,
        faults=faults,
        real_time_factor=duration_s / wall_s if wall_s > _SHORTEST_S else None,
        seed_used=_is_seed_used(run),
        bounds=bounds,
        loss=loss,
        tracking=errors,
        lag_ms=lags_ms,
        robot_lag=robot_lag(run, lags_ms),
        tip_error_mm=tip_error_mm(run, None if loss is None else loss.time_s),
        beyond_ranges=beyond_ranges(run),
        growing=growing(run, grown),
        not_tested_below_hz=grown.not_tested_below_hz,
        not_tested_slower_s=not_tested_slower_s(run, grown),
        vibrating=vibrating(run, is_known=not known.missing),
        torque=torque(run),
        timing=timing(run, known, outcome.get("stolen_ms")),
        transport=transport(run),
        chunks=chunks(run),
        limits=limits(run),
        reflexes=run.last_values(Role.PLANT, EventKind.COUNTS).get("reflexes", []),
        robot_server=run.last_values(Role.PLANT, EventKind.COUNTS).get("robot_server"),
        identified=identified(run),
        recorder=recorder(run),
        recording=recording(run, known, damage, errors.settling_time_s),
        commander=commander(run),
        digest=run.digest,
        motion=run.motion,
    )
    return result.with_verdict(verdict)


def summarise(run: RunData) -> dict[str, Any]:
    """Return the result of a run, ready for JSON."""
    return judge(run).model_dump()


def _is_seed_used(run: RunData) -> bool | None:
    """Whether plant or controller drew random numbers; None if that is not known."""
    flags = [
        run.last_values(role, EventKind.ENDED).get("seed_used")
        for role in (Role.PLANT, Role.CONTROLLER)
    ]
    return True if True in flags else flags[0] if run.clock != "realtime" else None
