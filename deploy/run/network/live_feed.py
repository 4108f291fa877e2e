"""Connection from a recorder to viewers: a local socket in a folder that only this user can enter.

Viewers are not on the bus, where a frozen one would delay senders. A viewer connects to the
recorder's socket, and the recorder sends it a packet for each snapshot if there is room. A slow,
frozen or vanished viewer delays no process.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import socket
import stat
import tempfile
import time
from pathlib import Path

from deploy.run.network.snapshot import Message, Sampler, Snapshot

_HELLO = b"funnel-hil: "
_BUFFER_BYTES = 1 << 20
_RETRY_S = 0.1
_MOST_VIEWERS = 8
_MOST_ACCEPTED = 50
"""Connections accepted per check, so that viewers cannot keep the recorder from its work."""
_MOST_TRIES = 10
"""Attempts to create a folder that other processes may remove when they end."""
_LONGEST_FOLDER = 60
"""The path of a socket may have 107 characters."""


class LiveFeed:
    """A recorder's end. Without viewers it does nothing.

    Args:
        endpoint: the plant's endpoint, by which viewers find the recorder.
        scenario: file of the scenario in force.
        joint_names: of the robot.

    Attributes:
        dropped: snapshots for which a viewer's buffer had no room.

    Raises:
        OSError: there is no place for its socket.
    """

    def __init__(self, endpoint: str, scenario: Path, joint_names: tuple[str, ...]) -> None:
        self._hello = _HELLO + json.dumps(str(scenario)).encode()
        self._names = joint_names
        self._socket, self._place = _listening(_name(endpoint))
        self._viewers: list[socket.socket] = []
        self._sampler: Sampler | None = None
        self.dropped = 0

    @property
    def is_watched(self) -> bool:
        """Whether there are viewers that need messages."""
        return self._sampler is not None

    def take(self, message: Message) -> None:
        """Take a recorded message."""
        if self._sampler is not None:
            self._sampler.take(message)

    def send(self) -> None:
        """Accept new viewers, and send all viewers everything since the last call."""
        self._accept()
        if self._sampler is None:
            return
        snapshot = self._sampler.snapshot()
        if snapshot is not None:
            packet = snapshot.encode()
            self._viewers = [viewer for viewer in self._viewers if self._send(packet, viewer)]
        if not self._viewers:
            self._sampler = None

    def close(self) -> None:
        """Remove the socket; viewers then know that the run is over."""
        for each in (self._socket, *self._viewers):
            each.close()
        with contextlib.suppress(OSError):
            self._place.unlink()
            self._place.parent.rmdir()  # if that was the last one

    def _accept(self) -> None:
        for _ in range(_MOST_ACCEPTED):
            try:
                viewer, _ = self._socket.accept()
            except OSError:  # no more viewers
                return
            viewer.setblocking(False)
            viewer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER_BYTES)
            if len(self._viewers) >= _MOST_VIEWERS:
                viewer.close()
            elif self._send(self._hello, viewer):
                self._viewers.append(viewer)
                self._sampler = self._sampler or Sampler(self._names)

    def _send(self, packet: bytes, viewer: socket.socket) -> bool:
        """Send a packet if there is room; return whether the viewer is still there."""
        try:
            viewer.send(packet)
        except (BlockingIOError, InterruptedError):
            self.dropped += 1
        except OSError:
            viewer.close()
            return False
        return True


class FeedReceiver:
    """A viewer's end. It connects again when its recorder has gone and another one has started.

    Args:
        endpoint: the plant's endpoint.

    Attributes:
        scenario: file of the scenario in force, once a recorder has sent it.
        is_over: the recorder was found, and has gone.

    Raises:
        PermissionError: other users can enter the folder of the sockets.
    """

    def __init__(self, endpoint: str) -> None:
        self._recorders = f"{_name(endpoint)}-*"
        self._folder = _folder()
        if self._folder.exists():
            _require_private(self._folder)
        self._socket: socket.socket | None = None
        self.scenario: Path | None = None
        self.is_over = False

    def receive(self, timeout_s: float) -> Snapshot | None:
        """Return the next snapshot; None if none arrives in time."""
        if self._socket is None:
            self._connect()
        if self._socket is None:
            time.sleep(timeout_s)
            return None
        self._socket.settimeout(timeout_s)
        try:
            packet = self._socket.recv(_BUFFER_BYTES)
        except TimeoutError:
            return None
        except ConnectionError:
            packet = b""
        if not packet:
            self.close()
            time.sleep(min(timeout_s, _RETRY_S))  # it may refuse another viewer at once
            self._connect()
        elif packet.startswith(_HELLO):
            self.scenario = Path(json.loads(packet[len(_HELLO) :]))
        else:
            return Snapshot.decode(packet)
        return None

    def close(self) -> None:
        """Leave the recorder."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _connect(self) -> None:
        """Connect to a recorder of this run, if there is one."""
        self.is_over = self.scenario is not None
        for place in self._folder.glob(self._recorders):
            made = _new_socket()
            try:
                made.connect(str(place))
            except OSError as error:
                made.close()
                if isinstance(error, BlockingIOError):  # exists, but is busy
                    self.is_over = False
            else:
                self._socket, self.is_over = made, False
                return


def clear_left_behind() -> None:
    """Remove the sockets of killed processes."""
    folder = _folder()
    with contextlib.suppress(OSError):
        _clear(folder)
        folder.rmdir()  # unless others use it


def _name(endpoint: str) -> str:
    """Return the common name of the sockets of a plant's recorders, as short as possible."""
    return hashlib.sha256(endpoint.partition("/")[2].encode()).hexdigest()[:16]


def _new_socket() -> socket.socket:
    made = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    made.setblocking(False)
    return made


def _listening(name: str) -> tuple[socket.socket, Path]:
    """Return a listening socket in the user's folder; remove those of dead processes."""
    folder = _folder()
    for _ in range(_MOST_TRIES):
        with contextlib.suppress(FileNotFoundError):  # another process removed it when it ended
            folder.mkdir(mode=0o700, exist_ok=True)
            _require_private(folder)
            _clear(folder)
            return _listening_in(folder, name)
    raise FileNotFoundError(f"{folder}: another program keeps removing it")


def _require_private(folder: Path) -> None:
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise PermissionError(f"{folder}: is not a folder that only this user can access")


def _listening_in(folder: Path, name: str) -> tuple[socket.socket, Path]:
    made = _new_socket()
    own = f"{name}-{os.getpid()}-{made.fileno()}"
    place, unready = folder / own, folder / f".{own}"
    try:
        made.bind(str(unready))
        made.listen()
        unready.rename(place)  # until it listens, it looks like one of a dead process
    except OSError:
        made.close()
        raise
    return made, place


def _folder() -> Path:
    parent = os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()
    if len(parent) > _LONGEST_FOLDER or not os.access(parent, os.W_OK):
        parent = "/tmp"
    return Path(parent) / f"funnel-hil-{os.getuid()}"


def _clear(folder: Path) -> None:
    """Remove the sockets of killed processes; others keep files of their own in this folder."""
    for place in (each for each in folder.iterdir() if each.is_socket()):
        if place.name.startswith("."):
            continue  # it does not listen yet
        with _new_socket() as probe:
            try:
                probe.connect(str(place))
            except ConnectionRefusedError:
                place.unlink(missing_ok=True)
            except OSError:
                continue
