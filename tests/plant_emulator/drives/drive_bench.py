"""A drive on a bench: frames in and out by hand, time by hand, a joint that the test moves."""

from __future__ import annotations

import struct

import canopen
from canopen.objectdictionary import ODVariable
from dialects import DIALECTS

from bus_schema.can.cia402.codec import Cia402Settings
from bus_schema.can.frame import CanFrame
from bus_schema.link.can_configuration import CIA402_EDS
from plant_emulator.drives.bank import DriveBank
from plant_emulator.drives.cia402.drive import Cia402Drive
from plant_emulator.drives.drive import DriveSettings, JointReading

NODE = 5
MS = 1_000_000
SETTINGS = DriveSettings(
    node_id=NODE,
    max_torque_nm=60.0,
    own=Cia402Settings(rated_torque_nm=20.0),
    counts_per_turn=1 << 20,
    stop_damping_nm_s=10.0,
)
SHUTDOWN, SWITCH_ON, ENABLE, DISABLE_VOLTAGE, QUICK_STOP, FAULT_RESET = 6, 7, 15, 0, 2, 128
CSP, CST = 8, 10
DICTIONARY = canopen.import_od(str(CIA402_EDS), NODE)


class AbortedError(Exception):
    """An SDO transfer was refused; its argument is the abort code."""


class Bench:
    """One drive, with what it sent."""

    def __init__(self, protocol=Cia402Drive, settings=SETTINGS, boot=True):
        self.sent = []
        self.now_ns = 0
        self.drive = protocol(settings, self.sent.append)
        if boot:
            self.wait(0)
            self.take()

    def wait(self, duration_ms, step_ms=1):
        """Let time pass."""
        for _ in range(round(duration_ms / step_ms)):
            self.now_ns += round(step_ms * MS)
            self.drive.advance(self.now_ns)
        if duration_ms == 0:
            self.drive.advance(self.now_ns)

    def answer(self, data, identifier=NODE):
        """Send a frame; return the only answer."""
        self.take()
        assert self.drive.receive(CanFrame(identifier, data), self.now_ns)
        (answer,) = self.take()
        return answer

    def hear(self, identifier, *data, remote=False):
        return self.drive.receive(CanFrame(identifier, bytes(data), is_remote=remote), self.now_ns)

    def take(self, identifier=None):
        """Frames sent since the last time, of an identifier if one is given: their data then."""
        taken, self.sent[:] = self.sent[:], []
        if identifier is None:
            return taken
        return [frame.data for frame in taken if frame.identifier == identifier]

    def move(self, position_rad=0.0, velocity_rad_s=0.0, torque_nm=0.0):
        self.drive.measure(JointReading(position_rad, velocity_rad_s, torque_nm))

    def sdo(self, request):
        """The answer to eight bytes of SDO request; none if there is none."""
        self.take()
        self.hear(0x600 + NODE, *request)
        answers = self.take(0x580 + NODE)
        answer = answers[0] if answers else None
        if answer is not None and answer[0] == 0x80:
            raise AbortedError(struct.unpack_from("<I", answer, 4)[0])
        return answer

    def read(self, index, subindex=0, signed=False):
        answer = self.sdo(struct.pack("<BHBI", 0x40, index, subindex, 0))
        assert answer[0] & 0xE3 == 0x43, "expedited, with its size"
        size = 4 - (answer[0] >> 2 & 3)
        return int.from_bytes(answer[4 : 4 + size], "little", signed=signed)

    def write(self, index, subindex, value, size=None):
        if size is None:
            entry = DICTIONARY[index]
            size = len(entry if isinstance(entry, ODVariable) else entry[subindex]) // 8
        data = (value % (1 << 8 * size)).to_bytes(size, "little") + bytes(4 - size)
        command = 0x23 | (4 - size) << 2
        self.sdo(struct.pack("<BHB", command, index, subindex) + data)

    # CiA 402

    def start(self):
        """NMT start of all nodes."""
        self.hear(0, 1, 0)
        self.take()

    def control(self, word, torque=0):
        """RPDO 1: controlword and target torque, per mille."""
        self.hear(0x200 + NODE, *struct.pack("<Hh", word, torque))

    @property
    def statusword(self):
        return self.read(0x6041)

    @property
    def state(self):
        return self.drive.state.name

    def enable(self, torque=0, mode=CST):
        """Power-on to operation enabled, in cyclic synchronous torque mode if none is given."""
        self.start()
        self.write(0x6060, 0, mode)
        for word in (SHUTDOWN, SWITCH_ON, ENABLE):
            self.control(word, torque)
        assert self.state == "OPERATION_ENABLED"
        self.take()


class Bank:
    """Drives of a protocol, and their master.

    Attributes:
        bank: the drives.
        dialect: frames between them and their master.
    """

    def __init__(self, protocol, nodes=(1, 2, 3), **settings):
        self.protocol, self.dialect, self.nodes = protocol, DIALECTS[protocol], nodes
        self._sent = []
        drives = [self.dialect.settings(node, **settings) for node in nodes]
        self.bank = DriveBank(self.dialect.drive, drives, self._sent.append)
        self.bank.advance(0)

    def send(self, *frames):
        """Send frames; return the answers."""
        self.take()
        for frame in frames:
            self.bank.receive(frame, 0)
        return self.take()

    def take(self):
        """Return the frames sent since the last call."""
        taken, self._sent[:] = self._sent[:], []
        return taken

    def enable(self, torque_nm=0.0):
        for node in self.nodes:
            self.send(*self.dialect.start(node), self.dialect.torque(node, torque_nm))
        self.bank.take_targets()

    def target(self, node, torque_nm):
        self.send(self.dialect.torque(node, torque_nm))

    def sample(self):
        """Request all states; return the answers."""
        return self.send(*dict.fromkeys(self.dialect.request(node) for node in self.nodes))

    @property
    def torque_nm(self):
        """Torque of the first drive."""
        return float(self.bank.torque_nm[0])

    def assert_refused(self, frame):
        """Send a frame that has to be counted and change nothing."""
        before = sum(self.bank.rejections.counts.values()), self.torque_nm, self.bank.braked[0]
        self.send(frame)
        after = sum(self.bank.rejections.counts.values()) - 1, self.torque_nm, self.bank.braked[0]
        assert before == after, frame
