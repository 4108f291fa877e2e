"""Robot client of openpi's policy server: msgpack with NumPy arrays, over a websocket."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np

from bus_schema.configuration import StrictModel
from controller.policies.client import (
    NoAnswerError,
    Observation,
    PolicyClient,
    PolicyServerError,
    Robot,
    ServerGoneError,
    Text,
)


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

    def connect(self, timeout_s: float) -> None:
        from websockets.exceptions import WebSocketException
        from websockets.sync.client import connect

        try:
            opened = connect(
                f"ws://{self._place}", compression=None, max_size=None, open_timeout=timeout_s,
                close_timeout=1.0,
            )  # fmt: skip
            self._socket = self._open.enter_context(opened)
        except (OSError, WebSocketException) as error:  # a time-out is an OSError
            raise ServerGoneError(f"is not reachable: {error}") from None
        _unpacked(self._received(timeout_s))  # the server's metadata

    def ask(self, observation: Observation, timeout_s: float) -> object:
        import msgpack
        from websockets.exceptions import ConnectionClosed

        settings = self._settings
        state = np.array(observation.state, dtype=np.float32)
        values: dict[str, object] = {settings.state_key: state, **observation.images}
        if observation.task:
            values[settings.task_key] = observation.task
        try:
            self._socket.send(msgpack.packb(values, default=_as_map))
        except ConnectionClosed as error:
            raise ServerGoneError(f"closed the connection: {error}") from None
        answer = self._received(timeout_s)
        if isinstance(answer, str):
            raise PolicyServerError(f"it reports an error: {_end_of(answer)}")
        found = _unpacked(answer)
        if not isinstance(found, dict) or settings.actions_key not in found:
            keys = ", ".join(map(str, found)) if isinstance(found, dict) else repr(found)[:80]
            raise PolicyServerError(f"its answer has no {settings.actions_key}, but {keys}")
        return found[settings.actions_key]

    def close(self) -> None:
        with contextlib.suppress(Exception):  # it may be broken
            self._open.close()

    def _received(self, timeout_s: float) -> Any:
        from websockets.exceptions import ConnectionClosed

        try:
            return self._socket.recv(timeout_s)
        except TimeoutError:
            raise NoAnswerError(f"did not answer within {timeout_s:g} s") from None
        except ConnectionClosed as error:
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
        return _plain(np.frombuffer(values[b"data"], _dtype(values))).reshape(values[b"shape"])
    if b"__npgeneric__" in values:
        return _dtype(values).type(values[b"data"])
    return values


def _dtype(values: dict[Any, Any]) -> np.dtype[Any]:
    dtype: np.dtype[Any] = np.dtype(values[b"dtype"])
    return dtype


def _plain(array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    if array.dtype.kind not in "biuf":
        raise ValueError(f"an array of {array.dtype}")
    return array


def _unpacked(data: Any) -> object:
    import msgpack

    if isinstance(data, str):
        raise PolicyServerError(f"it reports an error: {_end_of(data)}")
    try:
        return msgpack.unpackb(data, object_hook=_as_array)
    except Exception as error:  # damaged messages raise almost anything
        raise PolicyServerError(
            f"its answer cannot be read: {type(error).__name__}: {error}"
        ) from error


def _end_of(report: str) -> str:
    """Return the last line of a report, which is the exception of a traceback."""
    lines = [line.strip() for line in report.splitlines() if line.strip()]
    return lines[-1] if lines else "without a text"
