"""A controller in Python over plain Zenoh, independent of funnel-hil.

    python controller.py [PLANT_ENDPOINT LISTEN_ENDPOINT]

Without arguments it reads the endpoints from its environment, which `controller.process` sets.
Needs eclipse-zenoh and rosbags. Torques are PD around `joint_reference`, so the plant has to run
with `link.publish_reference: true`.
"""

import json
import os
import struct
import sys
import threading
import time
import uuid
from typing import Any

import numpy as np
import zenoh
from rosbags.typesys import Stores, get_typestore

DOMAIN, TYPE = 0, "sensor_msgs/msg/JointState"
STIFFNESS_NM_RAD, DAMPING_NM_S = 4000.0, 300.0
MOST_KEPT, MOST_WAITED_S = 1000, 60.0  # states and references, each; for the recorder
types = get_typestore(Stores.ROS2_JAZZY)
type_and_hash = f"sensor_msgs::msg::dds_::JointState_/{types.hash_rihs01(TYPE)}"

is_recorded = not sys.argv[1:]  # only `run` has a recorder to wait for
plant, listen = sys.argv[1:] or [
    os.environ[f"FUNNEL_HIL_{role}_ENDPOINT"] for role in ("PLANT", "CONTROLLER")
]
config = zenoh.Config()
if keys := os.environ.get("FUNNEL_HIL_SECURITY_FOLDER"):  # link.security: mutual TLS
    ends = {"certificate": f"{keys}/controller.crt", "private_key": f"{keys}/controller.key"}
    own = {f"{way}_{what}": file for way in ("listen", "connect") for what, file in ends.items()}
    tls = {"root_ca_certificate": f"{keys}/authority.crt", "enable_mtls": True, **own}
    config.insert_json5("transport/link/tls", json.dumps(tls))
for path, value in {
    "connect/endpoints": [plant],
    "listen/endpoints": [listen],  # link.controller_endpoint, where recorders connect to
    "scouting/multicast/enabled": False,
    "transport/unicast/lowlatency": True,
    "transport/unicast/qos/enabled": False,
}.items():
    config.insert_json5(path, json.dumps(value))

with zenoh.open(config) as session:
    session_id, gid = str(session.zid()), uuid.uuid4().bytes  # any 16 bytes
    commands = session.declare_publisher(
        f"{DOMAIN}/joint_commands/{type_and_hash}",
        congestion_control=zenoh.CongestionControl.BLOCK,
    )
    sequence, lock = 0, threading.Lock()
    is_over, recorder_is_there = threading.Event(), threading.Event()
    references: dict[tuple[int, int], Any] = {}  # by stamp
    unanswered: dict[tuple[int, int], list[Any]] = {}  # also states without a reference yet

    def read(sample: zenoh.Sample) -> tuple[Any, tuple[int, int]]:
        message = types.deserialize_cdr(sample.payload.to_bytes(), TYPE)
        return message, (message.header.stamp.sec, message.header.stamp.nanosec)

    def forget_oldest(kept: dict[tuple[int, int], Any]) -> None:
        if len(kept) > MOST_KEPT:
            del kept[next(iter(kept))]

    # Each topic arrives on its own thread, so a state may overtake its reference.
    def on_reference(sample: zenoh.Sample) -> None:
        reference, stamp = read(sample)
        with lock:
            references[stamp] = reference
            for state in unanswered.pop(stamp, ()):
                answer(state, reference)
            forget_oldest(references)

    def on_state(sample: zenoh.Sample) -> None:
        state, stamp = read(sample)
        with lock:
            if stamp in references:
                answer(state, references[stamp])
            else:
                unanswered.setdefault(stamp, []).append(state)
                forget_oldest(unanswered)

    def answer(state: Any, reference: Any) -> None:
        global sequence
        error = reference.position - state.position
        state.effort = STIFFNESS_NM_RAD * error + DAMPING_NM_S * (
            reference.velocity - state.velocity
        )
        state.position = state.velocity = np.empty(0)  # torques alone; names and stamp stay
        sequence += 1
        attachment = struct.pack("<qqB16s", sequence, time.time_ns(), 16, gid)
        commands.put(bytes(types.serialize_cdr(state, TYPE)), attachment=attachment)

    def on_recorder(_: zenoh.Sample) -> None:
        recorder_is_there.set()

    def on_plant(sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.DELETE:
            is_over.set()
            recorder_is_there.set()  # it will not arrive any more

    declared: list[Any] = [
        session.declare_subscriber(f"{DOMAIN}/joint_reference/{type_and_hash}", on_reference),
        session.declare_subscriber(f"{DOMAIN}/joint_states/{type_and_hash}", on_state),
        session.liveliness().declare_subscriber(
            f"@ros2_lv/{DOMAIN}/*/*/*/NN/*/*/funnel_hil_plant", on_plant, history=True
        ),
        session.liveliness().declare_subscriber(
            f"@ros2_lv/{DOMAIN}/*/*/*/NN/*/*/funnel_hil_recorder", on_recorder, history=True
        ),
    ]
    if is_recorded:
        recorder_is_there.wait(MOST_WAITED_S)  # else the plant would miss the first commands
    # Announced last: once the plant sees a publisher of commands, it starts.
    declared.append(
        session.liveliness().declare_token(
            os.environ.get("FUNNEL_HIL_COMMAND_TOKEN")
            or f"@ros2_lv/{DOMAIN}/{session_id}/0/1/MP/%/%/my_controller/%joint_commands"
            f"/{type_and_hash}/::,10:,:,:,,"
        )
    )
    is_over.wait()
