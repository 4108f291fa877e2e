"""The emulated network between a robot server and its clients: relays in threads."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from bus_schema.link.configuration import LinkConfiguration
from deploy.run.network.link_relay import Address, LinkRelay
from plant_emulator.robot_servers.robot_server import RobotServer

_LOCAL = "127.0.0.1"


class RobotNetwork:
    """Relays the traffic of a robot server.

    Args:
        link: delays and losses.
        seed: of all that is random.
    """

    def __init__(self, link: LinkConfiguration, seed: int) -> None:
        self._link, self._seed = link, seed
        self._relay: LinkRelay | None = None
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()

    def relay_port(self, outer: socket.socket) -> int:
        """Pass connections at a socket on to a free port, whose number this returns.

        The socket is closed at the end.
        """
        with socket.create_server((_LOCAL, 0)) as free:
            inner: int = free.getsockname()[1]
        self._run(LinkRelay(outer, (_LOCAL, inner), self._link, self._seed), outer)
        return inner

    def route(self, client: Address) -> Address:
        """Pass the robot's datagrams on to a client; return where the robot is to send them.

        The client before is forgotten; traces of delays go on. The robot's loop calls this, so it
        does not wait for the thread of the client before, which closes its sockets itself.
        """
        listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        listener.bind((_LOCAL, 0))
        relay = LinkRelay(listener, client, self._link, self._seed, is_from_robot=True)
        if self._relay is not None:
            relay.begun_ns = self._relay.begun_ns
        self._run(relay, listener)
        address: Address = listener.getsockname()
        return address

    def counts(self) -> dict[str, Any] | None:
        """Counts of the traffic of the newest client; None without one."""
        return None if self._relay is None else self._relay.counts()

    def close(self) -> None:
        """Stop relaying."""
        self._request_stop()
        if self._thread is not None:
            self._thread.join()

    def _request_stop(self) -> None:
        self._stop.set()
        if self._relay is not None:
            self._relay.wake()

    def _run(self, relay: LinkRelay, listener: socket.socket) -> None:
        """Relay in a thread, which closes the listener at its end, instead of the relay before."""
        self._request_stop()
        self._relay, self._stop = relay, threading.Event()
        work = (relay, listener, self._stop)
        self._thread = threading.Thread(target=_relay, args=work, daemon=True)
        self._thread.start()


def _relay(relay: LinkRelay, listener: socket.socket, stop: threading.Event) -> None:
    with listener:
        relay.run(stop.is_set)


@contextmanager
def listening(
    server: RobotServer, host: str, network: RobotNetwork | None, ports: Mapping[str, int]
) -> Iterator[None]:
    """Open a server's ports, one of them behind a network.

    Raises:
        OSError: one is taken.
    """
    try:
        if network is None:
            server.open(host, ports)
        elif not server.relayed:
            server.route = network.route
            server.open(host, ports)
        else:
            inner = network.relay_port(socket.create_server((host, ports[server.relayed])))
            server.open(_LOCAL, {server.relayed: inner})
            server.open(
                host, {name: port for name, port in ports.items() if name != server.relayed}
            )
        yield
    finally:
        if network is not None:
            network.close()
