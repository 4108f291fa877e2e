"""Robot client of openpi's policy server: msgpack with NumPy arrays, over a websocket."""

from __future__ import annotations

import contextlib
import reprlib
import socket
import time
from collections.abc import Iterator, Sized
from typing import Any

import numpy as np

from bus_schema.configuration import StrictModel
from controller.policies.client import (
    MOST_BYTES,
    NoAnswerError,
    Observation,
    PolicyClient,
    PolicyServerError,
    Robot,
    ServerGoneError,
    Text,
)

_MOST_ENTRIES = 1_000_000
_MOST_LETTERS = 200
_TOO_BIG = 1009
"""Code with which a side closes a websocket because a message is too long."""


class OpenPiSettings(StrictModel):
    """openpi's policy server (``scripts/serve_policy.py``): names in its messages.

    Attributes:
        state_key: of the state.
        actions_key: of the actions in an answer.
        task_key: of the task.
    """

    state_key: Text = "observation/state"
    actions_key: Text = "actions"
    task_key: Text = "prompt"


class OpenPiClient(PolicyClient):
    """A connection to openpi's policy server.

    Args:
        place: ``host:port``.
        settings: names of the values in its messages.
        robot: whose policy it is.
    """

    def __init__(self, place: str, settings: OpenPiSettings, robot: Robot) -> None:
        self._place, self._settings, self._robot = place, settings, robot
        self._socket: Any = None
        self._open = contextlib.ExitStack()
        self._is_sending = False

    def connect(self, timeout_s: float) -> None:
        from websockets.exceptions import WebSocketException
        from websockets.sync.client import connect

        try:
            opened = connect(
                f"ws://{self._place}", compression=None, max_size=MOST_BYTES, max_queue=1,
                open_timeout=timeout_s, close_timeout=1.0,
                ping_interval=None,  # a server that loads its policy may not answer pings
            )  # fmt: skip
            self._socket = self._open.enter_context(opened)
        except (OSError, WebSocketException) as error:  # a time-out is an OSError
            raise ServerGoneError(f"is not reachable: {error}") from None
        _unpacked(self._received(timeout_s))  # the server's metadata

    def ask(self, observation: Observation, timeout_s: float) -> object:
        import msgpack

        settings, until_s = self._settings, time.monotonic() + timeout_s
        state = np.array(observation.state, dtype=np.float32)
        values: dict[str, object] = {settings.state_key: state, **observation.images}
        if observation.task:
            values[settings.task_key] = observation.task
        message = msgpack.packb(values, default=_as_map)
        with _errors_of_connection(timeout_s):
            self._send(message, timeout_s)
        answer = self._received(timeout_s, until_s)
        if isinstance(answer, str):
            raise PolicyServerError(f"it reports an error: {_end_of(answer)}")
        found = _unpacked(answer)
        if not isinstance(found, dict) or settings.actions_key not in found:
            has = ", ".join(map(str, found)) if isinstance(found, dict) else reprlib.repr(found)
            has = has[:_MOST_LETTERS]
            raise PolicyServerError(f"its answer has no {settings.actions_key}, but {has}")
        return found[settings.actions_key]

    def close(self) -> None:
        with contextlib.suppress(Exception):  # it may be broken
            if self._is_sending:  # which would block the farewell
                self._socket.socket.shutdown(socket.SHUT_RDWR)
            self._open.close()

    def _send(self, message: bytes, timeout_s: float) -> None:
        self._socket.socket.settimeout(timeout_s)  # of sending the whole message
        self._is_sending = True
        try:
            self._socket.send(message)
        finally:
            self._is_sending = False

    def _received(self, timeout_s: float, until_s: float | None = None) -> Any:
        left_s = timeout_s if until_s is None else max(0.0, until_s - time.monotonic())
        with _errors_of_connection(timeout_s):
            return self._socket.recv(left_s)


@contextlib.contextmanager
def _errors_of_connection(timeout_s: float) -> Iterator[None]:
    """Turn errors of a websocket into ones of this package."""
    from websockets.exceptions import ConnectionClosed

    try:
        yield
    except TimeoutError:
        raise NoAnswerError(f"did not answer within {timeout_s:g} s") from None
    except ConnectionClosed as error:
        if isinstance(error.__cause__, TimeoutError):
            message = f"did not read the observation within {timeout_s:g} s"
            raise NoAnswerError(message) from None
        if error.sent is not None and error.sent.code == _TOO_BIG:
            message = f"its answer is larger than {MOST_BYTES} bytes"
            raise PolicyServerError(message) from None
        raise ServerGoneError(f"closed the connection: {error}") from None


def _as_map(value: object) -> object:
    """Return an array as openpi packs it."""
    if isinstance(value, np.ndarray):
        return {
            b"__ndarray__": True, b"data": value.tobytes(), b"dtype": value.dtype.str,
            b"shape": value.shape,
        }  # fmt: skip
    raise TypeError(f"cannot pack {type(value).__name__}")


def _as_array(values: dict[Any, Any]) -> object:
    """Return the array or number that openpi packed; other maps as they are."""
    if b"__ndarray__" in values:
        return np.frombuffer(values[b"data"], _dtype(values)).reshape(values[b"shape"])
    if b"__npgeneric__" in values:
        return _dtype(values).type(values[b"data"])
    return values


def _dtype(values: dict[Any, Any]) -> np.dtype[Any]:
    """Return the type that openpi packed, which must be one of numbers."""
    name = values[b"dtype"]
    dtype: np.dtype[Any] | None = np.dtype(name[:8]) if isinstance(name, str) else None
    if dtype is None or dtype.kind not in "biuf":
        raise ValueError(f"values of type {reprlib.repr(name)}")
    return dtype


class _Entries:
    """Counts the entries of lists and maps in a message, which take more memory than its bytes."""

    def __init__(self) -> None:
        self._left = _MOST_ENTRIES

    def of_list(self, values: list[Any]) -> list[Any]:
        self._count(values)
        return values

    def of_map(self, values: dict[Any, Any]) -> object:
        self._count(values)
        return _as_array(values)

    def _count(self, values: Sized) -> None:
        self._left -= 1 + len(values)
        if self._left < 0:
            raise ValueError(f"more than {_MOST_ENTRIES} entries")


def _unpacked(data: Any) -> object:
    import msgpack

    if isinstance(data, str):
        raise PolicyServerError(f"it reports an error: {_end_of(data)}")
    try:
        entries = _Entries()
        return msgpack.unpackb(
            data, object_hook=entries.of_map, list_hook=entries.of_list,
            max_array_len=_MOST_ENTRIES, max_map_len=_MOST_ENTRIES,
        )  # fmt: skip
    except Exception as error:  # damaged messages raise almost anything
        reason = f"{type(error).__name__}: {error}"[:_MOST_LETTERS]
        raise PolicyServerError(f"its answer cannot be read: {reason}") from error


def _end_of(report: str) -> str:
    """Return the last line of a report, which is the exception of a traceback."""
    lines = [line.strip() for line in report.splitlines() if line.strip()]
    return lines[-1][-_MOST_LETTERS:] if lines else "without a text"
