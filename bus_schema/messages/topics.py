"""The table of topics: name, type, sender, rate and QoS."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from bus_schema.messages import types as message_types
from bus_schema.messages.layout import MessageLayout


class Role(StrEnum):
    """Roles of the processes on the bus."""

    CONTROLLER = "controller"
    PLANT = "plant"
    RECORDER = "recorder"


class Rate(StrEnum):
    """Occasion at which a topic is sent."""

    TICK = "every tick"
    PICTURE = "as often as a viewer draws"
    EVENT = "when something happens"


@dataclass(frozen=True)
class Topic:
    """One row of the table.

    Attributes:
        name: ROS 2 topic name without slashes.
        type_name: ROS 2 interface name.
        sender: the only role that may send it; None where controller and plant both may.
        rate: when it is sent.
        urgent: whether it is sent at once; topics for recorders alone may be sent in batches.
        depth: how many messages are kept (QoS: reliable, keep last).
        latched: whether late subscribers get them too (ROS 2: transient local).
    """

    name: str
    type_name: str
    sender: Role | None
    rate: Rate
    urgent: bool = False
    depth: int = 10
    latched: bool = False

    @property
    def paces(self) -> bool:
        """Whether recorders report progress to the sender by this topic; each sender has one."""
        return self.rate is Rate.TICK and not self.urgent

    @property
    def qos(self) -> str:
        """QoS in rmw_zenoh's format for liveliness tokens."""
        return f":{1 if self.latched else ''}:,{self.depth}:,:,:,,"

    @property
    def dds_type(self) -> str:
        package, _, name = self.type_name.split("/")
        return f"{package}::msg::dds_::{name}_"

    def key_expression(self, domain: int) -> str:
        """Return the Zenoh key of this topic in a ROS domain, as rmw_zenoh forms it."""
        return f"{domain}/{self.name}/{self.dds_type}/{message_types.type_hash(self.type_name)}"


JOINT_STATES = Topic("joint_states", message_types.JOINT_STATE, Role.PLANT, Rate.TICK, urgent=True)
JOINT_COMMANDS = Topic(
    "joint_commands", message_types.JOINT_STATE, Role.CONTROLLER, Rate.TICK, urgent=True
)
JOINT_REFERENCE = Topic(
    "joint_reference", message_types.JOINT_STATE, Role.PLANT, Rate.TICK, urgent=True
)
PLANT_STATUS = Topic("plant_status", message_types.PLANT_STATUS, Role.PLANT, Rate.TICK, urgent=True)
PLANT_TRUTH = Topic("plant_truth", message_types.PLANT_TRUTH, Role.PLANT, Rate.TICK)
CONTROL_STATUS = Topic("control_status", message_types.CONTROL_STATUS, Role.CONTROLLER, Rate.TICK)
RUN_EVENTS = Topic("run_events", message_types.RUN_EVENT, None, Rate.EVENT)

TOPICS = (
    JOINT_STATES,
    JOINT_COMMANDS,
    JOINT_REFERENCE,
    PLANT_STATUS,
    PLANT_TRUTH,
    CONTROL_STATUS,
    RUN_EVENTS,
)

REJECTED_COMMANDS = Topic(
    "rejected_commands", message_types.JOINT_STATE, Role.CONTROLLER, Rate.TICK, urgent=True
)
"""Commands of other senders than the commander. They are recorded, but part of no result."""
CLOCK = Topic("clock", message_types.CLOCK, Role.PLANT, Rate.TICK, urgent=True, depth=1)
"""Sent with every state, for nodes with ``use_sim_time``; not recorded."""
ROBOT_DESCRIPTION = Topic(
    "robot_description", message_types.STRING, Role.RECORDER, Rate.EVENT, depth=1, latched=True
)
TF_STATIC = Topic(
    "tf_static", message_types.TF_MESSAGE, Role.RECORDER, Rate.EVENT, depth=1, latched=True
)
TF = Topic("tf", message_types.TF_MESSAGE, Role.RECORDER, Rate.PICTURE, urgent=True, depth=100)
VIEW_TOPICS = (ROBOT_DESCRIPTION, TF_STATIC, TF)
"""Topics for 3-D viewers; they follow from the arm and `JOINT_STATES`, and no run reads them."""


def topics_of(role: Role) -> list[Topic]:
    """Return the topics that a role may send to the loops; a recorder sends none."""
    if role is Role.RECORDER:
        return []
    return [topic for topic in (*TOPICS, CLOCK) if topic.sender in (role, None)]


def layout(
    topic: Topic,
    joint_names: tuple[str, ...],
    *,
    has_targets: bool = False,
    has_acting_time: bool = False,
    rows: int = 1,
    row_ticks: int = 1,
) -> MessageLayout:
    """Return the wire layout of a fixed-size topic for a robot with these joints.

    A command carries torques alone, unless it `has_targets`: positions and velocities for drives
    that close their own loop (see `bus_schema.drive_feedback`). From a foreign sender it may have
    rows for the following ticks too. A command that `has_acting_time` says when it acts, and one of
    our own may have `rows` to be written one after the other, `row_ticks` apart. A reference has no
    torques.
    """
    if topic.type_name == message_types.RUN_EVENT:
        raise ValueError(f"{topic.name} has no fixed layout")
    return MessageLayout(
        topic.type_name,
        len(joint_names) * (rows if topic is JOINT_COMMANDS else 1),
        lengths=_empty_fields(topic, has_targets=has_targets),
        strings={"name": joint_names} if topic.type_name == message_types.JOINT_STATE else None,
        may_have_rows=topic is JOINT_COMMANDS,
        has_acting_time=has_acting_time and topic is JOINT_COMMANDS,
        row_ticks=row_ticks,
    )


def _empty_fields(topic: Topic, *, has_targets: bool) -> dict[str, int] | None:
    if topic is JOINT_REFERENCE:
        return {"effort": 0}
    if topic is JOINT_COMMANDS and not has_targets:
        return {"position": 0, "velocity": 0}
    return None
