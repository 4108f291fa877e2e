"""The plant's side of the link over CAN: emulated drives between the loop and the bus.

The loop has the drives measure their joints by `send_state`; a master samples them when it likes,
and when it has given every drive a torque, that is a command. Frames are handled where the loop
waits: in lockstep, where time stands still meanwhile, for the command; in real time, for its next
instant.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.can.codec import CanCodec
from bus_schema.can.frame import CanFrame
from bus_schema.can.link import CanRun
from bus_schema.errors import PeerSilentError
from bus_schema.link.interface import SCENARIO_WAIT_S, CommandArrival, PlantLink, Telemetry, never
from bus_schema.messages import topics
from bus_schema.messages.record import Record
from bus_schema.messages.topics import Role, Topic
from bus_schema.runtime.clock import Clock, HostLateness
from plant_emulator.drives.drives_on_bus import DrivesOnBus
from plant_emulator.drives.strangers import Strangers
from plant_emulator.drives.sync_phase import SyncPhase

_POLL_S, _POLL_NS = 0.02, 20_000_000
_FAREWELL_S = 1.0
_LOT, _REALTIME_LOT = 128, 64
"""Frames that are timed and logged at once: each of more costs less, but all hold up a tick."""

_LEAD = 0.15
"""Share of the period by which the physics is ahead of the master in real time."""


class CanPlantLink(PlantLink):
    """The plant's side.

    Args:
        run: the run.
        drives: the drives on their bus.
        codec: their cyclic frames.
        clock: the plant's clock.
        telemetry: where everything goes that is no frame; and what frames say, to be recorded.
    """

    def __init__(
        self,
        run: CanRun,
        drives: DrivesOnBus,
        codec: CanCodec,
        clock: Clock,
        telemetry: Telemetry,
    ) -> None:
        self._run, self._drives, self._codec = run, drives, codec
        self._clock, self._telemetry = clock, telemetry
        self._layout = topics.layout(topics.JOINT_STATES, run.joint_names)
        self._measured, self._sampled = Record(self._layout), Record(self._layout)
        self._command = Record(topics.layout(topics.JOINT_COMMANDS, run.joint_names))
        self._torque: Vector = np.zeros(len(run.joint_names))
        self._is_measured = self._is_sampled = False
        self._commanded: set[int] = set()
        self._samplings = 0
        self._strangers = Strangers(codec, drives.bank.node_ids, run.grid.period_ns)
        self._lateness = HostLateness()
        # Each tick comes a little before it is asked for, so that what is sampled is fresh.
        self._lead_ns = round(_LEAD * run.grid.period_ns)
        self._phase = SyncPhase(run.grid.period_ns, self._lead_ns)
        # When the first request of a sampling was read, and how long it may have waited.
        self._request_ns, self._waited_ns = -run.grid.period_ns, 0
        self._lot = _LOT if run.lockstep else _REALTIME_LOT
        self._empty_ns = 0  # when nothing more was to be read
        self._read_ns = 0
        self._waiting: deque[CanFrame] = deque()
        self._arrivals: deque[CommandArrival] = deque()
        self._controller_was_seen = False
        self._failure: str | None = None

    def publish(self, topic: Topic, payload: bytes) -> int:
        return self._telemetry.publish(topic, payload)

    def await_recorder(
        self, timeout_s: float, is_stop_requested: Callable[[], bool] = never
    ) -> None:
        self._telemetry.await_recorder(timeout_s, is_stop_requested)

    def await_controller(
        self, timeout_s: float, is_stop_requested: Callable[[], bool] = never
    ) -> None:
        """Wait until the master has enabled the drives and requests the first tick."""
        last_frame_s, read_ns = time.monotonic(), time.monotonic_ns()
        while not is_stop_requested():
            self._drives.advance(self._clock.now_ns())
            frame = self._drives.receive(_POLL_S)
            if frame is None:
                if time.monotonic() - last_frame_s > timeout_s:
                    raise PeerSilentError(Role.CONTROLLER, timeout_s, "frame on the CAN bus")
                continue
            last_frame_s = time.monotonic()
            if self._codec.is_sampling(frame):
                read_ns = time.monotonic_ns()
                self._waiting.append(frame)
                break
            self._drives.handle(frame, self._clock.now_ns())
        self._telemetry.require_same_scenario(Role.CONTROLLER, SCENARIO_WAIT_S)
        self._clock.anchor(self._lead_ns + time.monotonic_ns() - read_ns)
        self._drives.bank.take_targets()
        self._samplings = self._drives.bank.samplings
        # Before the master receives the first state, no drive misses a frame.
        self._drives.begin_run(self._clock.now_ns() - self._run.link.uplink.delay_ns)
        self._controller_was_seen = self._telemetry.sees(Role.CONTROLLER)

    def send_state(self, state: bytes, status: bytes) -> None:
        """Pass the measured joints to the drives, and advance them."""
        now_ns = self._clock.now_ns()
        self._layout.decode(state, self._measured)
        fields = self._measured.fields
        bank = self._drives.bank
        bank.measure(fields["position"], fields["velocity"], fields["effort"])
        self._is_measured = True
        bus_off_s = self._run.link.can.faults.bus_off_s
        if bus_off_s is not None and now_ns >= bus_off_s * 1e9 and not self._drives.is_off:
            self._drives.lose_bus(now_ns)
        self._drives.advance(self._read_until_ns(now_ns))
        self.publish(topics.PLANT_STATUS, status)

    def wait_until(self, clock: Clock, instant_ns: int) -> int:
        """Process the drives' frames until an instant, in real time.

        Before the joints were first measured, drives have nothing to answer with.
        """
        if self._run.lockstep or self._failure is not None or not self._is_measured:
            return clock.wait_until(instant_ns)
        try:
            is_past = clock.now_ns() >= instant_ns
            self._serve(clock, instant_ns)
            late_ns = clock.now_ns() - instant_ns
            if is_past or late_ns > self._run.grid.period_ns:
                # This host did not wait for frames, or read none for too long.
                self._catch_up(clock)
        except Exception as error:  # noqa: BLE001 (reported by `fault`, which ends the run)
            self._failure = f"frames are no longer processed: {type(error).__name__}: {error}"
            return clock.wait_until(instant_ns)
        self._lateness.note(late_ns, instant_ns + late_ns)
        return late_ns

    def await_command(self, timeout_s: float) -> bool:
        give_up_s = time.monotonic() + timeout_s
        while not self._arrivals:
            frame = self._next_frame(max(0.0, give_up_s - time.monotonic()))
            if frame is None:
                return False
            self._take(frame)
        return True

    def controller_has_left(self) -> bool:
        is_gone = self._controller_was_seen and not self._telemetry.sees(Role.CONTROLLER)
        return is_gone or self._drives.is_off

    def take_commands(self) -> list[CommandArrival]:
        return [self._arrivals.popleft() for _ in range(len(self._arrivals))]

    def fault(self) -> str | None:
        """Describe faults of the drives and errors in frame processing; empty if there are none."""
        reason = "; ".join(self._drives.bank.faults) or self._failure
        if reason is None:
            return None
        late = "" if self._run.lockstep else self._lateness.in_words(self._clock.now_ns())
        return "; ".join(filter(None, (reason, self._strangers.in_words(), late)))

    def report(self) -> dict[str, Any]:
        """Load, latency and counts of the bus."""
        now_ns = self._clock.now_ns()
        rejected = {"rejected": dict(self._drives.bank.rejections.counts)}
        dropped = self._drives.dropped()
        counts = rejected if dropped is None else rejected | {"dropped": dropped}
        return {"can": self._drives.medium.summary(now_ns) | counts}

    def require_same_scenario(self, role: Role, wait_s: float = 0.0) -> None:
        self._telemetry.require_same_scenario(role, wait_s)

    def await_recorded(self) -> None:
        """Wait until the master has stopped the drives and the recorder has all messages."""
        if self._failure is None:
            self._await_standstill()
        self._telemetry.await_recorded()

    def close(self) -> None:
        """Close the buses."""
        self._drives.close()
        self._telemetry.close()

    def _await_standstill(self) -> None:
        """Process frames until the master has stopped the drives. In lockstep, it advances time."""
        bank, fields = self._drives.bank, self._measured.fields
        bank.measure(fields["position"], 0.0 * fields["velocity"], 0.0 * fields["effort"])
        now_ns, give_up_s = self._clock.now_ns(), time.monotonic() + _FAREWELL_S
        self._drives.end_run(now_ns)
        while time.monotonic() < give_up_s:
            has_left = self.controller_has_left()  # what it has sent is there by now
            frame = self._next_frame(0.0 if has_left else _POLL_S)
            if frame is not None:
                now_ns += self._run.grid.period_ns if self._codec.is_sampling(frame) else 0
                self._drives.handle(frame, now_ns)
            elif has_left or (bank.braked.all() and not self._controller_was_seen):
                break  # a foreign master does not announce that it is done
            self._drives.advance(now_ns)

    def _serve(self, clock: Clock, until_ns: int) -> None:
        """Process frames as they arrive, until an instant.

        One that is read after it has to wait, as what happens at the instant comes first: else a
        request would be answered with the state before a tick that has passed.
        """
        while clock.now_ns() < until_ns:
            frame = self._next_frame(0.0)
            if was_awaited := frame is None:
                frame = self._next_frame(max(0.0, (until_ns - clock.now_ns()) * 1e-9))
            self._read_ns = clock.now_ns()
            if was_awaited:
                self._empty_ns = self._read_ns
            if frame is not None and self._read_ns >= until_ns:
                self._waiting.appendleft(frame)
            elif frame is not None:
                self._take(frame)

    def _catch_up(self, clock: Clock) -> None:
        """Process waiting frames for at most one period, because a flood may not end."""
        give_up_ns = clock.now_ns() + self._run.grid.period_ns
        while clock.now_ns() < give_up_ns and (frame := self._next_frame(0.0)) is not None:
            self._take(frame)
        self._read_ns = clock.now_ns()

    def _read_until_ns(self, now_ns: int) -> int:
        """Time until which drives may miss frames. In real time, unread frames are not missed.

        Where the loop that reads them is held up, the drives would find their master silent.
        """
        if self._run.lockstep or self._failure is not None:
            return now_ns
        read_ns = min(now_ns, self._read_ns + _POLL_NS)
        self._lateness.note(now_ns - read_ns, now_ns)
        return read_ns

    def _next_frame(self, timeout_s: float) -> CanFrame | None:
        return self._waiting.popleft() if self._waiting else self._drives.receive(timeout_s)

    def _take(self, frame: CanFrame) -> None:
        """Pass a frame to the drives, and publish the result."""
        now_ns = self._clock.now_ns()
        is_request = self._codec.is_sampling(frame)
        if is_request:
            self._note_request(now_ns)
        if self._drives.delay_ns and self._is_sampled and not is_request:
            self._drives.handle_later(frame, now_ns)
        else:
            self._drives.handle(frame, now_ns)
        commanded = self._codec.read_torque(frame, self._torque)
        self._strangers.note(frame, commanded, now_ns)
        for answer in self._drives.answers:
            fields = self._sampled.fields
            self._codec.read_state(answer, fields["position"], fields["velocity"])
        samplings = self._drives.bank.samplings
        if samplings != self._samplings:
            self._samplings, self._is_sampled = samplings, True
            self._note_request(now_ns)
            self._clock.put_forward(self._phase.correction_ns(self._request_ns, self._waited_ns))
            self._request_ns = -self._run.grid.period_ns
            self._publish_state()
        if self._is_commanded(commanded):
            self._is_sampled = False
            self._publish_command()
            self._drives.medium.catch_up(self._lot)  # no node waits until the next tick

    def _note_request(self, now_ns: int) -> None:
        """Note when the sampling under way was asked for, if the known time is of another one."""
        if now_ns - self._request_ns > self._run.grid.period_ns // 2:
            self._request_ns, self._waited_ns = now_ns, now_ns - self._empty_ns

    def _is_commanded(self, joint: int | None) -> bool:
        """Whether all drives have or will have a torque, after one was sent to a joint."""
        if not self._drives.delay_ns:
            return self._drives.bank.take_targets()
        if joint is not None:
            self._commanded.add(joint)
        is_complete = len(self._commanded) == len(self._run.joint_names)
        if is_complete:
            self._commanded.clear()
        return is_complete

    def _publish_state(self) -> None:
        """Publish what the controller receives, after all drives have sent their states."""
        self._sampled.stamp_ns = self._measured.stamp_ns
        self._sampled.fields["effort"][:] = self._torque
        self.publish(topics.JOINT_STATES, self._sampled.payload())

    def _publish_command(self) -> None:
        """Publish the command that all drives have received, which answers the last sampling."""
        self._command.stamp_ns = self._sampled.stamp_ns
        self._command.fields["effort"][:] = self._torque
        payload = self._command.payload()
        sequence = self.publish(topics.JOINT_COMMANDS, payload)
        self._arrivals.append(CommandArrival(payload, sequence, b"", self._clock.now_ns()))
