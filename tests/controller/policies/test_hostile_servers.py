"""Clients of policy servers that answer too much, too late, nothing, or something else."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import numpy as np
import pytest

from controller.policies.client import (
    NoAnswerError,
    Observation,
    PolicyServerError,
    Robot,
    ServerGoneError,
    checked_actions,
)
from controller.policies.configuration import PolicyServerConfiguration
from controller.policies.lerobot_client import LeRobotSettings
from controller.policies.openpi_client import OpenPiClient, OpenPiSettings
from controller.policies.served_policy import ServedPolicy
from tests.controller.policies.servers import LeRobotLikeServer, OpenPiLikeServer, field

pytest.importorskip("grpc", reason="needs the extra policies")
msgpack = pytest.importorskip("msgpack", reason="needs the extra policies")
pytest.importorskip("websockets", reason="needs the extra policies")

MIB = 1024 * 1024
ROBOT = Robot(["j0.pos"], {}, 1, 2)
LARGE = Observation(1, [0.0], {"front": np.zeros((4096, 4096, 3), np.uint8)}, None)
SMALL = Observation(1, [0.0], {}, None)


@pytest.fixture
def start():
    started = []

    def begin(kind, *args):
        started.append(kind(*args))
        return started[-1]

    yield begin
    for each in started:
        each.stop()


def policy_of(address, timeout_s=30.0):
    settings = PolicyServerConfiguration(
        lerobot=LeRobotSettings(policy_type="act", checkpoint="somewhere"),
        timeout_s=timeout_s, start_timeout_s=timeout_s,
    )  # fmt: skip
    return ServedPolicy(address, settings, ["j0"], 2, 0.04)


def packed_server(start, answer):
    return start(OpenPiLikeServer, lambda _: answer, msgpack.packb, msgpack.unpackb)


def error_of(server):
    policy = policy_of(server.address)
    with pytest.raises(PolicyServerError) as caught:
        policy.answer(SMALL)
    policy.close()
    message = str(caught.value)
    assert message.startswith(f"policy server {server.address}: ")
    assert len(message) < 400
    return message


def generic(dtype):
    return {"actions": {b"__npgeneric__": True, b"data": b"", b"dtype": dtype}}


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (generic("V1000000000"), "values of type 'V1000000000'"),
        (generic("O"), "values of type 'O'"),
        (generic("M8[s]"), "values of type 'M8[s]'"),
        (generic(["f4"]), "values of type ['f4']"),
        ({"actions": [[None] * 1000] * 1001}, "more than 1000000 entries"),
        ({"actions": [[]] * 1_000_000}, "more than 1000000 entries"),
        (bytes(64 * MIB + 1), "its answer is larger than 67108864 bytes"),
        ({"x" * 100_000: 1}, "has no actions, but xxx"),
        ("e" * 100_000, "it reports an error: eee"),
    ],
)
def test_hostile_answers_of_openpi_end_in_a_short_error(start, answer, message):
    server = packed_server(start, answer)
    assert message in error_of(server)


def test_too_large_answer_of_lerobot_names_its_size(start):
    server = start(LeRobotLikeServer, lambda _: field(bytes(64 * MIB)))
    assert "larger than max" in error_of(server)


def nested(depth):
    inner = []
    for _ in range(depth):
        inner = [inner]
    return inner


@pytest.mark.parametrize("given", [nested(100_000), [[10**400]], [[1.0], [nested(5000)]]])
def test_actions_that_numpy_cannot_take_are_refused(given):
    with pytest.raises(PolicyServerError, match="the actions are no numbers"):
        checked_actions(given, ROBOT)


@contextmanager
def deaf_server():
    """A websocket that sends its metadata, and reads nothing that follows.

    It yields its place and its connections.
    """
    from websockets.server import ServerProtocol

    connections = []

    def serve():
        connection, _ = listener.accept()
        protocol = ServerProtocol()
        protocol.receive_data(connection.recv(65536))
        protocol.send_response(protocol.accept(protocol.events_received()[0]))
        protocol.send_binary(msgpack.packb({}))
        connection.sendall(b"".join(protocol.data_to_send()))
        connections.append(connection)

    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=serve, daemon=True).start()
        yield f"127.0.0.1:{listener.getsockname()[1]}", connections
        for each in connections:
            each.close()


def test_time_limit_holds_while_sending():
    with deaf_server() as (place, _):
        client = OpenPiClient(place, OpenPiSettings(), ROBOT)
        client.connect(30.0)
        with pytest.raises(NoAnswerError, match=r"did not read the observation within 0\.5 s"):
            client.ask(LARGE, 0.5)
        client.close()


def test_close_ends_a_question_that_is_being_sent():
    errors = []

    def ask():
        try:
            client.ask(LARGE, 600.0)
        except PolicyServerError as error:
            errors.append(type(error))

    with deaf_server() as (place, connections):
        client = OpenPiClient(place, OpenPiSettings(), ROBOT)
        client.connect(30.0)
        asking = threading.Thread(target=ask, daemon=True)
        asking.start()
        connections[0].recv(1, socket.MSG_PEEK)  # a part has been sent
        client.close()
        asking.join(60.0)
    assert errors == [ServerGoneError]


def test_slow_first_answer_is_not_ended_by_pings(start):
    """Pings would end it after 40 s, so this looks at the setting instead of waiting."""
    server = packed_server(start, {"actions": [[0.0]]})
    client = OpenPiClient(server.address.partition("://")[2], OpenPiSettings(), ROBOT)
    client.connect(30.0)
    assert client._socket.ping_interval is None
    client.close()


def test_time_limit_is_one_of_sending_and_receiving(start):
    """Each of the two calls takes 0.7 of the limit."""

    class SlowServer(LeRobotLikeServer):
        def _observations(self, requests, context):
            time.sleep(0.7)
            return super()._observations(requests, context)

    def slowly(_):
        time.sleep(0.7)
        return np.zeros((2, 1))

    server = start(SlowServer, slowly)
    policy = policy_of(server.address, 1.0)
    with pytest.raises(NoAnswerError, match="did not answer GetActions within 1 s"):
        policy.answer(SMALL)
    policy.close()


def test_close_ends_an_open_question_without_a_new_connection(start):
    asked, is_over, errors = threading.Event(), threading.Event(), []

    def answer(observation):
        if observation.timestep == 2:
            asked.set()
            is_over.wait(60.0)
        return np.zeros((2, 1))

    def ask():
        try:
            policy.answer(Observation(2, [0.0], {}, None))
        except PolicyServerError as error:
            errors.append(str(error))

    server = start(LeRobotLikeServer, answer)
    policy = policy_of(server.address)
    policy.answer(SMALL)
    asking = threading.Thread(target=ask, daemon=True)
    asking.start()
    assert asked.wait(60.0)
    policy.close()
    asking.join(20.0)
    is_over.set()
    assert errors == [f"policy server {server.address}: the connection is closed"]
    assert server.readies == 1


ASKS_AND_ENDS = """
import sys
from controller.chunks.merges import Replace
from controller.control_law import Tracking
from controller.policies.configuration import PolicyServerConfiguration
from controller.policies.served_law import ServedLaw
from controller.policies.served_policy import ServedPolicy
from controller.slow_law import AnswerTiming, ChunkRules

settings = PolicyServerConfiguration(timeout_s=600, start_timeout_s=600)
policy = ServedPolicy(sys.argv[1], settings, ["j0"], 2, 0.04)
law = ServedLaw(policy, AnswerTiming(1, 0.0, 0.0, "held", 0.001, 1, 0.0), ChunkRules(Replace()))
law.answer_in_real_time()
question = law._ask(Tracking(1))
sys.stdin.read(1)
print("has no answer:", question.answer_at(1.0))
"""


def test_open_question_does_not_delay_the_exit(start):
    asked, is_over = threading.Event(), threading.Event()

    def answer(_):
        asked.set()
        is_over.wait(600.0)

    server = start(OpenPiLikeServer, answer, msgpack.packb, msgpack.unpackb)
    command = [sys.executable, "-c", ASKS_AND_ENDS, server.address]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert asked.wait(60.0)
            output, _ = process.communicate("x", timeout=60.0)
        finally:
            process.kill()
            is_over.set()
    assert output == "has no answer: None\n"
