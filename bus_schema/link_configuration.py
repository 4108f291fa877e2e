"""Section ``link`` of a scenario: which bus, where, and what it does to the messages."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from bus_schema.channel_configuration import ChannelConfiguration
from bus_schema.configuration import NonNegative, Positive, StrictModel


def _check_endpoint(text: str) -> str:
    if not re.fullmatch(r"(tcp|udp|tls|quic|ws)/\S+:\d{1,5}|unixsock-stream/\S+", text):
        raise ValueError("a Zenoh endpoint such as tcp/127.0.0.1:7451")
    return text


Endpoint = Annotated[str, AfterValidator(_check_endpoint)]


class LinkConfiguration(StrictModel):
    """The link between controller and plant.

    Attributes:
        kind: ``zenoh`` between processes, ``in_process`` within one (for ``simulate``).
        domain: ROS domain, the first part of every key.
        plant_endpoint: where the plant listens.
        controller_endpoint: where the controller listens, for recorders.
        router_endpoint: a Zenoh router that every process connects to as well, for ROS 2 tools.
        uplink: plant to controller.
        downlink: controller to plant.
        playout_ms: a command comes into force no earlier than this after the stamp of the state it
            answers, on the plant's clock; 0 for at once.
        deadline_ms: largest age of the state that the command in force answers; by default one
            period beyond the link's own mean delay, or beyond the play-out where that is longer.
        connect_timeout_s: how long a process waits for its peers at the start, wall time.
        reply_timeout_s: how long a silent peer is waited for during a run, wall time.
    """

    kind: Literal["zenoh", "in_process"] = "zenoh"
    domain: Annotated[int, Field(ge=0, le=232)] = 0
    plant_endpoint: Endpoint = "tcp/127.0.0.1:7451"
    controller_endpoint: Endpoint = "tcp/127.0.0.1:7452"
    router_endpoint: Endpoint | None = None
    uplink: ChannelConfiguration = ChannelConfiguration()
    downlink: ChannelConfiguration = ChannelConfiguration()
    playout_ms: NonNegative = 0.0
    deadline_ms: Positive | None = None
    connect_timeout_s: Positive = 20.0
    reply_timeout_s: Positive = 5.0

    @property
    def playout_ns(self) -> int:
        return round(self.playout_ms * 1e6)

    def deadline_ns(self, period_ns: int, mean_round_trip_ns: int) -> int:
        """The deadline for this tick period and what a round trip takes on average."""
        if self.deadline_ms is not None:
            return round(self.deadline_ms * 1e6)
        return period_ns + mean_round_trip_ns
