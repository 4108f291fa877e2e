"""A link over Zenoh for the link probe, with the settings of a loop in real time."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from collections.abc import Sequence

from bus_schema.zenoh.node import REALTIME_LEASE_S
from bus_schema.zenoh.session import ZenohSession
from deploy.measure.probe_frames import LEAST_BYTES, ProbeFrame

_QUESTIONS, _ANSWERS = "funnel_hil/link_probe/questions", "funnel_hil/link_probe/answers"
_HELLO_S = 0.05
_MOST_WAITING = 1000


class ZenohSocket(socket.socket):
    """A Zenoh session that behaves like a UDP socket, so that `select` can wait for it.

    Frames of all clients go to the server, and all its answers to each of them.

    Args:
        key: of the messages that it receives.
        sends: key of those that it sends.
        listen: endpoints to serve.
        connect: endpoints to connect to.
    """

    def __init__(
        self, key: str, sends: str, listen: Sequence[str] = (), connect: Sequence[str] = ()
    ) -> None:
        self._session = ZenohSession(
            listen, connect, low_latency=True, patience_s=0.0, lease_s=REALTIME_LEASE_S
        )
        near, self._arrivals = socket.socketpair(type=socket.SOCK_DGRAM)
        super().__init__(fileno=near.detach())
        self._arrivals.setblocking(False)
        self._publisher = self._session.publisher(sends)
        self._inbox = self._session.inbox(key, _MOST_WAITING, lossless=True)
        self._thread = threading.Thread(target=self._pass_on, daemon=True)
        self._thread.start()

    def sendall(self, data: bytes, flags: int = 0) -> None:  # type: ignore[override]  # noqa: ARG002
        """Publish a message."""
        self._publisher.put(data, b"")

    def close(self) -> None:
        self._inbox.knock()
        self._thread.join()  # if it leaves Zenoh while Python exits, the process aborts
        self._session.close()
        self._arrivals.close()
        super().close()

    def _pass_on(self) -> None:
        while (delivery := self._inbox.wait()) is not None:
            with contextlib.suppress(BlockingIOError):  # not read: lost, as with UDP
                self._arrivals.send(delivery.payload)


def zenoh_server(port: int) -> ZenohSocket:
    """Receive frames from all clients.

    Raises:
        SessionError: the port cannot be served.
    """
    return ZenohSocket(_QUESTIONS, _ANSWERS, listen=[f"tcp/0.0.0.0:{port}"])


def zenoh_client(host: str, port: int, timeout_s: float) -> ZenohSocket:
    """Connect to a server, and wait until messages pass in both directions.

    Raises:
        TimeoutError: there is no answer.
        SessionError: the endpoint is malformed.
    """
    way = ZenohSocket(_ANSWERS, _QUESTIONS, connect=[f"tcp/{host}:{port}"])
    give_up_s = time.monotonic() + timeout_s
    while time.monotonic() < give_up_s:
        way.sendall(ProbeFrame(LEAST_BYTES, 0, 0, 0, 0).encode())
        if select.select([way], [], [], _HELLO_S)[0]:
            return way
    way.close()
    raise TimeoutError("no answer over Zenoh")
