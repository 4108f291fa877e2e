"""Foxglove's WebSocket server for a run, with the bytes of the bus. The only import of foxglove.

All channels are advertised, with their schemas, before the first message, or clients would miss
some. Clients can send nothing. There is no token, as Foxglove does not support one.
"""

from __future__ import annotations

import contextlib
from typing import Any

from foxglove import Channel, Context, Schema, start_server

from bus_schema.messages import topics
from bus_schema.messages.topics import Topic
from bus_schema.messages.types import schema_text
from bus_schema.view.arm_view import ArmView
from deploy.reports.live.page_server import HOST
from deploy.run.network.snapshot import Snapshot
from deploy.scenario.setup import Setup

USUAL_PORT = 8765
"""Default port of Foxglove."""
URDF_ASSET = "package://robot.urdf"
_BACKLOG = 256
_COUNTS = "deadlines"
_COUNTS_SCHEMA = {
    "type": "object",
    "properties": {name: {"type": "integer"} for name in ("ticks", "missed")},
}


class FoxgloveServer:
    """Server of a run at 127.0.0.1; a slow client loses messages.

    Args:
        setup: the scenario.
        port: where to listen; None for the default port, or any if that is taken.

    Attributes:
        url: its address.
        is_watched: a client has subscribed to a channel.

    Raises:
        OSError: the port is taken.
    """

    def __init__(self, setup: Setup, port: int | None = None) -> None:
        self._context = Context()
        self._arm = ArmView(setup.robot)
        self._first = {topic.name: payload for topic, payload in self._arm.first()}
        self._channels = {
            topic.name: self._channel(topic) for topic in (*topics.TOPICS, *topics.VIEW_TOPICS)
        }
        self._counts = Channel(f"/{_COUNTS}", schema=_COUNTS_SCHEMA, context=self._context)
        urdf = setup.robot.resolved_urdf().encode()
        self._assets = {URDF_ASSET: urdf}
        self.is_watched = False
        self._server = self._started(setup.scenario.name, port)
        self.url = f"ws://{HOST}:{self._server.port}"

    def publish(self, snapshot: Snapshot) -> None:
        """Send new messages, and the poses of the links that follow from them."""
        for topic, stamp_ns, payload in snapshot.messages:
            self._channels[topic.name].log(payload, log_time=stamp_ns)
            if topic is topics.JOINT_STATES:
                transforms = self._arm.transforms(payload, stamp_ns)
                if transforms is not None:
                    self._channels[topics.TF.name].log(transforms, log_time=stamp_ns)
            if topic is topics.PLANT_TRUTH:
                counts = {"ticks": snapshot.ticks, "missed": snapshot.deadlines_missed}
                self._counts.log(counts, log_time=stamp_ns)

    def on_subscribe(self, _client: Any, channel: Any) -> None:
        """Send the messages that are sent only once to each new subscriber."""
        self.is_watched = True
        payload = self._first.get(channel.topic.removeprefix("/"))
        if payload is not None:
            self._channels[channel.topic.removeprefix("/")].log(payload, log_time=0)

    def on_unsubscribe(self, _client: Any, _channel: Any) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Stop serving."""
        with contextlib.suppress(Exception):
            self._server.stop()

    def _channel(self, topic: Topic) -> Channel:
        data = schema_text(topic.type_name).encode()
        schema = Schema(name=topic.type_name, encoding="ros2msg", data=data)
        return Channel(
            f"/{topic.name}", message_encoding="cdr", schema=schema, context=self._context
        )

    def _started(self, name: str, port: int | None) -> Any:
        wanted = [USUAL_PORT, 0] if port is None else [port]
        for place in wanted:
            try:
                return start_server(
                    name=f"funnel-hil {name}", host=HOST, port=place, context=self._context,
                    server_listener=self, asset_handler=self._assets.get,
                    message_backlog_size=_BACKLOG,
                )  # fmt: skip
            except RuntimeError as error:
                failure = error
        raise OSError(f"Foxglove's server cannot listen at {HOST}:{wanted[-1]}: {failure}")
