"""A subscriber to everything that stops reading with the first message: it freezes itself.

`python frozen_subscriber.py ENDPOINT`. It is told to be gone a second after it was last heard of.
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
    "scouting/multicast/enabled": False,
    "transport/link/tx/lease": 1000,
}


def main() -> None:
    configuration = zenoh.Config()
    for path, value in SETTINGS.items():
        configuration.insert_json5(path, json.dumps(value))
    with zenoh.open(configuration) as session, session.declare_subscriber("0/**") as messages:
        messages.recv()
        os.kill(os.getpid(), signal.SIGSTOP)
        signal.pause()


if __name__ == "__main__":
    main()
