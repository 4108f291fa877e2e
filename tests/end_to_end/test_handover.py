"""A second controller: ignored while the first commands, and its successor when that leaves."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from running import ENDLESS, Watcher, processes_of, settings, started

from bus_schema.messages import topics
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.zenoh.session import Delivery
from tests.waiting import HANG_S, await_true, free_endpoint
from tests.warm_process import WarmProcess

LONG = [*ENDLESS, *settings(clock="lockstep", link__connect_timeout_s=HANG_S)]


@contextmanager
def another_controller(plant_endpoint: str) -> Iterator[WarmProcess]:
    """A controller that has begun to answer the states of a run under way."""
    endpoints = settings(
        link__plant_endpoint=plant_endpoint, link__controller_endpoint=free_endpoint()
    )
    process = WarmProcess("controller", "paper_arm", *LONG, *endpoints)
    try:
        await_true(lambda: "mrad, bound" in process.output(), "it answers")
        yield process
    finally:
        process.kill()
        process.wait()


def tells_of_successor(delivery: Delivery) -> bool:
    event = RunEvent.decode(delivery.payload)
    return event.kind == EventKind.COMMANDER and event.detail.endswith(" left")


def test_second_controller_is_ignored_until_the_first_has_left(tmp_path: Path) -> None:
    with started("run", "paper_arm", *LONG, out=tmp_path / "run") as run:
        endpoint = run.plant_endpoint()
        text: list[Delivery] = []
        with Watcher(endpoint) as watcher:
            watcher.session.subscribe(topics.RUN_EVENTS.key_expression(0), text.append)
            watcher.await_time(0.1, run)  # the run's own controller is in command
            with another_controller(endpoint) as successor:
                run.send(signal.SIGINT, "controller")
                await_true(lambda: "controller" not in processes_of(run.folder), "it has left")
                await_true(
                    lambda: any(map(tells_of_successor, text)), "the successor is in command"
                )
                watcher.await_time(watcher.last_stamp_ns * 1e-9 + 0.5, run)  # the run goes on
                run.send(signal.SIGINT)
                ended = run.end(130)
                assert successor.wait() == 0
    assert ended.summary["faults"] == []
    assert ended.summary["transport"]["downlink"]["rejected"]["other_commander"] > 0
    commanders = [e.detail for e in ended.data.events if e.kind == EventKind.COMMANDER]
    assert len(commanders) == 2
    assert commanders[1].endswith(
        f"after {commanders[0].removeprefix('commanded by session ')} left"
    )
