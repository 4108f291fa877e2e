"""Robot client of LeRobot's policy server (gRPC service ``transport.AsyncInference``).

Its messages are a few bytes around a pickle, which `controller.policies.foreign_pickles` writes
and reads.
"""

from __future__ import annotations

import pickle
import reprlib
import time
from collections.abc import Iterator
from typing import Any

from google.protobuf.message import DecodeError
from google.protobuf.wrappers_pb2 import BytesValue

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
from controller.policies.foreign_pickles import pickled_instance, timed_actions

_SERVICE = "/transport.AsyncInference"
_BYTES_IN_MESSAGE = 2 * 1024 * 1024
_BEGIN, _MIDDLE, _END = 1, 2, 3
"""States of a transfer."""


class LeRobotSettings(StrictModel):
    """LeRobot's policy server (``python -m lerobot.async_inference.policy_server``).

    Attributes:
        policy_type: as LeRobot names it, such as act or smolvla; its server knows which it has.
        checkpoint: folder on the server's machine, or name on the hub.
        device: of the server.
    """

    policy_type: Text
    checkpoint: Text
    device: Text = "cpu"


class LeRobotClient(PolicyClient):
    """A connection to LeRobot's policy server.

    Args:
        place: ``host:port``.
        settings: policy that the server loads.
        robot: whose policy it is.
    """

    def __init__(self, place: str, settings: LeRobotSettings, robot: Robot) -> None:
        self._place, self._settings, self._robot = place, settings, robot
        self._channel: Any = None

    def connect(self, timeout_s: float) -> None:
        import grpc

        sizes = ("send", -1), ("receive", MOST_BYTES)
        options = [(f"grpc.max_{way}_message_length", size) for way, size in sizes]
        self._channel = grpc.insecure_channel(self._place, options)
        self._call("Ready", b"", timeout_s, waits=True)
        setup = pickled_instance("RemotePolicyConfig", self._instructions())
        self._call("SendPolicyInstructions", _message(setup), timeout_s)

    def ask(self, observation: Observation, timeout_s: float) -> object:
        until_s = time.monotonic() + timeout_s
        robot, values = self._robot, dict[str, object](observation.images)
        values |= zip(robot.state_names, map(float, observation.state), strict=True)
        if observation.task:
            values["task"] = observation.task
        sent = {
            "timestamp": 1e-9 * time.time_ns(), "timestep": observation.number,
            "observation": values,
            "must_go": True,  # or the server leaves out what resembles the one before
        }  # fmt: skip
        data = pickled_instance("TimedObservation", sent)
        self._call("SendObservations", data, timeout_s, streams=True)
        left_s = max(0.0, until_s - time.monotonic())
        answer = _data_of(self._call("GetActions", b"", timeout_s, left_s))
        if not answer:
            raise PolicyServerError(
                "it answered without actions, as it does when its policy raises (its log has the"
                " reason), or when another client has connected"
            )
        return self._actions(answer, observation.number)

    def close(self) -> None:
        if self._channel is not None:
            self._channel.close()
            self._channel = None

    def _instructions(self) -> dict[str, object]:
        robot, settings = self._robot, self._settings
        count = len(robot.state_names)
        features: dict[str, object] = {
            f"observation.images.{name}": {
                "dtype": "image", "shape": (*shape, 3), "names": ["height", "width", "channels"],
            }
            for name, shape in robot.images.items()
        }  # fmt: skip
        features["observation.state"] = {
            "dtype": "float32", "shape": (count,), "names": list(robot.state_names),
        }  # fmt: skip
        return {
            "policy_type": settings.policy_type, "device": settings.device,
            "pretrained_name_or_path": settings.checkpoint, "lerobot_features": features,
            "actions_per_chunk": robot.horizon, "rename_map": {},
        }  # fmt: skip

    def _actions(self, data: bytes, number: int) -> list[Any]:
        try:
            found = timed_actions(data)
        except pickle.UnpicklingError as error:
            raise PolicyServerError(f"its answer cannot be read: {error}") from error
        answered = found[0].timestep
        if answered != number:
            raise PolicyServerError(
                f"it answered question {reprlib.repr(answered)} instead of {number}: it must have"
                " one client at a time"
            )
        return [each.action for each in found]

    def _call(
        self, method: str, data: bytes, timeout_s: float, left_s: float | None = None, *,
        streams: bool = False, waits: bool = False,
    ) -> bytes:  # fmt: skip
        import grpc

        channel = self._channel
        if channel is None:
            raise ServerGoneError("another thread closed the connection")
        make = channel.stream_unary if streams else channel.unary_unary
        try:
            answer: bytes = make(f"{_SERVICE}/{method}", None, None)(
                _in_messages(data) if streams else data,
                timeout=timeout_s if left_s is None else left_s, wait_for_ready=waits,
            )  # fmt: skip
        except grpc.RpcError as error:
            raise _error_of(error, method, timeout_s, is_connecting=waits) from None
        except ValueError as error:  # another thread closed the channel
            raise ServerGoneError(str(error)) from None
        return answer


def _error_of(error: Any, method: str, timeout_s: float, *, is_connecting: bool) -> Exception:
    """Return the error of this package for one of grpc's."""
    code = error.code().name
    if code in ("UNAVAILABLE", "CANCELLED") or (is_connecting and code == "DEADLINE_EXCEEDED"):
        return ServerGoneError("is not reachable" if is_connecting else "closed the connection")
    if code == "DEADLINE_EXCEEDED":
        return NoAnswerError(f"did not answer {method} within {timeout_s:g} s")
    return PolicyServerError(f"{method} failed with {code}: {error.details()}")


def _in_messages(data: bytes) -> Iterator[bytes]:
    """Split a transfer into messages ``Observation``: its state, number 1, and bytes, number 2."""
    for begin in range(0, len(data), _BYTES_IN_MESSAGE):
        end = begin + _BYTES_IN_MESSAGE
        state = _END if end >= len(data) else _MIDDLE if begin else _BEGIN
        yield bytes([1 << 3, state, 2 << 3 | 2]) + _message(data[begin:end])[1:]


def _message(data: bytes) -> bytes:
    """Return a message ``PolicySetup``; like ``Actions`` it has one field, of bytes, number 1."""
    message: bytes = BytesValue(value=data).SerializeToString()
    return message


def _data_of(message: bytes) -> bytes:
    """Return the bytes in a message ``Actions``.

    Raises:
        PolicyServerError: it is another message.
    """
    try:
        data: bytes = BytesValue.FromString(message).value
    except DecodeError:
        raise PolicyServerError(f"its answer is no message Actions: {message[:24]!r}") from None
    return data
