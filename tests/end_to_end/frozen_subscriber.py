"""A subscriber to everything that stops reading with the first message: it freezes itself.

`python frozen_subscriber.py ENDPOINT MODE`, as ``peer`` or ``client``. It says so when it begins to
look for the endpoint. Others count it as gone a second after its last message.
"""

import json
import os
import signal
import sys

import zenoh

SETTINGS = {
    "mode": sys.argv[2],
    "listen/endpoints": [],
    "connect/exit_on_failure": False,
    "connect/endpoints": [f"{sys.argv[1]}#so_rcvbuf=4096"],
    "connect/timeout_ms": -1,
    "connect/retry": {"period_init_ms": 20, "period_max_ms": 20, "period_increase_factor": 1},
    "scouting/multicast/enabled": False,
    "transport/link/tx/lease": 1000,
}


def main() -> None:
    configuration = zenoh.Config()
    for path, value in SETTINGS.items():
        configuration.insert_json5(path, json.dumps(value))
    print("looking", flush=True)
    with zenoh.open(configuration) as session, session.declare_subscriber("0/**") as messages:
        messages.recv()
        os.kill(os.getpid(), signal.SIGSTOP)
        signal.pause()


if __name__ == "__main__":
    main()
