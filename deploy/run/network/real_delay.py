"""A real delay for `run`: its requirements, and the relay between controller and plant.

The plant listens, and only the controller connects: it gets the relay's endpoint instead of the
plant's. Sessions do not discover each other (`bus_schema.zenoh.session`), so nothing bypasses the
relay; the recorder has separate connections.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

from bus_schema.link.channel_configuration import ChannelConfiguration
from bus_schema.link.configuration import LinkConfiguration
from deploy.run.network.links import free_ports
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import ScenarioError
from plant_emulator.channel.channel import Channel
from plant_emulator.channel.opening import open_downlink, open_uplink

RELAY = "relay"
"""Name of the process."""
LONGEST_MS = 1000.0
_PROTOCOLS = ("tcp", "tls")


class RelayOptions(NamedTuple):
    """Options of a relay.

    Attributes:
        listen: HOST:PORT where connections or datagrams come in.
        connect: HOST:PORT that they are passed on to.
        link: what it does to them: ``downlink`` on the way there, ``uplink`` on the way back.
        seed: of all that is random.
        is_udp: whether it relays UDP, and not TCP.
        duration_s: how long, unless it is stopped before.
    """

    listen: str
    connect: str
    link: LinkConfiguration
    seed: int = 0
    is_udp: bool = False
    duration_s: float = math.inf


def host_and_port(text: str) -> tuple[str, int]:
    """Host and port of HOST:PORT.

    Raises:
        ScenarioError: it is something else.
    """
    host, _, port = text.rpartition(":")
    if not (host and port.isdecimal() and 0 < int(port) < 1 << 16):
        raise ScenarioError(f"{text!r}: must be HOST:PORT such as 127.0.0.1:7453")
    return host.strip("[]"), int(port)


class RealDelay(NamedTuple):
    """A real delay between controller and plant.

    Attributes:
        round_trip_ms: sum of the delays in both directions.
        endpoint: endpoint for the controller: the relay's.
        plant_endpoint: the plant's endpoint, for the relay.
    """

    round_trip_ms: float
    endpoint: str
    plant_endpoint: str

    @property
    def options(self) -> RelayOptions:
        """Options of the relay."""
        here, there = (each.partition("/")[2] for each in (self.endpoint, self.plant_endpoint))
        each_way = ChannelConfiguration(delay_ms=0.5 * self.round_trip_ms)
        return RelayOptions(here, there, LinkConfiguration(uplink=each_way, downlink=each_way))

    @property
    def override(self) -> str:
        """Override that makes a controller connect to the relay."""
        return f"link.plant_endpoint={self.endpoint}"


def check_real_delay(setup: Setup, round_trip_ms: float) -> None:
    """Check that a scenario can be run with such a delay.

    Raises:
        ScenarioError: it cannot.
    """
    scenario, link = setup.scenario, setup.scenario.link
    if not (math.isfinite(round_trip_ms) and 0.0 <= round_trip_ms <= LONGEST_MS):
        raise ScenarioError(
            f"--real-delay {round_trip_ms:g}: must be a round trip of 0 to {LONGEST_MS:g} ms"
        )
    protocol = link.plant_endpoint.partition("/")[0]
    needs = (
        ("link.kind", link.kind, link.kind == "zenoh", "zenoh"),
        ("clock", scenario.clock, scenario.clock == "realtime",
         "realtime, because virtual time waits for every message"),
        ("link.plant_endpoint", link.plant_endpoint, protocol in _PROTOCOLS,
         "tcp/ or tls/, the protocols of the relay"),
        ("link.router_endpoint", link.router_endpoint, link.router_endpoint is None,
         "left out, because messages could bypass the relay"),
        *((f"link.{name}.pattern", given.pattern.model_dump(exclude_defaults=True), False,
           "left out")
          for name, given in (("uplink", link.uplink), ("downlink", link.downlink))
          if given.pattern is not None),
    )  # fmt: skip
    for key, value, is_met, allowed in needs:
        if not is_met:
            raise ScenarioError(
                f"{setup.origin.of(key)}: {key} = {value!r}: must be {allowed} (with --real-delay)"
            )


def knowing_real_delay(setup: Setup, round_trip_ms: float) -> Setup:
    """Return the scenario with a deadline and a controller that allow for the real delay.

    By default both follow from the link's delays, which do not include this one. Values given in
    the scenario are not changed.
    """
    scenario = setup.scenario
    controller = scenario.controller
    settings = controller.delay_compensation
    if settings.expected_round_trip_ms is None:
        tick_ms = setup.grid.period_ns * 1e-6  # of the bus and its processes
        expected_ms = scenario.link.emulated_round_trip_ns * 1e-6 + round_trip_ms + tick_ms
        settings = settings.model_copy(update={"expected_round_trip_ms": expected_ms})
        controller = controller.model_copy(update={"delay_compensation": settings})
    update = {"controller": controller, "link": _knowing_real_delay(setup, round_trip_ms)}
    return replace(setup, scenario=scenario.model_copy(update=update))


def _knowing_real_delay(setup: Setup, round_trip_ms: float) -> LinkConfiguration:
    scenario, link = setup.scenario, setup.scenario.link
    if link.deadline_ms is not None or setup.link.plays_automatically:
        return link
    uplink: Channel[Any] = open_uplink(link, scenario.seed)
    downlink = open_downlink(link, scenario.seed)
    mean_ns = uplink.mean_delay_ns + downlink.mean_delay_ns + round(round_trip_ms * 1e6)
    deadline_ns = link.deadline_ns(
        setup.answer_every * setup.grid.period_ns, max(mean_ns, link.playout_ns)
    )
    return link.model_copy(update={"deadline_ms": deadline_ns * 1e-6})


def real_delay(setup: Setup, round_trip_ms: float) -> RealDelay:
    """Return the relay for a scenario with its final endpoints: at a free port."""
    plant_endpoint = setup.scenario.link.plant_endpoint
    (port,) = free_ports(1)
    endpoint = f"{plant_endpoint.rpartition(':')[0]}:{port}"
    return RealDelay(round_trip_ms, endpoint, plant_endpoint)
