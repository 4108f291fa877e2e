"""Plant and controller that are started one by one: they wait for each other, and must agree."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest
from running import ENDLESS, HANG_S, await_true, free_endpoint, settings, started

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


def outputs_of(processes: list[WarmProcess]) -> list[str]:
    try:
        return [process.communicate()[0] for process in processes]
    finally:
        for process in processes:
            process.kill()


def test_different_scenarios_end_with_2_on_both_sides_and_name_the_keys(
    endpoints: list[str],
) -> None:
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


def test_a_run_that_awaits_a_controller_ends_like_its_plant(
    endpoints: list[str], tmp_path: Path
) -> None:
    words = ["run", "paper_arm", *SHORT, *endpoints, "--await-controller"]
    with started(*words, out=tmp_path / "run") as running:
        other = settings(controller__law="pid")
        controller = WarmProcess("controller", "paper_arm", *SHORT, *endpoints, *other)
        try:
            ended = running.end()
        finally:
            controller.kill()
            controller.wait()
    assert ended.code == 2, ended.output
    assert "the controller runs another scenario" in ended.output
    assert "Traceback" not in ended.output


def test_what_is_up_to_each_host_may_differ(endpoints: list[str]) -> None:
    own = settings(link__reply_timeout_s=7.5)
    processes = start_both([], own, at=endpoints)
    outputs = outputs_of(processes)
    assert all("another scenario" not in output for output in outputs)


def test_a_plant_waits_for_a_controller_that_is_there_but_not_ready(
    endpoints: list[str], tmp_path: Path
) -> None:
    """It takes longer to load than a plant waits for a foreign client to become known."""
    plant = WarmProcess("plant", "paper_arm", *SHORT, *endpoints)
    controller = WarmProcess(
        "controller", "paper_arm", *SHORT, *endpoints,
        main="tests.end_to_end.slow:main", environment={**os.environ, "GATE": str(tmp_path)},
    )  # fmt: skip
    try:
        await_true((tmp_path / "waits").exists, "the controller is there")
        time.sleep(_LONGER_THAN_GRACE_S)
        assert "ticks" not in plant.said()  # of a run that is over by now, had it begun
    finally:
        (tmp_path / "open").touch()
        outputs = outputs_of([plant, controller])
    assert "no valid command" not in outputs[0], outputs
    assert [plant.returncode, controller.returncode] == [0, 0], outputs


def test_a_plant_alone_says_so_and_never_runs(endpoints: list[str]) -> None:
    """It waits for longer than it would give a foreign client that has announced nothing."""
    patience = [
        word.replace(f"connect_timeout_s={HANG_S}", "connect_timeout_s=2") for word in endpoints
    ]
    plant = WarmProcess("plant", "paper_arm", *SHORT, *patience)
    (output,) = outputs_of([plant])
    assert "the controller is silent: no sign of life within 2 s" in output
    assert "safe stop" not in output
    assert "no valid command" not in output
    assert plant.returncode == 1


def test_a_controller_started_seconds_later_is_waited_for(endpoints: list[str]) -> None:
    """And a plant that waits still compares scenarios with it."""
    other = settings(controller__law="pid")
    for differs, expected in ([], 0), (other, 2):
        plant = WarmProcess("plant", "paper_arm", *SHORT, *endpoints)
        await_true(lambda plant=plant: "listening" in plant.said(), "the plant is there")
        time.sleep(_LONGER_THAN_GRACE_S)
        controller = WarmProcess("controller", "paper_arm", *SHORT, *endpoints, *differs)
        outputs = outputs_of([plant, controller])
        assert [plant.returncode, controller.returncode] == [expected] * 2, outputs
        assert all(("controller.law" in output) == bool(differs) for output in outputs), outputs


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_controller_that_waits_is_stopped_with_130(
    endpoints: list[str], number: signal.Signals
) -> None:
    controller = WarmProcess("controller", "paper_arm", *SHORT, *endpoints)
    try:
        await_true(lambda: "looking for the plant" in controller.said(), "it waits")
        controller.send_signal(number)
        assert controller.wait() == 130, controller.said()
    finally:
        controller.kill()


def test_a_controller_in_the_middle_of_a_run_is_stopped_with_130(endpoints: list[str]) -> None:
    """Its plant, which goes on without it, makes a safe stop: that is a fault there."""
    long = [*ENDLESS, *settings(clock="lockstep")]
    plant = WarmProcess("plant", "paper_arm", *long, *endpoints)
    controller = WarmProcess("controller", "paper_arm", *long, *endpoints)
    try:
        await_true(lambda: "bound" in controller.said(), "it controls")
        controller.send_signal(signal.SIGTERM)
        outputs = outputs_of([controller, plant])
    finally:
        controller.kill()
        plant.kill()
    assert [controller.returncode, plant.returncode] == [130, 1], outputs
    assert "plant: the controller has left the bus" in outputs[1]


def test_what_they_say_is_for_people(endpoints: list[str]) -> None:
    said = "".join(outputs_of(start_both([], [], at=endpoints)))
    assert "Counter(" not in said
    assert "{" not in said
    assert "_mrad" not in said
    assert "rejected: none" in said
