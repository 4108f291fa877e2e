"""Questions to a policy server: in virtual time, in real time, and answers of a recorded run."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

import numpy as np

from bus_schema.arrays import Matrix
from controller.chunks.answer import Answer
from controller.control_law import Tracking
from controller.policies.client import PolicyServerError
from controller.policies.served_policy import ServedPolicy, timed_answer
from controller.slow_law import AnswerTiming, ChunkRules, OpenQuestion, SlowLaw, WaitingAnswer
from controller.timed_calls import CallThread


class ServedLaw(SlowLaw):
    """A law whose answers come from a policy server.

    In virtual time the loop waits for the server, and an answer acts after a configured time, or
    after the measured one. Answers are kept for the recording; a replay needs no server.

    Args:
        policy: client of the server.
        timing: as for `SlowLaw`.
        rules: of the chunks.
    """

    def __init__(self, policy: ServedPolicy, timing: AnswerTiming, rules: ChunkRules) -> None:
        self._policy = policy
        self._recorded: Sequence[Mapping[str, Any]] | None = None
        self._is_real_time = False
        self._questions = CallThread[Matrix]()
        self._new: list[str] = []
        super().__init__(policy, timing, rules)

    def answer_in_real_time(self) -> None:
        """Have a thread wait for the server while the loop goes on."""
        self._is_real_time = True

    def answer_from(self, recorded: Sequence[Mapping[str, Any]]) -> None:
        """Answer from a recorded run instead of a server; see `new_answers`."""
        self._recorded = recorded

    def new_answers(self) -> list[str]:
        """Return the answers since the last call as JSON, for the recording.

        Each has ``asked_s``, ``actions`` in the server's unit, and ``ready_s``, which is null where
        the configured inference time decides.
        """
        answers, self._new = self._new, []
        return answers

    def keep(self, asked_s: float, ready_s: float | None, actions: Matrix) -> None:
        """Keep an answer for the recording."""
        values = {"asked_s": asked_s, "ready_s": ready_s, "actions": actions.tolist()}
        self._new.append(json.dumps(values))

    def with_actions(self, asked_s: float, actions: object) -> Answer:
        """Return the answer that has these actions."""
        targets = self._policy.as_targets(actions)
        return self._as_answer(asked_s, np.zeros((1, targets.shape[2])), targets)

    def _forget(self) -> None:
        super()._forget()
        self._new = []
        self._next = 0

    def _ask(self, tracking: Tracking) -> OpenQuestion:
        asked_s = tracking.time_s
        self._note_question(asked_s)
        if self._recorded is not None:
            return self._next_recorded(asked_s)
        observation = self._policy.observe(tracking)
        if self._is_real_time:
            future = self._questions.start(lambda: self._policy.answer(observation))
            return _InThread(self, asked_s, future)
        actions, took_s = timed_answer(self._policy, observation)
        is_measured = self._policy.settings.inference == "measured"
        ready_s = asked_s + took_s if is_measured else None
        self.keep(asked_s, ready_s, actions)
        return self._waiting(self.with_actions(asked_s, actions), ready_s)

    def _next_recorded(self, asked_s: float) -> OpenQuestion:
        assert self._recorded is not None
        if self._next >= len(self._recorded):
            if not self._next:
                raise PolicyServerError("the recording has no answer of the policy server")
            return WaitingAnswer(None, math.inf)  # the run ended before this answer
        entry = self._recorded[self._next]
        self._next += 1
        ready_s = entry.get("ready_s")
        if not isinstance(ready_s, float | None):  # recordings are untrusted
            raise PolicyServerError(f"the recording has no time of answer {self._next}")
        return self._waiting(self.with_actions(asked_s, entry.get("actions")), ready_s)


@dataclass(frozen=True)
class _InThread:
    """A question that a thread has asked.

    Attributes:
        future: of the actions; the client limits how long they take.
    """

    law: ServedLaw
    asked_s: float
    future: Future[Matrix]

    def answer_at(self, now_s: float) -> Answer | None:
        return self._received(now_s) if self.future.done() else None

    def wait(self) -> Answer:
        return self._received(self.asked_s)

    def _received(self, now_s: float) -> Answer:
        actions = self.future.result()
        self.law.keep(self.asked_s, now_s, actions)
        return self.law.with_actions(self.asked_s, actions)
