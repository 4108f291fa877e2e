"""Master of CiA 402 drives on CANopen, in cyclic synchronous torque or position mode.

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

from canopen.emcy import EmcyError
from canopen.profiles.p402 import BaseNode402, State402
from canopen.sdo.exceptions import SdoError

from bus_schema.can.cia402.canopen_adapter import CanopenNetwork, object_dictionary
from bus_schema.can.cia402.codec import POSITION, Cia402Codec
from bus_schema.can.frame import CanBus, CanFrame, is_data
from bus_schema.can.master import CanMaster, DriveError
from bus_schema.errors import BusError
from bus_schema.link.can_configuration import CIA402_EDS, CanConfiguration

logger = logging.getLogger(__name__)
# canopen reports in its log what it then raises.
logging.getLogger("canopen").setLevel(logging.CRITICAL)

MASTER_NODE = 127
_EMCY, _TPDO_2, _HEARTBEAT = 0x080, 0x280, 0x700
_FROM_DRIVES = (_EMCY, 0x180, _TPDO_2, 0x380, 0x480, 0x580, _HEARTBEAT)
_OF_MASTER = {0x000: "NMT", 0x080: "SYNC", _HEARTBEAT + MASTER_NODE: "the master's heartbeat"}
_TO_DRIVES = {
    0x200: "RPDO 1", 0x300: "RPDO 2", 0x400: "RPDO 3", 0x500: "RPDO 4", 0x600: "SDO requests"
}  # fmt: skip
_OPERATIONAL, _BOOT_UP = 5, 0
_STATUSWORD, _EMERGENCY = struct.Struct("<H"), struct.Struct("<HB5s")
_POWERED = ("OPERATION ENABLED", "QUICK STOP ACTIVE", "FAULT REACTION ACTIVE")
_POLL_S = 0.005


class Cia402Master(CanMaster):
    """The master; the arguments are those of `CanMaster`.

    In position mode it maps RPDO 3 and 4, and writes the gains to objects 0x60FB and 0x60F9, whose
    contents each maker decides on: these are those of our description.
    """

    ask_again_s = 1.0
    _codec: Cia402Codec

    def __init__(
        self, bus: CanBus, can: CanConfiguration, node_ids: tuple[int, ...], codec: Cia402Codec
    ) -> None:
        super().__init__(bus, can, node_ids, codec)
        self._mode = codec.mode
        self._network = CanopenNetwork(bus.send)
        self._nodes = [
            BaseNode402(node_id, object_dictionary(can.eds or CIA402_EDS, node_id))
            for node_id in node_ids
        ]
        for joint, node in enumerate(self._nodes):
            node.sdo.RESPONSE_TIMEOUT = node.TIMEOUT_SWITCH_OP_MODE = can.answer_timeout_s
            node.TIMEOUT_SWITCH_STATE_FINAL = can.answer_timeout_s
            node.TIMEOUT_SWITCH_STATE_SINGLE = can.answer_timeout_s
            self._network.add_node(node)
            node.nmt.add_heartbeat_callback(partial(self._note_boot, joint))
        self._last_heartbeat_ns = [0] * len(node_ids)
        self._is_in_cycle = [False] * len(node_ids)
        self._start_timeout_ms = float(can.heartbeat_timeout_ms)
        self._emergencies = [""] * len(node_ids)
        self._alarmed: set[int] = set()
        self._lost: BusError | None = None

    def enable(self, timeout_s: float, is_stop_requested: Callable[[], bool]) -> bool:
        self._start_timeout_ms = max(1000.0 * timeout_s, self._can.heartbeat_timeout_ms)
        with self._listening():
            if not self._await_drives(
                timeout_s, lambda: self._lost is not None or is_stop_requested()
            ):
                return False
            for joint, node in enumerate(self._nodes):
                try:
                    self._check(joint, node)
                    self._enable(node)
                except (SdoError, RuntimeError, ValueError) as error:
                    raise DriveError(f"drive {node.id} does not follow: {error}") from error
            for node in self._nodes:
                # From now on torques must keep coming; the last one came long ago.
                node.rpdo[self._mode.command_pdo].transmit()
                communication = 0x1400 + self._mode.command_pdo - 1
                self._set(node, communication, 5, self._can.command_timeout_ms)
        self._is_powered = [True] * len(self._nodes)
        return True

    def begin_stop(self) -> None:
        super().begin_stop()
        self._codec.begin_quick_stop()

    def leave(self) -> None:
        self._network.nmt.state = "PRE-OPERATIONAL"

    def _ask(self) -> None:
        for joint in sorted(self._absent):
            self._nodes[joint].nmt.state = "RESET"

    def _listen(self) -> None:
        time.sleep(_POLL_S)  # meanwhile, another thread hands over what comes

    def _note_boot(self, joint: int, state: int) -> None:
        """A heartbeat has come; a drive that has just booted has turned up."""
        if state == _BOOT_UP:
            self._absent.discard(joint)

    def _check(self, joint: int, node: BaseNode402) -> None:
        """Whether the drive is what the scenario says it is."""
        wanted = {
            "device profile (0x1000)": (node.sdo[0x1000].raw & 0xFFFF, 402),
            "rated torque in mN m (0x6076)": (
                node.sdo[0x6076].raw, int(self._codec.rated_mnm[joint])
            ),
            "encoder increments per turn (0x608F)": (
                node.sdo[0x608F][1].raw, self._can.counts_per_turn
            ),
        }  # fmt: skip
        for what, (found, expected) in wanted.items():
            if found != expected:
                raise DriveError(f"drive {node.id}: {what} is {found}, not {expected}")
        if not node.is_op_mode_supported(self._mode.name):
            raise DriveError(f"drive {node.id} has no {self._mode.name.lower()} mode (0x6502)")

    def _enable(self, node: BaseNode402) -> None:
        """From pre-operational to operation enabled, as canopen's documentation shows it."""
        self._set(node, 0x1016, 1, MASTER_NODE << 16 | self._can.heartbeat_timeout_ms)
        self._set(node, 0x1017, 0, self._can.heartbeat_ms)
        node.nmt.state = "PRE-OPERATIONAL"
        if self._mode is POSITION:
            self._prepare_position_mode(node)
        node.setup_402_state_machine()
        node.nmt.state = "OPERATIONAL"
        if node.state == "FAULT":
            node.reset_from_fault()
        node.op_mode = self._mode.name
        if node.op_mode != self._mode.name:
            raise DriveError(f"drive {node.id} stays in mode {node.op_mode}")
        if self._mode is POSITION:  # the first target is where the joint is: else it is a step
            node.rpdo[3]["Target position"].raw = node.sdo[0x6064].raw
        node.state = "OPERATION ENABLED"

    def _prepare_position_mode(self, node: BaseNode402) -> None:
        """Map targets and set the gains of a drive that is pre-operational."""
        node.rpdo.read()
        node.rpdo[1].enabled = False
        for number, objects in self._mode.mapped.items():
            pdo = node.rpdo[number]
            pdo.clear()
            for index in objects:
                pdo.add_variable(index)
            pdo.enabled = True
        node.rpdo.save()
        position_gain, velocity_gain = self._codec.loop_gains[self._nodes.index(node)]
        self._set(node, 0x60FB, 1, position_gain)
        self._set(node, 0x60F9, 1, velocity_gain)
        self._set(node, 0x60F9, 2, 0)

    def _set(self, node: BaseNode402, index: int, subindex: int, value: int) -> None:
        entry = node.sdo[index]
        variable = entry[subindex] if subindex else entry
        variable.raw = value

    def _send_heartbeat(self) -> None:
        self._bus.send(CanFrame(_HEARTBEAT + MASTER_NODE, bytes([_OPERATIONAL])))

    def _only_master_sends(self, frame: CanFrame) -> str | None:
        if frame.is_remote:
            return None
        if frame.identifier in _OF_MASTER:
            return _OF_MASTER[frame.identifier]
        function, node_id = frame.identifier & ~0x7F, frame.identifier & 0x7F
        return _TO_DRIVES.get(function) if node_id in self._joint_of else None

    def _handle_report(self, frame: CanFrame) -> None:
        """Take in emergencies, status words and heartbeats."""
        function, node_id = frame.identifier & ~0x7F, frame.identifier & 0x7F
        joint = self._joint_of.get(node_id)
        if joint is None:
            return
        if function == _EMCY and len(frame.data) == _EMERGENCY.size:
            self._note_emergency(joint, frame.data)
        elif function == _TPDO_2 and len(frame.data) >= _STATUSWORD.size:
            self._note_status(joint, node_id, *_STATUSWORD.unpack_from(frame.data))
        elif function == _HEARTBEAT and frame.data:
            self._last_heartbeat_ns[joint] = self._now_ns
            if frame.data[0] != _OPERATIONAL:
                self._faults.append(f"drive {node_id} is no longer operational")

    def _note_emergency(self, joint: int, data: bytes) -> None:
        """Remember why a drive may be about to stop; that it does, its statusword reports."""
        code, register, _ = _EMERGENCY.unpack(data)
        text = f"emergency 0x{code:04X} ({EmcyError(code, register, b'', 0.0).get_desc()})"
        self._emergencies[joint] = f", {text}" if code else ""
        # 0x82xx is about a frame that the drive ignores. One of each drive: many may be forged.
        if code and code >> 8 != 0x82 and joint not in self._alarmed:
            self._alarmed.add(joint)
            self.emergencies.append(f"drive {self._node_ids[joint]} sent {text}")

    def _note_status(self, joint: int, node_id: int, word: int) -> None:
        states = [name for name, (mask, bits) in State402.SW_MASK.items() if word & mask == bits]
        state = states[0] if states else f"unknown state 0x{word:04X}"
        self._is_powered[joint] = state in _POWERED
        if state != "OPERATION ENABLED":
            self._faults.append(f"drive {node_id}: {state.lower()}{self._emergencies[joint]}")

    def _missed_heartbeats(self) -> list[str]:
        """As in `CanMaster`; a drive is watched from its first state on, which may come late."""
        sentences = []
        for node_id, joint in self._joint_of.items():
            if self._answers[joint] and not self._is_in_cycle[joint]:
                self._is_in_cycle[joint] = True
                self._last_heartbeat_ns[joint] = self._now_ns
            is_watched = self._is_in_cycle[joint]
            timeout_ms = self._can.heartbeat_timeout_ms if is_watched else self._start_timeout_ms
            age_ns = self._now_ns - self._last_heartbeat_ns[joint]
            if age_ns > timeout_ms * 1_000_000 and joint not in self._silent:
                sentences.append(f"drive {node_id}: no heartbeat for {timeout_ms:g} ms")
                self._silent.add(joint)
        return sentences

    def _hand_over(self, frame: CanFrame) -> None:
        """Give canopen a frame that a drive may send; what it cannot read is ignored.

        canopen would also take in torques that another node sends, and go on with those.

        It goes without a time stamp: from two of them canopen would take an event-driven PDO for a
        periodic one, and wait for more.
        """
        if frame.identifier & ~0x7F not in _FROM_DRIVES:
            return
        try:
            self._network.notify(frame.identifier, bytearray(frame.data), None)  # type: ignore[arg-type]
        except Exception as error:  # noqa: BLE001 (nothing that comes from a bus may stop us)
            logger.warning("frame ignored: %s: %s", frame, error)

    def _is_for_canopen(self, frame: CanFrame) -> bool:
        is_fd = frame.is_fd and self._can.fd_process_data
        return is_data(frame, len(frame.data), is_fd=is_fd)

    @contextlib.contextmanager
    def _listening(self) -> Iterator[None]:
        """Hand frames to canopen, on a thread, since its requests wait for their answers.

        Raises:
            BusError: the bus was lost meanwhile, even if another error followed.
        """
        over = threading.Event()

        def hand_over() -> None:
            try:
                while not over.is_set():
                    frame = self._bus.receive(_POLL_S)
                    if frame is not None:
                        self._note_stranger(frame)
                    if frame is not None and self._is_for_canopen(frame):
                        self._hand_over(frame)
            except BusError as error:
                self._lost = error

        thread = threading.Thread(target=hand_over, daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join()
            if self._lost is not None:
                raise self._lost
