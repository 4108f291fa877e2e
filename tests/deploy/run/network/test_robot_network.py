"""The network of a robot server: the robot's loop never waits for it, and it leaves no socket."""

import socket
import threading

import pytest

from bus_schema.link.configuration import LinkConfiguration
from deploy.run.network.robot_network import RobotNetwork
from tests.waiting import HANG_S, await_true


@pytest.fixture
def network():
    network = RobotNetwork(LinkConfiguration(uplink={"delay_ms": 5}), 1)
    yield network
    network.close()


def test_a_new_client_does_not_wait_for_the_relay_of_the_one_before(network, monkeypatch):
    """The robot's own loop routes: a wait for a thread in `select` would hold it up."""
    network.route(("127.0.0.1", 5555))
    joined = []
    with monkeypatch.context() as patched:
        patched.setattr(threading.Thread, "join", lambda *_: joined.append(1))
        network.route(("127.0.0.1", 5555))
    assert joined == []


def test_relays_of_earlier_clients_close_their_sockets(network):
    """Each client had a message, so that its relay had a socket of the robot's, too."""
    before, relays = set(threading.enumerate()), []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as robot:
        for _ in range(3):
            robot.sendto(b"state", network.route(("127.0.0.1", 5555)))
            await_true(lambda: network.counts()["chunks"] == 1)
            relays.append(network._relay)
    await_true(lambda: len(set(threading.enumerate()) - before) == 1)  # others may end
    for relay in relays[:2]:
        assert [each.fileno() for each in (relay._listener, *relay._sockets())] == [-1, -1]


def test_a_relay_asked_to_stop_is_woken(monkeypatch):
    """Without that, it would end only once its `select`, here of an hour, is over."""
    monkeypatch.setattr("deploy.run.network.link_relay._LOOK_UP_NS", 3_600_000_000_000)
    network = RobotNetwork(LinkConfiguration(uplink={"delay_ms": 5}), 1)
    network.route(("127.0.0.1", 5555))
    threads = threading.active_count()
    closing = threading.Thread(target=network.close, daemon=True)
    closing.start()
    closing.join(HANG_S)
    assert not closing.is_alive()
    assert threading.active_count() == threads - 1
