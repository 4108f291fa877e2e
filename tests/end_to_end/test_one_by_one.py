"""Plant and controller that are started one by one: they wait for each other, and must agree."""

from __future__ import annotations

import signal
import time

import pytest
from running import ENDLESS, outputs_of, settings

from tests.waiting import HANG_S, await_true, free_endpoint
from tests.warm_process import WarmProcess

SHORT = settings(clock="realtime", duration_s=0.3, plant__command_timeout_ms=20_000)

_LONGER_THAN_GRACE_S = 2.0
"""Than a plant gives a foreign client that subscribes to states before it commands."""


def start_both(plant: list[str], controller: list[str], *, at: list[str]) -> list[WarmProcess]:
    return [
        WarmProcess("plant", "paper_arm", *SHORT, *at, *plant),
        WarmProcess("controller", "paper_arm", *SHORT, *at, *controller),
    ]


@pytest.fixture
def endpoints() -> list[str]:
    return settings(link__plant_endpoint=free_endpoint(),
                    link__controller_endpoint=free_endpoint(),
                    link__connect_timeout_s=HANG_S)  # fmt: skip


def test_different_scenarios_end_with_2_on_both_sides_and_name_the_keys(endpoints):
    other = settings(controller__law="pid", link__uplink__delay_ms=3, plant__payload_kg=0.5)
    processes = start_both([], other, at=endpoints)
    outputs = outputs_of(processes)
    assert [process.returncode for process in processes] == [2, 2], outputs
    for output, peer in zip(outputs, ("controller", "plant"), strict=True):
        assert f"the {peer} runs another scenario" in output
        for key in ("controller.law", "link.uplink.delay_ms", "plant.payload_kg"):
            assert key in output
        assert "plant_endpoint" not in output.partition("another scenario")[2]
        assert "Traceback" not in output


def test_what_is_up_to_each_host_may_differ_and_what_they_say_is_for_people(endpoints):
    own = settings(link__reply_timeout_s=7.5)
    output = "".join(outputs_of(start_both([], own, at=endpoints)))
    assert "rejected: none" in output
    for unwanted in ("another scenario", "Counter(", "{", "_mrad"):
        assert unwanted not in output


def test_a_controller_started_seconds_later_is_waited_for(endpoints: list[str]) -> None:
    plant = WarmProcess("plant", "paper_arm", *SHORT, *endpoints)
    await_true(lambda: "listening" in plant.output(), "the plant is there")
    time.sleep(_LONGER_THAN_GRACE_S)
    controller = WarmProcess("controller", "paper_arm", *SHORT, *endpoints)
    outputs = outputs_of([plant, controller])
    assert [plant.returncode, controller.returncode] == [0, 0], outputs


def test_a_controller_that_waits_is_stopped_with_130(endpoints: list[str]) -> None:
    controller = WarmProcess("controller", "paper_arm", *SHORT, *endpoints)
    try:
        await_true(lambda: "looking for the plant" in controller.output(), "it waits")
        controller.send_signal(signal.SIGINT)
        assert controller.wait() == 130, controller.output()
    finally:
        controller.kill()


def test_a_controller_in_the_middle_of_a_run_is_stopped_with_130(endpoints: list[str]) -> None:
    """Its plant, which goes on without it, makes a safe stop: that is a fault there."""
    long = [*ENDLESS, *settings(clock="lockstep")]
    plant = WarmProcess("plant", "paper_arm", *long, *endpoints)
    controller = WarmProcess("controller", "paper_arm", *long, *endpoints)
    try:
        await_true(lambda: "bound" in controller.output(), "it controls")
        controller.send_signal(signal.SIGTERM)
        outputs = outputs_of([controller, plant])
    finally:
        controller.kill()
        plant.kill()
    assert [controller.returncode, plant.returncode] == [130, 1], outputs
    assert "plant: the controller has left the bus" in outputs[1]
