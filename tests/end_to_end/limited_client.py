"""The Python client of the documentation, under the names that `run` gives in its environment.

python limited_client.py [fail|leave|silence N]: what it does in place of its command number N + 1.
"""

from __future__ import annotations

import os
import runpy
import signal
import sys
from pathlib import Path
from typing import Any

import zenoh

CLIENT = Path(__file__).resolve().parents[2] / "bus_schema" / "clients" / "controller.py"
GIVEN = {name.removeprefix("FUNNEL_HIL_"): text for name, text in os.environ.items()}
HOW, MOST = sys.argv[1] if sys.argv[1:] else "", int(sys.argv[2]) if sys.argv[2:] else 1 << 60
open_session, answered = zenoh.open, 0


class Session:
    """A session whose publisher of commands is limited."""

    def __init__(self, configuration: zenoh.Config) -> None:
        self._session = open_session(configuration)

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        self._session.close()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._session, name)

    def declare_publisher(self, key: str, **options: Any) -> Publisher:
        assert key == GIVEN["COMMAND_KEY"]
        assert key.replace("commands", "states") == GIVEN["STATE_KEY"]
        return Publisher(self._session.declare_publisher(key, **options))


class Publisher:
    """A publisher of commands."""

    def __init__(self, publisher: Any) -> None:
        self._publisher = publisher

    def put(self, payload: bytes, attachment: bytes) -> None:
        global answered
        places = [payload.index(name.encode()) for name in GIVEN["JOINTS"].split(",")]
        assert places == sorted(places)
        if answered < MOST:
            answered += 1
            gid = bytes.fromhex(GIVEN["COMMAND_GID"])
            self._publisher.put(payload, attachment=attachment[: -len(gid)] + gid)
        elif HOW == "fail":
            print("RuntimeError: the encoder of my own is gone", file=sys.stderr, flush=True)
            os._exit(1)
        elif HOW == "leave":
            os._exit(0)


# It leaves by itself once the plant has gone; it shall say what it did before SIGTERM ends it.
signal.signal(signal.SIGTERM, signal.SIG_IGN)
zenoh.open = Session
del sys.argv[1:]
runpy.run_path(str(CLIENT))
print(f"{answered} states answered")
