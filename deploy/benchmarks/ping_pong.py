"""Bare Zenoh ping-pong between two processes: the round trip that no loop over Zenoh can beat.

Same session settings and same payloads as the real loop: a plant status and a joint state one way,
a joint command back, nothing decoded, nothing recorded. Run as a module, this is the far end.
"""

from __future__ import annotations

import queue
import subprocess
import sys
import time
from types import TracebackType

from bus_schema import topics
from bus_schema.link_configuration import LinkConfiguration
from bus_schema.rmw_wire import Attachment
from bus_schema.zenoh_session import Delivery, ZenohSession

_ATTACHMENT = Attachment(1, 0, bytes(16)).encode()
_TIMEOUT_S = 10.0
_PATIENCE_S = 0.2


class PingPong:
    """The near end, with the far end as a child process.

    Args:
        link: endpoints to use.
        joint_names: joints of the arm whose messages are sent.
    """

    def __init__(self, link: LinkConfiguration, joint_names: tuple[str, ...]) -> None:
        self._payloads = [
            topics.layout(topic, joint_names).template
            for topic in (topics.PLANT_STATUS, topics.JOINT_STATES)
        ]
        self._replies: queue.SimpleQueue[Delivery] = queue.SimpleQueue()
        self._session = ZenohSession([link.plant_endpoint], [], low_latency=True)
        self._publishers = [
            self._session.publisher(topic.key_expression(link.domain))
            for topic in (topics.PLANT_STATUS, topics.JOINT_STATES)
        ]
        self._session.subscribe(
            topics.JOINT_COMMANDS.key_expression(link.domain), self._replies.put
        )
        arguments = [link.plant_endpoint, str(link.domain), *joint_names]
        self._far_end = subprocess.Popen(
            [sys.executable, "-m", "deploy.benchmarks.ping_pong", *arguments],
            stdin=subprocess.PIPE,
        )

    def __enter__(self) -> PingPong:
        give_up_s = time.monotonic() + _TIMEOUT_S
        # Declarations travel too: the first messages may find no subscriber at either end.
        while not self._exchange(_PATIENCE_S):
            if time.monotonic() > give_up_s:
                raise TimeoutError("the far end of the ping-pong does not come")
        return self

    def __exit__(
        self,
        _type: type[BaseException] | None,
        _value: BaseException | None,
        _traceback: TracebackType | None,
    ) -> None:
        self._far_end.communicate()
        self._session.close()

    def round_trip_us(self, exchanges: int) -> float:
        """Mean round trip over a number of exchanges, µs.

        Raises:
            TimeoutError: the far end does not answer.
        """
        started_ns = time.perf_counter_ns()
        for _ in range(exchanges):
            if not self._exchange(_TIMEOUT_S):
                raise TimeoutError("the far end of the ping-pong does not answer")
        return (time.perf_counter_ns() - started_ns) / exchanges * 1e-3

    def _exchange(self, timeout_s: float) -> bool:
        for publisher, payload in zip(self._publishers, self._payloads, strict=True):
            publisher.put(payload, _ATTACHMENT)
        try:
            self._replies.get(timeout=timeout_s)
        except queue.Empty:
            return False
        return True


def answer(endpoint: str, domain: int, joint_names: tuple[str, ...]) -> None:
    """Be the far end until standard input closes."""
    session = ZenohSession([], [endpoint], low_latency=True)
    payload = topics.layout(topics.JOINT_COMMANDS, joint_names).template
    publisher = session.publisher(topics.JOINT_COMMANDS.key_expression(domain))
    session.subscribe(topics.PLANT_STATUS.key_expression(domain), lambda _: None)
    session.subscribe(
        topics.JOINT_STATES.key_expression(domain), lambda _: publisher.put(payload, _ATTACHMENT)
    )
    sys.stdin.read()
    session.close()


if __name__ == "__main__":
    answer(sys.argv[1], int(sys.argv[2]), tuple(sys.argv[3:]))
