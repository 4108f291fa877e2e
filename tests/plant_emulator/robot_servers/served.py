"""Robots of the tests: an arm in real time, and the server that answers its clients."""

import socket
import struct
import threading
from contextlib import contextmanager

from bus_schema.runtime.clock import MonotonicClock
from deploy.run.network.robot_network import listening
from deploy.scenario.scenario import load_setup
from plant_emulator.robot_servers.robot_rig import RobotRig

HOST = "127.0.0.1"


@contextmanager
def robot(server_type, arm, interface, ports, *overrides, host=HOST, network=None):
    """Serve a shipped arm; its server and its rig."""
    setup = load_setup(arm, [f"plant.interface.kind={interface}", *overrides])
    section, said = setup.scenario.plant.interface, []
    server = server_type(section.settings, section.period_s, said.append)
    server.said, server.description = said, setup.robot
    arm = setup.arm()
    arm.be_controlled_by(setup.robot_controller(server.interface))
    with listening(server, host, network and network(setup), ports):
        rig = RobotRig(arm, server, MonotonicClock(), setup.grid, lambda *_: None)
        thread = threading.Thread(target=rig.run)
        thread.start()
        try:
            yield server, rig
        finally:
            rig.request_stop()
            thread.join()
            server.close()
            arm.close()


def free_port(kind=socket.SOCK_STREAM):
    """A port that is not in use."""
    with socket.socket(socket.AF_INET, kind) as free:
        free.bind((HOST, 0))
        return free.getsockname()[1]


@contextmanager
def client_that_leaves(server):
    """What takes a client's bytes, and a function with which it resets its connection."""
    with socket.create_server((HOST, 0)) as listener:
        far = socket.create_connection(listener.getsockname())
        near, _ = listener.accept()
    far.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    server._tcp.add(near, lambda: None)
    try:
        yield server._accept(near, "commands"), far.close
    finally:
        far.close()
        near.close()
