"""TCP connections of a robot server, in one thread: none of them ends it."""

from __future__ import annotations

import contextlib
import selectors
import socket
import struct
from collections.abc import Callable, Mapping

_CHUNK_BYTES = 1 << 16

Receive = Callable[[bytes], None]


def is_open(client: socket.socket) -> bool:
    """Return whether a connection has not been closed here; nobody obeys one that has."""
    return client.fileno() >= 0


class TcpClients:
    """Listens at ports, and passes on what their clients send.

    Args:
        accept: called with each new connection and the name of its port; what it returns takes the
            connection's bytes. A ValueError of that closes the connection.
        leave: called with each connection that has ended.
        say: called with the reason for which a connection is closed.
    """

    def __init__(
        self,
        accept: Callable[[socket.socket, str], Receive],
        leave: Callable[[socket.socket], None],
        say: Callable[[str], None],
    ) -> None:
        self._accept_as, self._leave, self._say = accept, leave, say
        self._selector = selectors.DefaultSelector()

    def open(self, host: str, ports: Mapping[str, int]) -> None:
        """Listen; raises `OSError` if a port is taken."""
        for name, port in ports.items():
            listener = socket.create_server((host, port))
            listener.setblocking(False)
            self._selector.register(listener, selectors.EVENT_READ, name)

    def add(self, reader: socket.socket, receive: Callable[[], None]) -> None:
        """Also call a function when another socket can be read."""
        self._selector.register(reader, selectors.EVENT_READ, receive)

    def serve(self, timeout_s: float) -> None:
        """Wait until something can be read, or the time is over; take it."""
        for key, _ in self._selector.select(max(0.0, timeout_s)):
            assert isinstance(key.fileobj, socket.socket)
            if isinstance(key.data, str):
                self._accept(key.fileobj, key.data)
            elif key.fileobj.type == socket.SOCK_DGRAM:
                key.data()
            else:
                self._read(key.fileobj, key.data)

    def send(self, client: socket.socket, data: bytes) -> bool:
        """Send bytes; a client that does not read them is closed. Return whether it is open."""
        try:
            sent = client.send(data)
        except OSError:
            sent = 0
        if sent < len(data):
            self.forget(client)
        return is_open(client)

    def forget(self, client: socket.socket) -> None:
        """Close a connection."""
        try:
            self._selector.unregister(client)
        except (KeyError, ValueError):  # it has been closed
            return
        client.close()
        self._leave(client)

    def close(self) -> None:
        """Close everything."""
        for key in list(self._selector.get_map().values()):
            assert isinstance(key.fileobj, socket.socket)
            key.fileobj.close()
        self._selector.close()

    def _accept(self, listener: socket.socket, port: str) -> None:
        try:
            client, _ = listener.accept()
        except OSError:
            return
        client.setblocking(False)
        with contextlib.suppress(OSError):  # it may have gone already
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._selector.register(client, selectors.EVENT_READ, None)
        receive = self._accept_as(client, port)
        with contextlib.suppress(KeyError, ValueError):  # it may have been closed
            self._selector.modify(client, selectors.EVENT_READ, receive)

    def _read(self, client: socket.socket, receive: Receive) -> None:
        try:
            data = client.recv(_CHUNK_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self.forget(client)
            return
        try:
            receive(data)
        except (ValueError, struct.error) as error:
            self._say(f"connection closed: {error}")
            self.forget(client)
