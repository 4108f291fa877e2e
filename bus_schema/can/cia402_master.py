"""Master of CiA 402 drives on CANopen, in cyclic synchronous torque mode.

Enabling is left to canopen's own CiA 402 client, for which a thread hands it the frames that come.
The cycle needs neither: its frames are fixed once the drives follow.
"""

from __future__ import annotations

import contextlib
import logging
import struct
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import canopen
from canopen.emcy import EmcyError
from canopen.profiles.p402 import BaseNode402, State402
from canopen.sdo.exceptions import SdoError

from bus_schema.arrays import Vector
from bus_schema.can.cia402_codec import QUICK_STOP, Cia402Codec
from bus_schema.can.frame import CanBus, CanFrame, is_classical_data
from bus_schema.can.master import DriveError, Roll, bus_fault
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.link.can_files import CIA402_EDS

logger = logging.getLogger(__name__)
# canopen reports in its log what it then raises.
logging.getLogger("canopen").setLevel(logging.CRITICAL)

MASTER_NODE = 127
_EMCY, _TPDO_2, _HEARTBEAT = 0x080, 0x280, 0x700
_FROM_DRIVES = (_EMCY, 0x180, _TPDO_2, 0x380, 0x480, 0x580, _HEARTBEAT)
_OPERATIONAL, _BOOT_UP = 5, 0
_STATUSWORD = struct.Struct("<H")
_POWERED = ("OPERATION ENABLED", "QUICK STOP ACTIVE", "FAULT REACTION ACTIVE")
_MODE = "CYCLIC SYNCHRONOUS TORQUE"
_POLL_S = 0.005
_BOOT_S = 1.0


class Cia402Master:
    """The master.

    Args:
        bus: where the drives are.
        can: section ``link.can`` of the scenario.
        node_ids: addresses of the drives, one for each joint.
        codec: the frames of a cycle.
    """

    def __init__(
        self, bus: CanBus, can: CanConfiguration, node_ids: tuple[int, ...], codec: Cia402Codec
    ) -> None:
        self._bus, self._can, self._codec = bus, can, codec
        self._network = _Network(bus)
        self._nodes = [BaseNode402(node_id, str(can.eds or CIA402_EDS)) for node_id in node_ids]
        for node in self._nodes:
            node.sdo.RESPONSE_TIMEOUT = can.answer_timeout_s
            node.TIMEOUT_SWITCH_STATE_FINAL = node.TIMEOUT_SWITCH_STATE_SINGLE = (
                can.answer_timeout_s
            )
            node.TIMEOUT_SWITCH_OP_MODE = can.answer_timeout_s
            self._network.add_node(node)
        self._joint_of = {node_id: joint for joint, node_id in enumerate(node_ids)}
        self._roll = Roll(node_ids)
        self._faults: list[str] = []
        self._is_powered = [False] * len(node_ids)
        self._heard_ns = [0] * len(node_ids)
        self._emergencies = [""] * len(node_ids)
        self._now_ns = 0
        self._next_heartbeat_ns = 0
        self._is_stopping = False

    def enable(self, timeout_s: float, is_stop_requested: Callable[[], bool]) -> bool:
        with self._listening():
            if not self._await_boot(timeout_s, is_stop_requested):
                return False
            for joint, node in enumerate(self._nodes):
                try:
                    self._check(joint, node)
                    self._enable(node)
                except (SdoError, RuntimeError, ValueError) as error:
                    raise DriveError(f"drive {node.id} does not follow: {error}") from error
            for node in self._nodes:
                # From now on torques must keep coming; the last one came long ago.
                node.rpdo[1].transmit()
                self._set(node, 0x1400, 5, self._can.command_timeout_ms)
        self._is_powered = [True] * len(self._nodes)
        return True

    def sample(self, now_ns: int) -> None:
        self._now_ns = now_ns
        if now_ns >= self._next_heartbeat_ns:
            self._bus.send(CanFrame(_HEARTBEAT + MASTER_NODE, bytes([_OPERATIONAL])))
            self._next_heartbeat_ns = now_ns + self._can.heartbeat_ms * 1_000_000
        self._roll.call()
        for frame in self._codec.sampling_frames():
            self._bus.send(frame)

    def read(self, timeout_s: float, position: Vector, velocity: Vector) -> bool:
        give_up_s = time.monotonic() + timeout_s
        while not self._roll.is_complete:
            frame = self._bus.receive(max(0.0, give_up_s - time.monotonic()))
            if frame is None:
                break
            joint = self._codec.read_state(frame, position, velocity)
            if joint is None:
                self._hear(frame)
            else:
                self._roll.answered(joint)
        self._watch()
        return self._roll.is_complete

    def missing(self) -> str:
        return self._roll.missing

    def command(self, torque_nm: Vector) -> None:
        for frame in self._codec.torque_frames(torque_nm):
            self._bus.send(frame)

    def begin_stop(self) -> None:
        self._is_stopping = True
        self._codec.controlword = QUICK_STOP
        self._roll.give_up()

    def is_stopped(self) -> bool:
        return not any(
            is_powered and joint not in self._roll.silent
            for joint, is_powered in enumerate(self._is_powered)
        )

    def leave(self) -> None:
        self._network.nmt.state = "PRE-OPERATIONAL"

    def _await_boot(self, timeout_s: float, is_stop_requested: Callable[[], bool]) -> bool:
        """Reset all drives until each has said that it is there; false if asked to stop."""
        give_up_s = time.monotonic() + timeout_s
        missing = set(self._joint_of)
        for node_id, joint in self._joint_of.items():
            heard = partial(_strike_off, missing, node_id)
            self._nodes[joint].nmt.add_heartbeat_callback(heard)
        while missing and not is_stop_requested():
            for node_id in sorted(missing):
                self._network[node_id].nmt.state = "RESET"
            again_s = time.monotonic() + _BOOT_S
            while missing and time.monotonic() < again_s and not is_stop_requested():
                time.sleep(0.005)
            if missing and time.monotonic() > give_up_s:
                nodes = ", ".join(str(node_id) for node_id in sorted(missing))
                raise DriveError(f"no answer from drive {nodes} within {timeout_s:g} s")
        return not missing

    def _check(self, joint: int, node: BaseNode402) -> None:
        """Whether the drive is what the scenario says it is."""
        wanted = {
            "device profile (0x1000)": (node.sdo[0x1000].raw & 0xFFFF, 402),
            "rated torque in mN m (0x6076)": (
                node.sdo[0x6076].raw, int(self._codec.units.rated_mnm[joint])
            ),
            "encoder increments per turn (0x608F)": (
                node.sdo[0x608F][1].raw, self._can.counts_per_turn
            ),
        }  # fmt: skip
        for what, (found, expected) in wanted.items():
            if found != expected:
                raise DriveError(f"drive {node.id}: {what} is {found}, not {expected}")
        if not node.is_op_mode_supported(_MODE):
            raise DriveError(f"drive {node.id} has no cyclic synchronous torque mode (0x6502)")

    def _enable(self, node: BaseNode402) -> None:
        """From pre-operational to operation enabled, as canopen's documentation shows it."""
        self._set(node, 0x1016, 1, MASTER_NODE << 16 | self._can.heartbeat_timeout_ms)
        self._set(node, 0x1017, 0, self._can.heartbeat_ms)
        node.nmt.state = "PRE-OPERATIONAL"
        node.setup_402_state_machine()
        node.nmt.state = "OPERATIONAL"
        if node.state == "FAULT":
            node.reset_from_fault()
        node.op_mode = _MODE
        if node.op_mode != _MODE:
            raise DriveError(f"drive {node.id} stays in mode {node.op_mode}")
        node.state = "OPERATION ENABLED"

    def _set(self, node: BaseNode402, index: int, subindex: int, value: int) -> None:
        entry = node.sdo[index]
        variable = entry[subindex] if subindex else entry
        variable.raw = value

    def _hear(self, frame: CanFrame) -> None:
        """Take in what is no state: emergencies, status words, heartbeats."""
        if frame.is_error:
            if (fault := bus_fault(frame)) is not None:
                self._faults.append(fault)
            return
        function, node_id = frame.identifier & ~0x7F, frame.identifier & 0x7F
        joint = self._joint_of.get(node_id)
        if joint is None or frame.is_extended or frame.is_remote:
            return
        if function == _EMCY and len(frame.data) == _EMERGENCY.size:
            self._hear_emergency(joint, frame.data)
        elif function == _TPDO_2 and len(frame.data) >= _STATUSWORD.size:
            self._hear_status(joint, node_id, *_STATUSWORD.unpack_from(frame.data))
        elif function == _HEARTBEAT and frame.data:
            self._heard_ns[joint] = self._now_ns
            if frame.data[0] != _OPERATIONAL:
                self._faults.append(f"drive {node_id} is no longer operational")

    def _hear_emergency(self, joint: int, data: bytes) -> None:
        """Remember why a drive may be about to stop; that it does so its statusword tells."""
        code, register, _ = _EMERGENCY.unpack(data)
        meaning = EmcyError(code, register, b"", 0.0).get_desc()
        self._emergencies[joint] = f", emergency 0x{code:04X} ({meaning})" if code else ""

    def _hear_status(self, joint: int, node_id: int, word: int) -> None:
        states = [name for name, (mask, bits) in State402.SW_MASK.items() if word & mask == bits]
        state = states[0] if states else f"unknown state 0x{word:04X}"
        self._is_powered[joint] = state in _POWERED
        if state != "OPERATION ENABLED":
            self._faults.append(f"drive {node_id}: {state.lower()}{self._emergencies[joint]}")

    def _watch(self) -> None:
        """Raise what is wrong."""
        timeout_ns = self._can.heartbeat_timeout_ms * 1_000_000
        for node_id, joint in self._joint_of.items():
            if self._now_ns - self._heard_ns[joint] > timeout_ns and joint not in self._roll.silent:
                self._faults.append(
                    f"drive {node_id}: no heartbeat for {self._can.heartbeat_timeout_ms} ms"
                )
                self._roll.silent.add(joint)
        faults, self._faults = self._faults, []
        if faults and not self._is_stopping:
            raise DriveError("; ".join(dict.fromkeys(faults)))

    def _hand_over(self, frame: CanFrame) -> None:
        """Give canopen a frame that a drive may send; what it cannot read is ignored.

        canopen would also take in torques that a stranger sends, and go on with those.

        It goes without a time stamp: from two of them canopen would take an event-driven PDO for a
        periodic one, and wait for more.
        """
        if frame.identifier & ~0x7F not in _FROM_DRIVES:
            return
        try:
            self._network.notify(frame.identifier, bytearray(frame.data), None)  # type: ignore[arg-type]
        except Exception as error:  # noqa: BLE001 (nothing that comes from a bus may stop us)
            logger.warning("frame ignored: %s: %s", frame, error)

    @contextlib.contextmanager
    def _listening(self) -> Iterator[None]:
        """Hand frames to canopen, on a thread, since its requests wait for their answers."""
        over = threading.Event()

        def hand_over() -> None:
            while not over.is_set():
                frame = self._bus.receive(_POLL_S)
                if frame is not None and is_classical_data(frame, len(frame.data)):
                    self._hand_over(frame)

        thread = threading.Thread(target=hand_over, daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()


def _strike_off(missing: set[int], node_id: int, state: int) -> None:
    """A heartbeat has come; a node that has just booted is missing no longer."""
    if state == _BOOT_UP:
        missing.discard(node_id)


class _Network(canopen.Network):
    """canopen's network on a bus of ours."""

    def __init__(self, bus: CanBus) -> None:
        super().__init__()
        self._our_bus = bus

    def send_message(self, can_id: int, data: Any, remote: bool = False) -> None:
        """Send a frame."""
        self._our_bus.send(CanFrame(can_id, bytes(data), is_remote=remote))


_EMERGENCY = struct.Struct("<HB5s")
