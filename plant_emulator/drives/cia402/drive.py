"""A CiA 402 servo drive in cyclic synchronous torque and position mode on CANopen."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from bus_schema.can.cia402.codec import Cia402Settings
from bus_schema.can.frame import CanFrame
from bus_schema.errors import InvalidMessageError
from plant_emulator.drives.cia402.describe import describe
from plant_emulator.drives.cia402.errors import SENTENCES, ErrorCode, ErrorLog
from plant_emulator.drives.cia402.motor import Motor
from plant_emulator.drives.cia402.network_state import HEARTBEAT, NetworkState, NmtCommand, NmtState
from plant_emulator.drives.cia402.node import LAST_COMMUNICATION, SDO_BYTES, DriveNode
from plant_emulator.drives.cia402.pdo import Pdo
from plant_emulator.drives.cia402.process_data import ProcessData
from plant_emulator.drives.cia402.state_machine import State
from plant_emulator.drives.drive import (
    Drive,
    DriveFault,
    DriveSettings,
    JointDemand,
    JointReading,
    Send,
)

_NMT = 0x000
_NMT_BYTES = 2
_ALL_NODES = 0
_LAST_OBJECT = 0xFFFF
_ERRORS = {
    DriveFault.DRIVE: ErrorCode.SHORT_CIRCUIT,
    DriveFault.OVER_TEMPERATURE: ErrorCode.OVER_TEMPERATURE,
    DriveFault.ENCODER: ErrorCode.ENCODER,
}
_AFTER_COMMUNICATION_ERROR = {0: NmtState.PRE_OPERATIONAL, 2: NmtState.STOPPED}


class Cia402Drive(Drive[Cia402Settings]):
    """The drive: what comes from the bus goes to NMT, SDO server, PDOs or heartbeat consumer."""

    def __init__(self, settings: DriveSettings[Cia402Settings], send: Send) -> None:
        super().__init__(settings, send)
        # Time of the last check for events; None if a new event may have happened since.
        self._looked_ns: int | None = None
        self._node = DriveNode(settings.node_id, self._transmit)
        self._network = NetworkState(self._node, self._transmit)
        self._errors = ErrorLog(self._node, self._network)
        self._motor = Motor(self._node, self._errors, settings)
        self._process_data = ProcessData(
            self._node, self._errors, self._transmit, is_fd=settings.fd_process_data
        )
        self._set_up()

    @property
    def targets(self) -> int:
        return self._node.targets

    @property
    def samplings(self) -> int:
        return self._process_data.samplings

    @property
    def state(self) -> State:
        """State of the automaton."""
        return self._motor.automaton.state

    @property
    def status(self) -> str:
        return self.state.name

    @property
    def fault(self) -> str | None:
        code = self._errors.fault
        return None if code is ErrorCode.NONE else f"{SENTENCES[code]} (0x{code:04X})"

    def measure(self, reading: JointReading) -> None:
        self._reading, self._looked_ns = reading, None
        self._motor.measure(reading)

    def demand(self) -> JointDemand:
        return self._motor.demand()

    def receive(self, frame: CanFrame, now_ns: int) -> bool:
        if self._is_off_bus or self._network.state is NmtState.INITIALISING:
            return False
        take = self._takers.get(frame.identifier)
        if take is None and not frame.is_remote:
            return False  # most are for others
        self._node.now_ns = now_ns
        if frame.identifier != self._process_data.sync_identifier:
            self._looked_ns = None
        try:
            if take is None or frame.is_remote:
                is_mine = self._answer_remote(frame.identifier)
            else:
                take(frame.data)
                is_mine = True
        except InvalidMessageError:
            self._send_events()
            raise
        if is_mine and self._looked_ns != now_ns:
            self._send_events()
        return is_mine

    def advance(self, now_ns: int) -> None:
        self._node.now_ns = now_ns
        if self._network.state is NmtState.INITIALISING:
            self._network.boot()
            self._set_up()
            if self.state is State.NOT_READY_TO_SWITCH_ON:
                self._motor.automaton.power_on()
                if (fault := self._lasting_fault) is not None:
                    self._fail(fault, now_ns)
        if self._network.advance():
            self._lose_master(ErrorCode.HEARTBEAT_LOST, lasting=True)
            self._send_events()
            self._leave_operational()
        if self._is_operational() and self._process_data.has_overdue():
            self._lose_master(ErrorCode.RPDO_TIMEOUT, lasting=False)
        self._motor.advance()
        self._send_events()

    def _fail(self, fault: DriveFault, now_ns: int) -> None:
        self._node.now_ns = now_ns
        code = _ERRORS[fault]
        self._motor.fail(code, power_off=fault is not DriveFault.OVER_TEMPERATURE)
        self._errors.note(code, lasting=fault is not DriveFault.DRIVE)
        self._send_events()

    def clear(self, fault: DriveFault, now_ns: int) -> None:
        super().clear(fault, now_ns)
        if fault in _ERRORS:
            self._looked_ns = None
            self._errors.cause_gone(_ERRORS[fault])

    def lose_bus(self, now_ns: int) -> None:
        self._node.now_ns = now_ns
        super().lose_bus(now_ns)
        self._looked_ns = None
        self._motor.abort_connection(ErrorCode.BUS_OFF)
        self._leave_operational()

    def regain_bus(self, now_ns: int) -> None:
        self._node.now_ns = now_ns
        super().regain_bus(now_ns)
        self._errors.note(ErrorCode.BUS_OFF)
        self._send_events()

    def describe(self, frame: CanFrame) -> str | None:
        return describe(frame, self._node, self._process_data)

    def _set_up(self) -> None:
        """Look up in the dictionary which part of the drive receives which identifier."""
        self._node.is_set_up_anew = False
        self._process_data.note_set_up()
        self._network.note_set_up()
        takers: dict[int, Callable[[bytes], None]] = {
            HEARTBEAT + node_id: partial(self._take_heartbeat, node_id)
            for node_id in self._network.watched
        }
        for identifier, pdo in self._process_data.received_by().items():
            takers[identifier] = partial(self._take_pdo, pdo)
        takers[self._node.sdo.rx_cobid] = self._serve_sdo
        takers[self._process_data.sync_identifier] = self._take_sync
        takers[_NMT] = self._obey_master
        self._takers = takers
        self.identifiers = {*takers, *self._process_data.sent_identifiers}
        self.on_set_up()

    def _take_sync(self, data: bytes) -> None:
        if self._is_operational() and self._process_data.sync(data):
            self._looked_ns = None

    def _take_pdo(self, pdo: Pdo, data: bytes) -> None:
        if self._is_operational():
            self._process_data.receive(pdo, data)

    def _take_heartbeat(self, node_id: int, _data: bytes) -> None:
        if self._network.note_heartbeat(node_id):
            self._errors.cause_gone(ErrorCode.HEARTBEAT_LOST)

    def _answer_remote(self, identifier: int) -> bool:
        pdo = self._process_data.sending(identifier)
        if pdo is None or not pdo.answers_remote or not self._is_operational():
            return False
        self._process_data.transmit(pdo, pdo.pack())
        return True

    def _serve_sdo(self, data: bytes) -> None:
        if len(data) != SDO_BYTES:
            raise InvalidMessageError("sdo_length", f"an SDO request has 8 bytes: {data!r}")
        if self._network.has_sdo:
            self._node.sdo.on_request(self._node.sdo.rx_cobid, data, 0.0)
            if self._node.is_set_up_anew:
                self._set_up()

    def _obey_master(self, data: bytes) -> None:
        if len(data) != _NMT_BYTES:
            raise InvalidMessageError("nmt_length", f"an NMT command has 2 bytes: {data!r}")
        if data[0] not in list(NmtCommand):
            raise InvalidMessageError("nmt_command", f"there is no NMT command {data[0]}")
        if data[1] not in (_ALL_NODES, self._node.node_id):
            return
        command = NmtCommand(data[0])
        if command is NmtCommand.RESET_NODE:
            self._restart()
        elif command is NmtCommand.RESET_COMMUNICATION:
            self._motor.abort_connection(ErrorCode.STOPPED)
            self._reset(LAST_COMMUNICATION)
        else:
            if command is NmtCommand.STOP:
                self._motor.abort_connection(ErrorCode.STOPPED)
            self._network.obey(command)
            self._process_data.rest()

    def _restart(self) -> None:
        """Reset as after power-off; the drive boots at its next `advance`."""
        self._motor.automaton.power_off()
        self._errors.forget()
        self._reset(_LAST_OBJECT)
        self._motor.restore()

    def _reset(self, last: int) -> None:
        self._node.restore_defaults(0x1000, last)
        self._process_data.rest()
        self._set_up()
        self._network.state = NmtState.INITIALISING

    def _send_events(self) -> None:
        self._looked_ns = self._node.now_ns
        if self._is_operational():
            self._process_data.send_events()

    def _is_operational(self) -> bool:
        return self._network.state is NmtState.OPERATIONAL

    def _leave_operational(self) -> None:
        """Do what object 0x1029 demands after a communication error."""
        state = _AFTER_COMMUNICATION_ERROR.get(self._node.values[0x1029_01])
        if state is not None and self._is_operational():
            self._network.state = state
            self._process_data.rest()

    def _lose_master(self, code: ErrorCode, *, lasting: bool) -> None:
        self._motor.abort_connection(code)
        self._errors.note(code, lasting=lasting)
