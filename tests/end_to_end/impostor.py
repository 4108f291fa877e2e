"""Somebody on the bus who speaks as the plant and as a recorder, by way of the plant."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import AbstractContextManager
from typing import Any

from running import PAPER_ARM_JOINTS, Running

from bus_schema.messages import topics
from bus_schema.messages.record import Record
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import Role, Topic
from bus_schema.zenoh.access import bundle_key_expression, recorded_key_expression
from bus_schema.zenoh.bundles import HEAD, Span
from bus_schema.zenoh.ros_graph import (
    Attachment,
    Entity,
    EntityKind,
    endpoint_gid,
    graph_key_expression,
    node_name,
    node_token,
)
from bus_schema.zenoh.session import Delivery, ZenohSession
from tests.waiting import await_true

OWN_ID = b"x" * 16
FORGED_END = RunEvent(
    3_600_000_000_000, Role.PLANT, EventKind.ENDED, json.dumps({"ticks": 10, "completed": True})
).encode()


def bundle_of(*messages: tuple[Topic, bytes, bytes]) -> bytes:
    """Topic, payload and attachment of each as loops put them into a bundle."""
    return b"".join(
        HEAD.pack(len(topic.name), len(attachment), len(payload))
        + topic.name.encode() + attachment + payload
        for topic, payload, attachment in messages
    )  # fmt: skip


class Impostor(AbstractContextManager["Impostor"]):
    """A client of the plant, which is its router: so a recorder gets what it sends."""

    def __init__(self, endpoint: str, security: Mapping[str, Any] | None = None) -> None:
        settings = {"mode": "client", **(security or {})}
        self.session = ZenohSession([], [endpoint], low_latency=False, security=settings)
        self.truth: Delivery | None = None
        self.state: Delivery | None = None
        self.spans: list[Span] = []
        self._publishers: dict[str, bytes] = {}
        self.session.subscribe(topics.PLANT_TRUTH.key_expression(0), self._hear)
        self.session.subscribe(topics.JOINT_STATES.key_expression(0), self._hear_state)
        self.session.subscribe(bundle_key_expression(0, Role.PLANT), self._hear_bundle)
        self.session.watch_tokens(graph_key_expression(0), self._on_token)

    def await_plant(self, run: Running) -> None:
        """Until all is known that a forgery needs."""

        def is_known() -> bool:
            assert run.process.poll() is None, run.end().output
            return self.truth is not None and bool(self.spans) and len(self._publishers) == 2

        await_true(is_known, "the plant speaks")

    def speak_as_plant(self, truth: Delivery | None, sender: bytes, number: int) -> None:
        """Send a received truth again, and an end; in a bundle, and by themselves."""
        truth = truth or Delivery(b"made up", b"")
        known = Attachment.decode(truth.attachment)
        gid = known.gid if known is not None and sender != OWN_ID else OWN_ID
        messages = [
            (topics.PLANT_TRUTH, truth.payload, Attachment(1, 0, gid).encode()),
            (topics.RUN_EVENTS, FORGED_END, Attachment(1, 0, gid).encode()),
        ]
        for role in (Role.PLANT, Role.CONTROLLER):
            key = bundle_key_expression(0, role)
            span = Span(number, number, sender).encode()
            self.session.publisher(key).put(bundle_of(*messages), span)
        for topic, payload, attachment in messages:
            self.session.publisher(topic.key_expression(0)).put(payload, attachment)

    def forge_states(self, count: int, later_ns: int) -> None:
        """Send states as the plant does, with other positions, for a time that is to come."""
        publisher = self.session.publisher(topics.JOINT_STATES.key_expression(0))
        layout = topics.layout(topics.JOINT_STATES, PAPER_ARM_JOINTS)
        record = Record(layout)
        for _ in range(count):
            assert self.state is not None
            record.stamp_ns = layout.decode(self.state.payload, record) + later_ns
            record.fields["position"][:] += 0.3
            publisher.put(record.payload(), self.state.attachment)

    def speak_as_recorder(self) -> None:
        """Announce a recorder that has everything."""
        name = node_name(Role.RECORDER)
        self.session.announce(node_token(0, self.session.identifier, name))
        for gid in self._publishers.values():
            own = self.session.identifier
            self.session.announce(recorded_key_expression(0, gid.hex(), own))

    def __exit__(self, *_: object) -> None:
        self.session.close()

    def _hear(self, delivery: Delivery) -> None:
        self.truth = delivery

    def _hear_state(self, delivery: Delivery) -> None:
        self.state = delivery

    def _hear_bundle(self, delivery: Delivery) -> None:
        span = Span.decode(delivery.attachment)
        if span is not None:
            self.spans.append(span)

    def _on_token(self, token: str, alive: bool) -> None:
        """Remember the ids under which both loops send events."""
        entity = Entity.from_token(token)
        is_publisher = entity is not None and entity.kind == EntityKind.PUBLISHER
        if alive and is_publisher and entity.topic == topics.RUN_EVENTS.name:
            self._publishers[entity.node] = endpoint_gid(token)
