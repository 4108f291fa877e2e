"""Frames between a master and one drive, for each protocol, packed as its public description says.

They use none of our codecs.
"""

from __future__ import annotations

import math
import struct
from typing import ClassVar

from bus_schema.can.cia402.codec import Cia402Settings
from bus_schema.can.damiao.protocol import DamiaoSettings
from bus_schema.can.frame import CanFrame
from bus_schema.can.mit.protocol import MitSettings
from bus_schema.link.can_configuration import CanSimpleConfiguration
from plant_emulator.drives.cansimple.drive import CanSimpleDrive
from plant_emulator.drives.cia402.drive import Cia402Drive
from plant_emulator.drives.damiao.drive import DamiaoDrive
from plant_emulator.drives.drive import DriveFault, DriveSettings
from plant_emulator.drives.mit.drive import MitDrive
from plant_emulator.drives.moteus.drive import MoteusDrive

TURN = 2.0 * math.pi
AK80_9, DM4310 = (12.5, 50.0, 500.0, 5.0, 18.0), (12.5, 30.0, 500.0, 5.0, 10.0)
"""Largest position, velocity, stiffness, damping and torque in a frame."""

CLEAR, ENABLE, DISABLE, ZERO = (bytes([255] * 7 + [last]) for last in (0xFB, 0xFC, 0xFD, 0xFE))
"""Special frames of MIT drives; Damiao motors alone have the first."""


def to_uint(value, low, high, bits):
    """float_to_uint of the mini-cheetah's motor controller."""
    return int((value - low) * ((1 << bits) - 1) / (high - low))


def to_float(bits, low, high, length):
    return bits * (high - low) / ((1 << length) - 1) + low


def command(p=0.0, v=0.0, kp=0.0, kd=0.0, t=0.0, *, ranges=AK80_9):
    """pack_cmd, bit by bit as the description draws the eight bytes."""
    p_max, v_max, kp_max, kd_max, t_max = ranges
    p, v = to_uint(p, -p_max, p_max, 16), to_uint(v, -v_max, v_max, 12)
    kp, kd = to_uint(kp, 0.0, kp_max, 12), to_uint(kd, 0.0, kd_max, 12)
    t = to_uint(t, -t_max, t_max, 12)
    return bytes([
        p >> 8, p & 0xFF, v >> 4, (v & 0xF) << 4 | kp >> 8, kp & 0xFF, kd >> 4,
        (kd & 0xF) << 4 | t >> 8, t & 0xFF,
    ])  # fmt: skip


def unpacked(data, ranges=AK80_9):
    """unpack_reply: id, position, velocity, torque."""
    p_max, v_max, _, _, t_max = ranges
    return (
        data[0],
        to_float(data[1] << 8 | data[2], -p_max, p_max, 16),
        to_float(data[3] << 4 | data[4] >> 4, -v_max, v_max, 12),
        to_float((data[4] & 0xF) << 8 | data[5], -t_max, t_max, 12),
    )


class Mit:
    """Enters motor mode, asks for the state in the same way, and leaves motor mode.

    The other dialects have the same methods; each returns frames for the drive with an address.
    """

    drive, own, ranges = MitDrive, MitSettings(), AK80_9
    motion_step = 0.03  # of position, rad, and velocity, rad/s
    torque_step = 0.01
    faults: ClassVar = {
        DriveFault.DRIVE: "OVER_CURRENT (error 2)",
        DriveFault.OVER_TEMPERATURE: "OVER_TEMPERATURE (error 1)",
        DriveFault.ENCODER: "ENCODER (error 5)",
    }
    timeout = "command timeout"

    def settings(self, node, most_nm=60.0, watchdog_ms=0.0):
        return DriveSettings(node, most_nm, self.own, watchdog_ms=watchdog_ms)

    def start(self, node):
        return [CanFrame(node, ENABLE)]

    def request(self, node):
        return CanFrame(node, ENABLE)

    def torque(self, node, nm):
        return CanFrame(node, command(t=nm, ranges=self.ranges))

    def motion(self, answer):
        return unpacked(answer.data, self.ranges)[1:3]

    def stop(self, node):
        return [CanFrame(node, DISABLE)]

    def zero(self, node):
        return CanFrame(node, ZERO)

    reset = stop


class Damiao(Mit):
    drive, own, ranges = DamiaoDrive, DamiaoSettings(), DM4310
    faults: ClassVar = {
        DriveFault.DRIVE: "OVER_CURRENT (error 0xa)",
        DriveFault.OVER_TEMPERATURE: "COIL_HOT (error 0xc)",
        DriveFault.ENCODER: "SENSOR_ERROR (error 0x5)",
    }
    timeout = "LOST_COMMUNICATION (error 0xd)"

    def request(self, node):
        return CanFrame(0x7FF, bytes([node, 0, 0xCC, 0, 0, 0, 0, 0]))

    def reset(self, node):
        return [CanFrame(node, CLEAR)]


class CanSimple(Mit):
    drive, own = CanSimpleDrive, CanSimpleConfiguration()
    motion_step = torque_step = 1e-5
    faults: ClassVar = {
        DriveFault.DRIVE: "DRV_FAULT",
        DriveFault.OVER_TEMPERATURE: "MOTOR_OVER_TEMP",
        DriveFault.ENCODER: "MISSING_ESTIMATE",
    }
    timeout = "WATCHDOG_TIMER_EXPIRED"

    def message(self, node, number, form="", *values):
        return CanFrame(node << 5 | number, struct.pack("<" + form, *values))

    def start(self, node):
        return [self.message(node, 0x0B, "II", 1, 1), self.message(node, 0x07, "I", 8)]

    def request(self, node):
        return CanFrame(node << 5 | 0x09, is_remote=True)

    def torque(self, node, nm):
        return self.message(node, 0x0E, "f", nm)

    def motion(self, answer):
        return [each * TURN for each in struct.unpack("<ff", answer.data)]

    def stop(self, node):
        return [self.message(node, 0x07, "I", 1)]

    def zero(self, node):
        return self.message(node, 0x19, "f", 0.0)

    def reset(self, node):
        return [self.message(node, 0x18, "B", 0)]


class Moteus(Mit):
    """Its faults end by a stop; a timeout damps the joint."""

    drive, own = MoteusDrive, None
    motion_step = torque_step = 1e-5
    faults: ClassVar = {
        DriveFault.DRIVE: "fault 33",
        DriveFault.OVER_TEMPERATURE: "fault 38",
        DriveFault.ENCODER: "fault 35",
    }
    timeout = "command timeout (mode 11)"

    def start(self, node):
        return []

    def request(self, node):
        return CanFrame(0x8000 | node, bytes.fromhex("11001e01110f"))

    def torque(self, node, nm):
        numbers = struct.pack("<fffff", math.nan, math.nan, nm, 0.0, 0.0)
        return CanFrame(node, bytes.fromhex("01000a0c0520") + numbers)

    def motion(self, answer):
        return [each * TURN for each in struct.unpack_from("<ff", answer.data, 5)]

    def stop(self, node):
        return [CanFrame(node, b"\x01\x00\x00")]

    def zero(self, node):
        return CanFrame(node, bytes.fromhex("0db102") + struct.pack("<f", 0.0))

    reset = stop


class Cia402(Mit):
    drive, own = Cia402Drive, Cia402Settings(20.0)
    motion_step, torque_step = 1e-5, 0.01
    faults: ClassVar = {
        DriveFault.DRIVE: "short circuit in the power stage (0x2320)",
        DriveFault.OVER_TEMPERATURE: "over-temperature (0x4310)",
        DriveFault.ENCODER: "encoder cannot be read (0x7305)",
    }

    def control(self, node, word, nm=0.0):
        per_mille = round(nm / self.own.rated_torque_nm * 1000)
        return CanFrame(0x200 + node, struct.pack("<Hh", word, per_mille))

    def start(self, node):
        mode = CanFrame(0x600 + node, struct.pack("<BHBI", 0x2F, 0x6060, 0, 10))
        words = [self.control(node, word) for word in (6, 7, 15)]
        return [CanFrame(0, bytes([1, node])), mode, *words]

    def request(self, node):
        return CanFrame(0x80)

    def torque(self, node, nm):
        return self.control(node, 15, nm)

    def motion(self, answer):
        return [each * TURN / (1 << 20) for each in struct.unpack("<ii", answer.data)]

    def stop(self, node):
        return [self.control(node, 0)]

    def reset(self, node):
        return [self.control(node, 0), self.control(node, 128)]


DIALECTS = {
    "cia402": Cia402(), "cansimple": CanSimple(), "mit": Mit(), "damiao": Damiao(),
    "moteus": Moteus(),
}  # fmt: skip
