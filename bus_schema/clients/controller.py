"""A controller in Python over plain Zenoh; it knows nothing of funnel-hil.

    python controller.py [PLANT_ENDPOINT LISTEN_ENDPOINT]

Without endpoints it takes those of its environment, as `controller.process` gives them. Needs
eclipse-zenoh and rosbags. Torques are PD around `joint_reference`, so the plant has to run with
`link.publish_reference: true`.
"""

import json
import os
import struct
import sys
import threading
import time
import uuid

import numpy as np
import zenoh
from rosbags.typesys import Stores, get_typestore

DOMAIN, TYPE = 0, "sensor_msgs/msg/JointState"
STIFFNESS_NM_RAD, DAMPING_NM_S = 4000.0, 300.0
types = get_typestore(Stores.ROS2_JAZZY)
type_and_hash = f"sensor_msgs::msg::dds_::JointState_/{types.hash_rihs01(TYPE)}"

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
    reference = {"stamp": None, "position": 0.0, "velocity": 0.0}
    sequence, is_over = 0, threading.Event()

    def on_reference(sample: zenoh.Sample) -> None:
        message = types.deserialize_cdr(sample.payload.to_bytes(), TYPE)
        reference.update(vars(message))

    def on_state(sample: zenoh.Sample) -> None:
        global sequence
        message = types.deserialize_cdr(sample.payload.to_bytes(), TYPE)
        error = reference["position"] - message.position
        message.effort = STIFFNESS_NM_RAD * error + DAMPING_NM_S * (
            reference["velocity"] - message.velocity
        )
        message.position = message.velocity = np.empty(0)  # torques alone; the stamp stays
        sequence += 1
        attachment = struct.pack("<qqB16s", sequence, time.time_ns(), 16, gid)
        commands.put(bytes(types.serialize_cdr(message, TYPE)), attachment=attachment)

    def on_plant(sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.DELETE:
            is_over.set()

    kept = [
        session.declare_subscriber(f"{DOMAIN}/joint_reference/{type_and_hash}", on_reference),
        session.declare_subscriber(f"{DOMAIN}/joint_states/{type_and_hash}", on_state),
        session.liveliness().declare_subscriber(
            f"@ros2_lv/{DOMAIN}/*/*/*/NN/*/*/funnel_hil_plant", on_plant, history=True
        ),
        # Once all is ready: from here on the plant knows of a publisher of commands, and starts.
        session.liveliness().declare_token(
            os.environ.get("FUNNEL_HIL_COMMAND_TOKEN")
            or f"@ros2_lv/{DOMAIN}/{session_id}/0/1/MP/%/%/my_controller/%joint_commands"
            f"/{type_and_hash}/::,10:,:,:,,"
        ),
    ]
    is_over.wait()
