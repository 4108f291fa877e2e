"""The recording of a run: what it contains, besides messages, to judge or repeat the run."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from bus_schema.messages import topics
from bus_schema.messages.topics import TF, Topic
from bus_schema.recording.atomic_files import partial_path
from bus_schema.recording.mcap_log import McapLog, record_afterwards
from bus_schema.robot_description import RobotDescription
from bus_schema.view.arm_view import ArmView
from bus_schema.zenoh.bundle_order import ALTERED_BUNDLE
from deploy.scenario.effective import portable_scenario
from deploy.scenario.referenced_files import DATA_FILES, data_files
from deploy.scenario.setup import Setup

logger = logging.getLogger(__name__)

SCENARIO_ATTACHMENT = "scenario.yaml"
ROBOT_ATTACHMENT = "robot.urdf"
RUN_METADATA = "run"
RECORDER_METADATA = "recorder"
LOST_METADATA = "lost"
REJECTED_METADATA = "rejected"
"""Number of messages forged in the name of a process of the run, by reason."""
SECOND_PLANT = "second_plant"
DAMAGING = (SECOND_PLANT, ALTERED_BUNDLE)
"""Reasons that make it uncertain which messages are the plant's."""
FAILURES_METADATA = "failures"
"""Facts that the recorder cannot know: a sentence for each failed process, causes first."""


def open_log(setup: Setup, path: Path, *, clock: str, link: str) -> McapLog:
    """Begin the recording of a run, with everything needed to judge or repeat it.

    Raises:
        OSError: it cannot be written.
    """
    names = setup.robot.joint_names
    tick_bytes = sum(
        topics.layout(topic, names).size
        for topic in topics.TOPICS
        if topic.rate is topics.Rate.TICK
    )
    log = McapLog(path, bytes_per_s=tick_bytes * setup.scenario.rate_hz)
    scenario = setup.scenario
    attach_scenario(log, setup)
    log.add_metadata(
        RUN_METADATA,
        {"scenario": scenario.name, "law": scenario.controller.name, "clock": clock, "link": link},
    )
    if log.failure is not None:
        raise log.failure
    return log


def attach_scenario(log: McapLog, setup: Setup) -> None:
    """Attach everything needed to judge or repeat a run; what is attached last counts."""
    log.attach(SCENARIO_ATTACHMENT, "application/yaml", portable_scenario(setup).encode())
    arm = replace(setup.robot, base_rpy_rad=None)  # the scenario mounts it
    log.attach(ROBOT_ATTACHMENT, "application/xml", arm.resolved_urdf().encode())
    for key, file in data_files(setup.scenario).items():
        log.attach(DATA_FILES[key], "text/plain", file.read_bytes())


def close_log(log: McapLog, lost: Counter[str], rejected: Counter[str]) -> None:
    """Finish a recording with the counts of its messages and of missing ones, by topic.

    Args:
        log: the recording.
        lost: number of missing messages, by topic.
        rejected: number of messages and bundles sent in another's name, by reason.
    """
    log.finish_messages()
    missing = lost + log.lost
    counts = {"messages": log.messages, "lost": missing.total()}
    log.add_metadata(RECORDER_METADATA, _as_text(counts))
    log.add_metadata(LOST_METADATA, _as_text(missing))
    if rejected:
        log.add_metadata(REJECTED_METADATA, _as_text(rejected))
    log.close()


def _as_text(counts: Mapping[str, int]) -> dict[str, str]:
    return {name: str(count) for name, count in counts.items()}


def record_failures(path: Path, failures: Sequence[str]) -> None:
    """Write the failures that ended a run into its recording, even a partial one, for the judge."""
    for file in (path, partial_path(path)):
        if failures and file.is_file() and not file.is_symlink():
            try:
                record_afterwards(
                    file, FAILURES_METADATA, {str(i): f for i, f in enumerate(failures)}
                )
            except OSError as error:
                logger.warning(
                    "%s: what failed could not be written to it: %s", file, error.strerror
                )


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
