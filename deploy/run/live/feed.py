"""Connection from a recorder to viewers: local sockets in a folder that only this user can enter.

Viewers are not on the bus, where a frozen one would delay senders. A viewer asks the recorder
repeatedly while it is open; the recorder sends it a datagram for each snapshot if there is room. A
slow, frozen or vanished viewer delays no process.
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

from deploy.run.live.snapshot import Message, Sampler, Snapshot

_ASK = b"funnel-hil: show me"
_HELLO = b"funnel-hil: "
_BUFFER_BYTES = 1 << 20
_ASK_EVERY_S = 0.5
_FORGET_S = 5.0
_MOST_VIEWERS = 8
_MOST_ASKED = 50
"""Requests read per check, so that viewers cannot keep the recorder from its work."""
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
        self._socket, self._place = _bound(_name(endpoint))
        self._viewers: dict[str, float] = {}
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
        """Read the viewers' requests, and send them everything since the last call."""
        self._hear()
        if self._sampler is None:
            return
        snapshot = self._sampler.snapshot()
        if snapshot is not None:
            datagram = snapshot.encode()
            for viewer in list(self._viewers):
                self._send(datagram, viewer)
        if not self._viewers:
            self._sampler = None

    def close(self) -> None:
        """Remove the socket; viewers then know that the run is over."""
        _remove(self._socket, self._place)

    def _hear(self) -> None:
        now_s = time.monotonic()
        for _ in range(_MOST_ASKED):
            try:
                datagram, viewer = self._socket.recvfrom(len(_ASK) + 1)
            except OSError:  # no more requests
                break
            if datagram != _ASK or not viewer:
                continue
            if viewer in self._viewers:
                self._viewers[viewer] = now_s
            elif len(self._viewers) < _MOST_VIEWERS:
                self._viewers[viewer] = now_s
                self._sampler = self._sampler or Sampler(self._names)
                self._send(self._hello, viewer)
        for viewer, heard_s in list(self._viewers.items()):
            if now_s - heard_s > _FORGET_S:
                del self._viewers[viewer]

    def _send(self, datagram: bytes, viewer: str) -> None:
        try:
            self._socket.sendto(datagram, viewer)
        except (BlockingIOError, InterruptedError):
            self.dropped += 1
        except OSError:  # the viewer has gone
            self._viewers.pop(viewer, None)


class FeedReceiver:
    """A viewer's end. Other datagrams are counted and ignored.

    Args:
        endpoint: the plant's endpoint.

    Attributes:
        scenario: file of the scenario in force, once a recorder has sent it.
        is_over: the recorder was found, and has gone.
        garbage: datagrams that were no snapshots.

    Raises:
        OSError: there is no place for its socket.
    """

    def __init__(self, endpoint: str) -> None:
        self._recorders = _name(endpoint)
        self._socket, self._place = _bound("viewer")
        self._asked_s = -_ASK_EVERY_S
        self._recorder: Path | None = None
        self.scenario: Path | None = None
        self.is_over = False
        self.garbage = 0

    def receive(self, timeout_s: float) -> Snapshot | None:
        """Return the next snapshot; None if none arrives in time."""
        if time.monotonic() - self._asked_s >= _ASK_EVERY_S:
            self._ask()
        self._socket.settimeout(timeout_s)
        try:
            datagram = self._socket.recv(_BUFFER_BYTES)
            if datagram.startswith(_HELLO):
                self.scenario = Path(json.loads(datagram[len(_HELLO) :]))
                return None
            return Snapshot.decode(datagram)
        except TimeoutError:
            return None
        except (ValueError, TypeError):
            self.garbage += 1
            return None

    def close(self) -> None:
        """Remove the socket."""
        _remove(self._socket, self._place)

    def _ask(self) -> None:
        """Send a request to the recorder that answered last, or else to any."""
        self._asked_s = time.monotonic()
        known = [] if self._recorder is None else [self._recorder]
        for place in [*known, *self._place.parent.glob(f"{self._recorders}-*")]:
            if self._is_there(place):
                self._recorder, self.is_over = place, False
                return
        self._recorder, self.is_over = None, self.scenario is not None

    def _is_there(self, recorder: Path) -> bool:
        """Send a request to a recorder; return whether it exists."""
        try:
            self._socket.setblocking(False)
            self._socket.sendto(_ASK, str(recorder))
        except BlockingIOError:  # exists, but is busy
            return True
        except OSError:
            return False
        return True


def clear_left_behind() -> None:
    """Remove the sockets of killed processes."""
    folder = _folder()
    with contextlib.suppress(OSError):
        _clear(folder)
        folder.rmdir()  # unless others use it


def _name(endpoint: str) -> str:
    """Return the common name of the sockets of a plant's recorders, as short as possible."""
    return hashlib.sha256(endpoint.partition("/")[2].encode()).hexdigest()[:16]


def _bound(name: str) -> tuple[socket.socket, Path]:
    """Return a socket of this process in the user's folder; remove those of dead processes."""
    folder = _folder()
    for _ in range(_MOST_TRIES):
        with contextlib.suppress(FileNotFoundError):  # another process removed it when it ended
            _make_private(folder)
            _clear(folder)
            return _bound_in(folder, name)
    raise FileNotFoundError(f"{folder}: another program keeps removing it")


def _make_private(folder: Path) -> None:
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise PermissionError(f"{folder}: is not a folder that only this user can access")


def _bound_in(folder: Path, name: str) -> tuple[socket.socket, Path]:
    made = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    place = folder / f"{name}-{os.getpid()}-{made.fileno()}"
    try:
        made.setblocking(False)
        made.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER_BYTES)
        made.bind(str(place))
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
    """Remove the files of killed processes."""
    for place in folder.iterdir():
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as probe:
            try:
                probe.connect(str(place))
            except ConnectionRefusedError:
                place.unlink(missing_ok=True)
            except OSError:
                continue


def _remove(made: socket.socket, place: Path) -> None:
    made.close()
    with contextlib.suppress(OSError):
        place.unlink()
        place.parent.rmdir()  # if that was the last one
