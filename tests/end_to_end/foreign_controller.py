"""A controller that others wrote: PID to one point, with `zenoh` and `struct` and nothing of ours.

python foreign_controller.py [--fail-after N | --leave-after N | --silent-after N]

Where it falls silent it stays on the bus until the plant has left.
"""

import os
import signal
import struct
import sys
import threading

import zenoh

GOAL_RAD = (0.2, -0.3, 0.5)
PROPORTIONAL = (2480.0, 5000.0, 710.0)
INTEGRAL = (11700.0, 65400.0, 5060.0)
DERIVATIVE = (122.0, 478.0, 33.0)
STEP_S = 1e-3


class Reader:
    """CDR, little-endian: everything is aligned to its size, from behind the four first bytes."""

    def __init__(self, payload: bytes) -> None:
        self.data, self.at = payload[4:], 0

    def take(self, code: str, size: int, count: int = 1) -> tuple:
        if count:
            self.at += -self.at % size
        values = struct.unpack_from(f"<{count}{code}", self.data, self.at)
        self.at += size * count
        return values

    def string(self) -> str:
        (length,) = self.take("I", 4)
        text = self.data[self.at : self.at + length - 1].decode()
        self.at += length
        return text

    def doubles(self) -> tuple:
        (count,) = self.take("I", 4)
        return self.take("d", 8, count)


def padded(data: bytes, size: int) -> bytes:
    return data + bytes(-len(data) % size)


def command(stamp: tuple, names: list, torque_nm: list) -> bytes:
    data = struct.pack("<iII", *stamp, 1) + b"\0"
    data = padded(data, 4) + struct.pack("<I", len(names))
    for name in names:
        text = name.encode() + b"\0"
        data = padded(data, 4) + struct.pack("<I", len(text)) + text
    data = padded(data, 4) + struct.pack("<III", 0, 0, len(torque_nm))
    return b"\0\1\0\0" + padded(data, 8) + struct.pack(f"<{len(torque_nm)}d", *torque_nm)


def main() -> None:
    variable = {name: text for name, text in os.environ.items() if name.startswith("FUNNEL_HIL_")}
    limit = {word: int(number) for word, number in zip(sys.argv[1::2], sys.argv[2::2], strict=True)}
    over, answered, integral = threading.Event(), 0, [0.0, 0.0, 0.0]
    names = variable["FUNNEL_HIL_JOINTS"].split(",")
    configuration = zenoh.Config()
    for key, value in {
        "mode": '"peer"',
        "listen/endpoints": f'["{variable["FUNNEL_HIL_CONTROLLER_ENDPOINT"]}"]',
        "connect/endpoints": f'["{variable["FUNNEL_HIL_PLANT_ENDPOINT"]}"]',
        "connect/timeout_ms": "-1",
        "scouting/multicast/enabled": "false",
        "scouting/gossip/enabled": "false",
        "transport/unicast/lowlatency": "true",
        "transport/unicast/qos/enabled": "false",
    }.items():
        configuration.insert_json5(key, value)
    session = zenoh.open(configuration)
    publisher = session.declare_publisher(
        variable["FUNNEL_HIL_COMMAND_KEY"], congestion_control=zenoh.CongestionControl.BLOCK
    )
    gid = bytes.fromhex(variable["FUNNEL_HIL_COMMAND_GID"])

    def answer(sample: zenoh.Sample) -> None:
        nonlocal answered
        if answered >= min(limit.values(), default=1 << 60):
            if "--silent-after" not in limit:
                over.set()
            return
        state = Reader(sample.payload.to_bytes())
        stamp = state.take("i", 4) + state.take("I", 4)
        state.string()
        order = [state.string() for _ in range(state.take("I", 4)[0])]
        position, velocity = state.doubles(), state.doubles()
        assert order == names
        torque_nm = []
        for i, goal in enumerate(GOAL_RAD):
            error = position[i] - goal
            integral[i] += STEP_S * error
            torque_nm.append(
                -PROPORTIONAL[i] * error - INTEGRAL[i] * integral[i] - DERIVATIVE[i] * velocity[i]
            )
        answered += 1
        attachment = struct.pack("<qqB16s", answered, 0, 16, gid)
        publisher.put(command(stamp, names, torque_nm), attachment=attachment)

    subscriber = session.declare_subscriber(variable["FUNNEL_HIL_STATE_KEY"], answer)
    domain = variable["FUNNEL_HIL_DOMAIN"]
    plant = session.liveliness().declare_subscriber(
        f"@ros2_lv/{domain}/*/*/*/NN/*/*/funnel_hil_plant",
        lambda sample: sample.kind == zenoh.SampleKind.DELETE and over.set(),
        history=True,
    )
    token = session.liveliness().declare_token(variable["FUNNEL_HIL_COMMAND_TOKEN"])
    signal.signal(signal.SIGTERM, lambda *_: over.set())
    while not over.wait(0.05):
        pass
    for entity in (token, subscriber, plant):
        entity.undeclare()
    session.close()
    if "--fail-after" in limit:
        raise RuntimeError("the encoder of my own is gone")
    print(f"{answered} states answered")


if __name__ == "__main__":
    main()
