"""Messages for 3-D viewers, in a run's recording and for live subscribers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from bus_schema.messages.topics import TF, Topic
from bus_schema.recording.mcap_log import McapLog
from bus_schema.robot_description import RobotDescription
from bus_schema.view.arm_view import ArmView


class LoggedView:
    """Writes messages for 3-D viewers to a recording, and publishes them.

    Args:
        log: the recording.
        robot: the arm.
        publish: also called with each message; returns its number.
        sent_ns: time of sending of the first messages, as for `McapLog.write`.
    """

    def __init__(
        self,
        log: McapLog,
        robot: RobotDescription,
        publish: Callable[[Topic, bytes], int] | None = None,
        sent_ns: int = 0,
    ) -> None:
        self._log, self._view = log, ArmView(robot)
        self._publish = publish or _numbered()
        for topic, payload in self._view.first():
            self._write(topic, payload, 0, sent_ns)

    def show(self, state: bytes, stamp_ns: int, sent_ns: int) -> None:
        """Write the links' poses at a joint state, as often as a viewer draws."""
        transforms = self._view.transforms(state, stamp_ns)
        if transforms is not None:
            self._write(TF, transforms, stamp_ns, sent_ns)

    def _write(self, topic: Topic, payload: bytes, stamp_ns: int, sent_ns: int) -> None:
        self._log.write(topic, self._publish(topic, payload), stamp_ns, sent_ns, payload)


def _numbered() -> Callable[[Topic, bytes], int]:
    """Number messages for a bus without subscribers."""
    numbers: Counter[str] = Counter()

    def number(topic: Topic, _payload: bytes) -> int:
        numbers[topic.name] += 1
        return numbers[topic.name]

    return number
