"""A law that is slower than the control loop: a policy at 10 to 500 Hz, as an example.

The loop goes on at its own rate. The law is asked at every N-th state, and its answer comes into
force once its inference time is over. An answer may be a chunk: rows for the next ticks.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.randomness import plain_generator
from controller.control_law import ControlLaw, Tracking

BetweenAnswers = Literal["hold", "linear"]
_NEAR = 1e-6  # of a tick, as times are floating-point numbers
_MOST_STRETCHES = 1000


@dataclass(frozen=True)
class AnswerTiming:
    """Times at which a law is asked and its answers act.

    Attributes:
        every: the law is asked at every so many states.
        inference_s: time from a question to its answer.
        jitter_s: random change of that time, uniform within ± this value.
        between: what targets do after an answer's last row: stay, or go on at their velocity.
        period_s: of the control loop; rows of a chunk are so far apart.
        seed: of the inference times drawn.
        first_s: `inference_s` of the first question in motion, the second of a run.
        keeps_velocity: held targets keep their velocity, as for a robot that takes velocities.
    """

    every: int
    inference_s: float
    jitter_s: float
    between: BetweenAnswers
    period_s: float
    seed: int
    first_s: float
    keeps_velocity: bool = False


@dataclass(frozen=True)
class _Answer:
    """Answer of a law: torques of shape (rows, joints), targets of shape (rows, 2, joints)."""

    asked_s: float
    ready_s: float
    torques: Matrix
    targets: Matrix


@dataclass
class Starvation:
    """Counter of ticks at which the chunk in force had no row left, and the next one was missing.

    Attributes:
        ticks: states in that situation.
        stretches_s: begin and end of each such time without a break, s.
    """

    ticks: int = 0
    stretches_s: list[list[float]] = field(default_factory=list)
    _is_starved: bool = False

    def note(self, now_s: float, *, is_starved: bool) -> None:
        """Note whether the law has nothing left to send at a state."""
        if is_starved:
            self.ticks += 1
            if not self._is_starved:
                self.stretches_s.append([now_s, now_s])
            self.stretches_s[-1][1] = now_s
        self._is_starved = is_starved

    def summary(self) -> dict[str, object]:
        """Return the ticks and the first stretches, ready for JSON."""
        return {"ticks": self.ticks, "stretches_s": self.stretches_s[:_MOST_STRETCHES]}


class SlowLaw:
    """A law of which one question at a time is open.

    The first answer acts at once, as a robot is released only when its policy has answered.

    Args:
        law: what is asked. Its torques may have a row for each of the next ticks. If it has a
            method ``target``, that gives positions and velocities for the drives, shape (2, joints)
            or (rows, 2, joints); the reference is their target otherwise.
        timing: when it is asked.

    Attributes:
        starvation: when it ran out of rows; answers of one row are meant to be held.
    """

    def __init__(self, law: ControlLaw, timing: AnswerTiming) -> None:
        self._law, self._timing = law, timing
        own_target = getattr(law, "target", None)
        self._own_target = own_target if callable(own_target) else None
        self.diagnostics = law.diagnostics
        self._in_force: _Answer | None = None
        self._coming: _Answer | None = None
        self._forget()

    def reset(self) -> None:
        """Forget all answers, and have the law forget everything."""
        self._law.reset()
        self._forget()

    def close(self) -> None:
        """Give back what the law holds."""
        if callable(close := getattr(self._law, "close", None)):
            close()

    def torque(self, tracking: Tracking) -> Vector:
        """Torque in force at a state, N m, shape (joints,)."""
        now_s, coming = tracking.time_s, self._coming
        self._unasked_s += tracking.step_s
        if coming is not None and now_s >= coming.ready_s - _NEAR * self._timing.period_s:
            self._in_force, self._coming = coming, None
        if self._states % self._timing.every == 0 and self._coming is None:
            answer = self._ask(tracking)
            if self._in_force is None or answer.ready_s <= now_s:
                self._in_force = answer
            else:
                self._coming = answer
        self._states += 1
        acting = self._in_force
        assert acting is not None
        ticks = self._ticks_since_asked(now_s)
        rows = (len(acting.torques), len(acting.targets))
        self.starvation.note(now_s, is_starved=any(1 < each <= ticks for each in rows))
        row: Vector = acting.torques[min(ticks, rows[0] - 1)]
        return row

    def target(self, tracking: Tracking) -> Matrix:
        """Target of the drives at a state, shape (2, joints); to be called after `torque`."""
        assert self._in_force is not None
        targets, period_s = self._in_force.targets, self._timing.period_s
        place = min(self._ticks_since_asked(tracking.time_s), len(targets) - 1)
        target: Matrix = targets[place].copy()
        if self._timing.between == "linear":
            target[0] += (tracking.time_s - self._in_force.asked_s - place * period_s) * target[1]
        elif place == len(targets) - 1 and not self._timing.keeps_velocity:
            target[1] = 0.0
        return target

    def _forget(self) -> None:
        self._random = plain_generator(self._timing.seed)
        self._states = self._asked = 0
        self._unasked_s = 0.0
        self.starvation = Starvation()
        self._in_force = self._coming = None

    def _ask(self, tracking: Tracking) -> _Answer:
        joints, step_s = tracking.position.size, tracking.step_s
        tracking.step_s, self._unasked_s = self._unasked_s, 0.0
        torques = checked_rows("torques", self._law.torque(tracking), (joints,))
        wanted = (
            [tracking.reference_position, tracking.reference_velocity]
            if self._own_target is None
            else self._own_target(tracking)
        )
        targets = checked_rows("targets", wanted, (2, joints))
        tracking.step_s = step_s
        jitter_s = self._timing.jitter_s
        jitter_s *= self._random.uniform(-1.0, 1.0) if jitter_s else 1.0
        inference_s = self._timing.first_s if self._asked == 1 else self._timing.inference_s
        self._asked += 1
        ready_s = tracking.time_s + max(0.0, inference_s + jitter_s)
        return _Answer(tracking.time_s, ready_s, torques, targets)

    def _ticks_since_asked(self, now_s: float) -> int:
        assert self._in_force is not None
        return int((now_s - self._in_force.asked_s) / self._timing.period_s + _NEAR)


def checked_rows(what: str, answer: object, shape: tuple[int, ...]) -> Matrix:
    """A copy of a law's answer, as one row or more.

    Args:
        what: it is, for the error message.
        answer: from the law.
        shape: of a row.

    Raises:
        ValueError: the answer has another shape, or an entry is not finite.
    """
    rows: Matrix = np.array(answer, dtype=np.float64)
    given = rows.shape
    if given == shape:
        rows = rows[np.newaxis]
    if rows.shape[1:] != shape or not rows.size:
        raise ValueError(f"{what} have shape {given}: must be {shape}, or {shape} for each row")
    if not np.isfinite(rows).all():
        raise ValueError(f"{what} {rows.tolist()}: must be finite")
    return rows
