"""A subscriber to everything that stops reading with the first message: it freezes itself.

`python frozen_subscriber.py ENDPOINT`. It says so when it begins to look for the endpoint, and is
told to be gone a second after it was last heard of.
"""

import json
import os
import signal
import sys

import zenoh

SETTINGS = {
    "mode": "client",
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
