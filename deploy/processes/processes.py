"""Controller, plant and recorder as processes: real-time setup, signals, progress, farewell."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from rich.console import Console

from bus_schema.errors import BusError
from bus_schema.link.interface import ControllerLink
from bus_schema.messages.topics import Role
from bus_schema.runtime.clock import MonotonicClock, VirtualClock
from bus_schema.runtime.realtime import Grant, forgo_preemption, go_realtime, request_precedence
from controller.control_law import LOWER, UPPER
from controller.control_loop import ControlLoop
from deploy.processes.process_faults import order_values
from deploy.processes.recorder import Recorder
from deploy.scenario.faults import Order, process_strikes
from deploy.scenario.scenario import Setup
from plant_emulator.plant_loop import PlantLoop

FINISHED, FAULT = 0, 1
_PROGRESS_S = 0.2


class Voice:
    """How a process speaks to whoever started it: sentences to people, JSON lines to `run`.

    Args:
        role: the process.
        to_parent: speak JSON lines.
    """

    def __init__(self, role: Role, *, to_parent: bool) -> None:
        self._role = role
        self._to_parent = to_parent
        self._console = Console(highlight=False)

    def say(self, kind: str, **values: Any) -> None:
        """Say something: ``note``, ``lacks``, ``fault``, ``grants``, ``progress`` or ``result``."""
        if self._to_parent:
            # print writes the end of a line by itself, and another thread's line may get before it.
            with contextlib.suppress(BrokenPipeError):
                sys.stdout.write(json.dumps({"kind": kind, **values}) + "\n")
                sys.stdout.flush()
        elif kind in ("note", "lacks", "fault"):
            self._console.print(f"{self._role}: {values['text']}", markup=False)
        elif kind in ("progress", "result"):
            shown = ", ".join(f"{name} {value}" for name, value in values.items())
            self._console.print(f"{self._role}: {shown}", markup=False)

    def order(self, order: Order, *, await_execution: bool) -> None:
        """Have `run` strike a process; without `run` nobody does."""
        if self._to_parent:
            self.say("order", **order_values(order))
            if await_execution:
                sys.stdin.readline()


class StopRequest:
    """Set by SIGINT or SIGTERM; a process looks at it and leaves in order."""

    def __init__(self, on_stop: Callable[[], None] | None = None) -> None:
        self._on_stop = on_stop
        self.is_set = False
        signal.signal(signal.SIGINT, self._handle)
        signal.signal(signal.SIGTERM, self._handle)

    def _handle(self, _number: int, _frame: FrameType | None) -> None:
        self.is_set = True
        if self._on_stop is not None:
            self._on_stop()


def _leave_in_order() -> None:
    """From here on a request to stop comes too late, and must not kill what is leaving anyway."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)


def run_plant(
    setup: Setup, voice: Voice, *, await_recorder: bool, can_log: Path | None = None
) -> int:
    """Be the plant for one run; the exit code."""
    lockstep = setup.scenario.clock == "lockstep"
    clock = VirtualClock() if lockstep else MonotonicClock()
    arm = setup.arm()
    _set_up_scheduling(setup, voice, Role.PLANT)
    link = None
    try:
        run = setup.link_run(lockstep=lockstep, can_log=can_log)
        link = setup.link_kind.open_plant(run, arm, clock)
        strikes = process_strikes(
            setup.scenario.faults, partial(voice.order, await_execution=lockstep)
        )
        loop = PlantLoop(setup.plant_task(lockstep=lockstep, strikes=strikes), arm, link, clock)
        loop.warm_up()
        stop = StopRequest(loop.request_stop)
        voice.say("note", text=f"listening at {setup.scenario.link.plant_endpoint}")
        if await_recorder:
            link.await_recorder(run.link.connect_timeout_s, lambda: stop.is_set)
        link.await_controller(run.link.connect_timeout_s, lambda: stop.is_set)
        with _progress(voice, lambda: _plant_progress(loop, setup)):
            outcome = loop.run()
        link.await_recorded()
        for fault in outcome.faults:
            voice.say("fault", text=fault)
        voice.say("result", completed=outcome.completed, ticks=outcome.ticks, wall_s=outcome.wall_s)
        return FAULT if outcome.faults else FINISHED
    except BusError as error:
        voice.say("fault", text=str(error))
        return FAULT
    finally:
        _leave_in_order()
        if link is not None:
            link.close()
        arm.close()


def run_controller(setup: Setup, voice: Voice, *, await_recorder: bool) -> int:
    """Be the controller for one run; the exit code."""
    stop = StopRequest()
    _set_up_scheduling(setup, voice, Role.CONTROLLER)
    run = setup.link_run(lockstep=setup.scenario.clock == "lockstep")
    try:
        link = setup.link_kind.open_controller(run)
    except BusError as error:
        voice.say("fault", text=str(error))
        return FAULT
    try:
        loop = ControlLoop(setup.control_task(), link)
        loop.warm_up()
        voice.say("note", text=f"looking for the plant at {setup.scenario.link.plant_endpoint}")
        if await_recorder:
            link.await_recorder(run.link.connect_timeout_s, lambda: stop.is_set)
        link.activate()
        with _progress(voice, lambda: _controller_progress(loop)):
            return _control(loop, link, stop, voice)
    except BusError as error:
        voice.say("fault", text=str(error))
        return FAULT
    finally:
        _leave_in_order()
        link.close()


def _control(
    loop: ControlLoop,
    link: ControllerLink,
    stop: StopRequest,
    voice: Voice,
) -> int:
    """Answer states to the end, and say goodbye; the exit code."""
    code = FINISHED
    try:
        link.spin(lambda: stop.is_set)
    except Exception as error:  # noqa: BLE001 (whatever a law raises, the end is in order)
        voice.say("fault", text=str(error))
        loop.stop(str(error))
        code = FAULT
    voice.say("result", **loop.end())
    link.await_recorded()
    return code


def run_recorder(setup: Setup, path: Path, voice: Voice, stop: StopRequest) -> int:
    """Be the recorder for one run; the exit code."""
    if setup.scenario.clock == "realtime":
        _tell([request_precedence()], voice)
    else:
        forgo_preemption()
    try:
        recorder = Recorder(setup, path)
    except (BusError, OSError) as error:
        voice.say("fault", text=f"{path}: {error}")
        return FAULT
    voice.say("note", text=f"recording to {path}")
    code = FINISHED
    try:
        recorder.run(lambda: stop.is_set)
    except BusError as error:
        voice.say("fault", text=str(error))
        code = FAULT
    _leave_in_order()
    recorder.close()
    if recorder.failure is not None:
        voice.say("fault", text=f"{path}: the recording is partial: {recorder.failure.strerror}")
        code = FAULT
    lost = recorder.lost
    by_topic = "".join(f", {topic} {count}" for topic, count in lost.items())
    voice.say("note", text=f"{recorder.messages} messages recorded, {lost.total()} lost{by_topic}")
    return code


def _set_up_scheduling(setup: Setup, voice: Voice, role: Role) -> None:
    """For a loop; before other threads exist."""
    if setup.scenario.clock == "realtime":
        _tell(go_realtime(cpu=_own_cpu(setup, role)), voice)
    else:
        forgo_preemption()


def _tell(grants: list[Grant], voice: Voice) -> None:
    voice.say("grants", grants=[vars(grant) for grant in grants])
    for grant in grants:
        if not grant.granted:
            voice.say("lacks", text=f"works without {grant.name}: {grant.detail}")


def _own_cpu(setup: Setup, role: Role) -> int | None:
    """One of the usable CPUs for each loop, the last for the plant: it owns the clock, and the
    first often has the interrupts. None for no choice: where there is but one, or where the link
    has threads that need the others.
    """
    usable = sorted(os.sched_getaffinity(0))
    if len(usable) == 1 or not setup.link_kind.may_pin_loops:
        return None
    return usable[-1] if role is Role.PLANT else usable[0]


@contextlib.contextmanager
def _progress(voice: Voice, look: Callable[[], dict[str, Any]]) -> Iterator[None]:
    """Say how the loop is doing a few times a second, from outside the loop."""
    over = threading.Event()

    def report() -> None:
        while not over.wait(_PROGRESS_S):
            voice.say("progress", **look())

    thread = threading.Thread(target=report, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def _plant_progress(loop: PlantLoop, setup: Setup) -> dict[str, Any]:
    time_s = setup.grid.tick_ns(loop.tick) * 1e-9
    return {"time_s": round(time_s, 3), "deadline_misses": loop.deadline_misses}


def _controller_progress(loop: ControlLoop) -> dict[str, Any]:
    if not loop.cycles:
        return {}
    tracking = loop.tracking
    bounds = np.where(tracking.error >= 0.0, tracking.bounds[UPPER], tracking.bounds[LOWER])
    joint = int(np.argmax(np.abs(tracking.error) / np.maximum(bounds, 1e-12)))
    return {
        "joint": joint + 1,
        "error_mrad": round(1e3 * float(tracking.error[joint]), 4),
        "bound_mrad": round(1e3 * float(bounds[joint]), 3),
    }
