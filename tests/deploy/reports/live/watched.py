"""A short run as snapshots, and clients of the page that shows it."""

from __future__ import annotations

import http.client
import json
import time
from collections.abc import Iterator
from functools import cache
from urllib.parse import urlsplit

from deploy.reports.live.playback import Playback
from deploy.run.network.snapshot import Snapshot
from deploy.run.simulate import Simulation, simulate
from deploy.scenario.scenario import load_setup
from tests.waiting import HANG_S


@cache
def short_run(*overrides: str, scenario: str = "paper_arm") -> Simulation:
    return simulate(load_setup(scenario, ["duration_s=0.3", "metrics.from_s=0.1", *overrides]))


def payloads(run: Simulation) -> dict[str, list[bytes]]:
    found: dict[str, list[bytes]] = {}
    for topic, payload in zip(run.topics, run.payloads, strict=True):
        found.setdefault(topic.name, []).append(payload)
    return found


def playback(run: Simulation, speed: float = 1.0, is_watched=lambda: True) -> Playback:
    return Playback(payloads(run), run.setup.robot.joint_names, speed, is_watched)


def snapshots(run: Simulation) -> Iterator[Snapshot]:
    source = playback(run)
    while not source.is_over:
        snapshot = source.receive(0.1)
        if snapshot is not None:
            yield snapshot


def get(url: str, method: str = "GET", path: str | None = None, **headers: str):
    """Status, headers and body that a server answers with."""
    parts = urlsplit(url)
    connection = http.client.HTTPConnection(parts.netloc, timeout=HANG_S)
    asked = f"{parts.path}?{parts.query}" if path is None else path
    connection.request(method, asked, headers={"Host": parts.netloc, **headers})
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer.status, answer.headers, body


def place(url: str, path: str) -> str:
    """Another document of the page at `url`."""
    return url.replace("/?", f"/{path}?")


class Events:
    """A client of server-sent events, who does not wait for ever: the page keeps it alive."""

    def __init__(self, url: str) -> None:
        parts = urlsplit(place(url, "events"))
        self._connection = http.client.HTTPConnection(parts.netloc, timeout=HANG_S)
        self._connection.request("GET", f"{parts.path}?{parts.query}")
        self._answer = self._connection.getresponse()
        assert self._answer.status == 200

    def __iter__(self) -> Iterator[tuple[str, object]]:
        name, give_up_s = "", time.monotonic() + HANG_S
        for line in self._answer:
            assert time.monotonic() < give_up_s, "waited in vain for what the page is to show"
            word, _, value = line.decode().rstrip("\n").partition(": ")
            if word == "event":
                name = value
            elif word == "data":
                yield name, json.loads(value)

    def frames(self) -> Iterator[dict]:
        """Frames until the run is over."""
        for name, value in self:
            if name == "over":
                return
            yield from value

    def close(self) -> None:
        self._connection.close()
