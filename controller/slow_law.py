"""A law that is slower than the control loop: a policy at 10 to 500 Hz, as an example.

The loop goes on at its own rate. The law is asked at every N-th state, and its answer comes into
force once its inference time is over. An answer may be a chunk: rows for the next ticks or actions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Literal, Protocol

from bus_schema.arrays import Matrix, Vector
from bus_schema.runtime.randomness import plain_generator
from controller.chunks.answer import NEAR, Answer, AnswerShapeError, Holding, checked_rows
from controller.chunks.merge import ChunkMerge
from controller.chunks.merges import Replace
from controller.chunks.switches import ChunkLog
from controller.control_law import AroundLaw, ControlLaw, Tracking
from controller.timed_calls import CallThread


@dataclass(frozen=True)
class AnswerTiming:
    """Times at which a law is asked and its answers act.

    Attributes:
        every: the law is asked at every so many states, at most.
        inference_s: time from a question to its answer.
        jitter_s: random change of that time, uniform within ± this value.
        holding: what targets do between rows.
        period_s: of the control loop.
        seed: of the inference times drawn.
        first_s: `inference_s` of the first question in motion, the second of a run.
        timeout_s: longest wall time of an answer; None for any.
    """

    every: int
    inference_s: float
    jitter_s: float
    holding: Holding
    period_s: float
    seed: int
    first_s: float
    timeout_s: float | None = None


@dataclass(frozen=True)
class ChunkRules:
    """Rules of a law with chunks: times of its questions, and the merge of its answers.

    Attributes:
        merge: how it takes over.
        action_s: between two rows; None for the period of the control loop.
        horizon: rows that each answer must have; None for any.
        ask_when: share of the rows of a chunk at or below which the law is asked.
        ask_every: instead, rows from one question to the next.
        align: a first row is meant for the time of its state, or acts when it arrives.
    """

    merge: ChunkMerge
    action_s: float | None = None
    horizon: int | None = None
    ask_when: float = 1.0
    ask_every: int | None = None
    align: Literal["time", "count"] = "time"


class OpenQuestion(Protocol):
    """A question whose answer is not in force yet."""

    def answer_at(self, now_s: float) -> Answer | None:
        """Return the answer if it is there at a time; else None."""

    def wait(self) -> Answer | None:
        """Return the answer as soon as it is known."""


@dataclass(frozen=True)
class WaitingAnswer:
    """An answer that is known, and waits until its inference time is over."""

    answer: Answer | None
    ready_s: float

    def answer_at(self, now_s: float) -> Answer | None:
        return self.answer if now_s >= self.ready_s else None

    def wait(self) -> Answer | None:
        return self.answer


class SlowLaw(AroundLaw):
    """A law of which one question at a time is open.

    The first answer acts at once, as a robot is released only when its policy has answered.

    Args:
        law: what is asked. Its torques may have a row for each of the next actions. If it has a
            method ``target``, that gives positions and velocities for the drives, shape (2, joints)
            or (rows, 2, joints); the reference is their target otherwise. If it has a method
            ``guide``, that receives the guidance of the merge before each question.
        timing: when it is asked.
        rules: of its chunks; by default a new one takes over at once.

    Attributes:
        log: how its answers followed each other.
    """

    def __init__(
        self, law: ControlLaw, timing: AnswerTiming, rules: ChunkRules | None = None
    ) -> None:
        self._law, self._timing = law, timing
        self._rules = ChunkRules(Replace()) if rules is None else rules
        own_target = getattr(law, "target", None)
        self._own_target = own_target if callable(own_target) else None
        guide = getattr(law, "guide", None)
        self._guide = guide if callable(guide) else None
        self._row_s = self._rules.action_s or timing.period_s
        self._calls = CallThread[tuple[Matrix, Matrix]]()
        self._in_force: Answer | None = None
        self._open: OpenQuestion | None = None
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
        now_s = tracking.time_s
        self._since_s += tracking.step_s
        if self._open is not None and (answer := self._open.answer_at(now_s)) is not None:
            self._take_over(answer, now_s)
        if self._states % self._timing.every == 0 and self._open is None and self._wants(now_s):
            self._open = asked = self._ask(tracking)
            answer = asked.wait() if self._in_force is None else asked.answer_at(now_s)
            if answer is not None:
                self._take_over(answer, now_s)
        self._states += 1
        acting = self._in_force
        assert acting is not None
        self.log.note(acting, now_s)
        return acting.torque_at(now_s)

    def target(self, tracking: Tracking) -> Matrix:
        """Target of the drives at a state, shape (2, joints); to be called after `torque`."""
        assert self._in_force is not None
        return self._in_force.target_at(tracking.time_s)

    def _forget(self) -> None:
        self._random = plain_generator(self._timing.seed)
        self._states = self._asked = 0
        self._asked_s = self._since_s = 0.0
        self._rules.merge.reset()
        self.log = ChunkLog(has_targets=self._own_target is not None)
        self._in_force = self._open = None

    def _wants(self, now_s: float) -> bool:
        """Whether the law is to be asked at a state."""
        acting, rules = self._in_force, self._rules
        if acting is None:
            return True
        if rules.merge.waits:
            return now_s >= acting.end_s - NEAR * self._row_s
        if rules.ask_every is not None:
            return now_s - self._asked_s >= (rules.ask_every - NEAR) * self._row_s
        left = (acting.end_s - now_s) / self._row_s - 1.0  # a merge may have made more rows of it
        actions = (acting.end_s - acting.starts_s) / self._row_s
        return left <= rules.ask_when * actions + NEAR

    def _take_over(self, answer: Answer, now_s: float) -> None:
        old, self._open = self._in_force, None
        if old is None:
            self._in_force = answer
            return
        if self._rules.align == "count":
            answer = replace(answer, starts_s=now_s)
        self._in_force = self._rules.merge.merged(old, answer, now_s)
        self.log.note_switch(old, self._in_force, now_s)

    def _ask(self, tracking: Tracking) -> OpenQuestion:
        now_s = tracking.time_s
        self._tell(now_s)
        self._note_question(now_s)
        answers, limit_s = partial(self._answers, tracking), self._timing.timeout_s
        given = answers() if limit_s is None else self._calls.wait(answers, limit_s)
        return self._waiting(self._as_answer(now_s, *given), None)

    def _note_question(self, now_s: float) -> None:
        self._asked += 1
        self._asked_s = now_s

    def _waiting(self, answer: Answer, ready_s: float | None) -> WaitingAnswer:
        """Return an answer that acts from a time on; None for its configured inference time."""
        if ready_s is None:
            jitter_s = self._timing.jitter_s
            jitter_s *= self._random.uniform(-1.0, 1.0) if jitter_s else 1.0
            inference_s = self._timing.first_s if self._asked == 2 else self._timing.inference_s
            ready_s = answer.asked_s + max(0.0, inference_s + jitter_s)
        return WaitingAnswer(answer, ready_s - NEAR * self._timing.period_s)

    def _answers(self, tracking: Tracking) -> tuple[Matrix, Matrix]:
        """Return torques and targets of the law, whose step is the time since its last question."""
        joints, step_s = tracking.position.size, tracking.step_s
        tracking.step_s, self._since_s = self._since_s, 0.0
        torques = checked_rows("torques", self._law.torque(tracking), (joints,))
        wanted = (
            [tracking.reference_position, tracking.reference_velocity]
            if self._own_target is None
            else self._own_target(tracking)
        )
        tracking.step_s = step_s
        return torques, checked_rows("targets", wanted, (2, joints))

    def _tell(self, now_s: float) -> None:
        """Tell a policy what it continues, if it has asked for that."""
        if self._guide is None or self._in_force is None:
            return
        guidance = self._rules.merge.guidance(self._in_force, now_s)
        if guidance is not None:
            self._guide(*guidance)

    def _as_answer(self, asked_s: float, torques: Matrix, targets: Matrix) -> Answer:
        """Return the answer to a question.

        Raises:
            AnswerShapeError: it has another number of rows than the horizon.
        """
        answer = Answer(asked_s, asked_s, self._row_s, torques, targets, self._timing.holding)
        horizon = self._rules.horizon
        if horizon is not None and answer.rows != horizon:
            raise AnswerShapeError(
                f"an answer has {answer.rows} rows: must be {horizon}, as controller.chunks.horizon"
            )
        return answer
