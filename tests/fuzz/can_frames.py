"""Mutated CAN frames between the true ones that enable drives and command them."""

from __future__ import annotations

import math
import re
import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import cycle
from pathlib import Path

import numpy as np
from mutation import Mutator

from bus_schema.can.frame import CanFrame
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from plant_emulator.drives.bank import DriveBank
from plant_emulator.drives.cansimple.drive import CanSimpleDrive
from plant_emulator.drives.cia402.drive import Cia402Drive
from tests.plant_emulator.drives.dialects import DIALECTS

NODES = (1, 2, 3)
RATED_NM, LIMIT_NM = 20.0, 60.0
_FROM_MASTER = {
    "cia402": re.compile(r"^(000|080|77F|[236]0[123])#"),
    # requests without data, and axis states, modes, torques and cleared errors
    "cansimple": re.compile(r"^\w{3}#R|^(0[246][7BE]|[035]\w8)#"),
    "mit": re.compile(r"^00[123]#"),  # replies have identifier 0
    "damiao": re.compile(r"^(00[123]|7FF)#"),
    "moteus": re.compile(r"^(0000800|00)[123]#"),
}
_MS, _TRUE_FRAMES = 1_000_000, 4
_FLAGS = ("is_extended", "is_remote", "is_error", "is_fd")
_RPDO_1, _SET_INPUT_TORQUE = 0x200, 0x0E


class CanTarget:
    """Drives that hear what their master sent in a run, and a mutated frame before each of it.

    Attributes:
        kinds: mutated frames by what was done to them.
        commanded: mutated frames that were torques, and acted as the torques that they were.
        reasons: why frames were refused.
    """

    def __init__(self, protocol: str, seed: int, folder: Path) -> None:
        self._dialect, self._torque_in = DIALECTS[protocol], _TORQUES[protocol]
        self._is_fd = protocol == "moteus"
        self._most_bytes = 64 if self._is_fd else 8
        self._mutator = Mutator(seed)
        self._corpus = frames_of_master(protocol, folder)
        self._script: Iterator[CanFrame] = cycle(self._corpus)
        self._now_ns = 0
        self.kinds: Counter[str] = Counter()
        self.reasons: Counter[str] = Counter()
        self.commanded = 0
        self._sent: list[CanFrame] = []
        self._switch_on()

    def attack(self) -> None:
        """Send a mutated frame, and check what it did; then go on as the master would.

        Several true frames for each mutated one: else the drives hardly ever get enabled.
        """
        self._send(self._mutated(self._mutator.choose(self._corpus)), is_mutated=True)
        for _ in range(_TRUE_FRAMES):
            true = next(self._script)
            if true is self._corpus[0]:
                self._switch_on()
            self._send(true, is_mutated=False)

    def _switch_on(self) -> None:
        self.reasons.update(self._bank.rejections.counts if self._now_ns else {})
        drives = [
            replace(self._dialect.settings(node, LIMIT_NM, 50.0), fd_process_data=self._is_fd)
            for node in NODES
        ]
        self._bank = DriveBank(self._dialect.drive, drives, self._sent.append)
        self._bank.advance(self._now_ns)

    def _send(self, frame: CanFrame, *, is_mutated: bool) -> None:
        before_nm = self._bank.torque_nm.copy()
        self._bank.receive(frame, self._now_ns)
        self._check(frame, before_nm, is_mutated=is_mutated)
        self._now_ns += _MS // 10
        self._bank.advance(self._now_ns)
        self._bank.describe(frame)
        assert all(len(sent.data) <= self._most_bytes for sent in self._sent)
        self._sent.clear()

    def _check(self, frame: CanFrame, before_nm: np.ndarray, *, is_mutated: bool) -> None:
        after_nm = self._bank.torque_nm
        assert np.abs(after_nm).max() <= LIMIT_NM
        assert not after_nm[self._bank.braked].any()
        if self._bank.closes_loops and self._dialect.drive in (Cia402Drive, CanSimpleDrive):
            return  # a mutation has switched a drive to position: torques are its own
        changed = np.flatnonzero((after_nm != before_nm) & (after_nm != 0.0))
        if changed.size == 0:
            return
        flags = {flag for flag in _FLAGS if getattr(frame, flag)}
        assert flags <= ({"is_fd", "is_extended"} if self._is_fd else set()), f"torque of {frame}"
        assert len(frame.data) <= self._most_bytes
        meant_nm = self._torque_in(frame)
        if meant_nm is not None:
            (joint,) = changed
            wanted_nm = min(max(meant_nm, -LIMIT_NM), LIMIT_NM)
            assert math.isclose(after_nm[joint], wanted_nm, rel_tol=1e-6, abs_tol=1e-9), frame
            self.commanded += is_mutated

    def _mutated(self, frame: CanFrame) -> CanFrame:
        kind = self._mutator.choose(("data", "data", "identifier", "flags", "all"))
        self.kinds[kind] += 1
        if kind in ("data", "all"):
            frame = frame._replace(data=self._mutator.bytes(frame.data)[:64])
        if kind in ("identifier", "all"):
            bits = 29 if self._mutator.chance(0.1) else 11
            flipped = frame.identifier ^ 1 << self._mutator.choose(range(bits))
            frame = frame._replace(identifier=flipped)
        if kind in ("flags", "all"):
            flag = self._mutator.choose(_FLAGS)
            frame = frame._replace(**{flag: not getattr(frame, flag)})
        return frame


def _of_cia402(frame: CanFrame) -> float | None:
    """The torque that a frame commands, read by the protocol's own book, N m; so the next two."""
    if frame.identifier & 0x780 == _RPDO_1 and len(frame.data) == 4:
        return float(struct.unpack("<Hh", frame.data)[1] * RATED_NM / 1000)
    return None


def _of_cansimple(frame: CanFrame) -> float | None:
    if frame.identifier & 0x1F == _SET_INPUT_TORQUE and len(frame.data) >= 4:
        return float(struct.unpack_from("<f", frame.data)[0])
    return None


def _of_mit(frame, velocity_rad_s=50.0, limit_nm=18.0, most_nm=18.0):
    """The loop's torque where these joints are, at 0 and at rest; ranges are the AK80-9's."""
    if len(frame.data) != 8 or frame.data[:7] == b"\xff" * 7:
        return None
    bits = "".join(f"{byte:08b}" for byte in frame.data)
    places = ((0, 16, -12.5, 12.5), (16, 28, -velocity_rad_s, velocity_rad_s), (28, 40, 0, 500),
              (40, 52, 0, 5), (52, 64, -limit_nm, limit_nm))  # fmt: skip
    position, velocity, stiffness, damping, torque_nm = (
        low + int(bits[first:end], 2) / (2 ** (end - first) - 1) * (high - low)
        for first, end, low, high in places
    )
    wanted_nm = torque_nm + stiffness * position + damping * velocity
    return min(max(wanted_nm, -most_nm), most_nm)


def _of_damiao(frame: CanFrame) -> float | None:
    return _of_mit(frame, 30.0, 10.0, 7.0) if frame.identifier in NODES else None


def _of_moteus(frame: CanFrame) -> float | None:
    """Of what the master sends: position mode without gains, five floats from 0x020 on."""
    if len(frame.data) != 32 or not frame.data.startswith(bytes.fromhex("01000a0c0520")):
        return None
    _, _, torque_nm, kp_scale, kd_scale = struct.unpack_from("<fffff", frame.data, 6)
    is_plain = kp_scale == kd_scale == 0.0 and frame.data[26:28] == bytes.fromhex("0d27")
    return float(torque_nm) if is_plain else None


_TORQUES = {
    "cia402": _of_cia402, "cansimple": _of_cansimple, "mit": _of_mit, "damiao": _of_damiao,
    "moteus": _of_moteus,
}  # fmt: skip


def frames_of_master(protocol: str, folder: Path) -> list[CanFrame]:
    """What a master sends in a short run: all that enables the drives, and some cycles."""
    log = folder / f"{protocol}.log"
    values = ["duration_s=0.1", "link.can.interface=virtual", f"link.can.protocol={protocol}"]
    if protocol == "moteus":
        fd = ("fd=true", "fd_process_data=true", "data_bitrate=5000000")
        values += [f"link.can.{each}" for each in fd]
    simulate(load_setup("paper_arm_can", values), can_log=log)
    contents = [line.split()[2] for line in log.read_text().splitlines()]
    frames = []
    for content in filter(_FROM_MASTER[protocol].match, contents):
        is_fd = "##" in content
        identifier, data = content.replace("##1", "#").split("#")
        is_remote = data == "R"
        given = b"" if is_remote else bytes.fromhex(data)
        is_long = len(identifier) > 3
        frames.append(CanFrame(int(identifier, 16), given, is_long, is_remote, is_fd=is_fd))
    return frames
