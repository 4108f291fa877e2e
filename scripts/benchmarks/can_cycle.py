"""Cost of a control cycle over CAN for master and drives, beside python-can's bare calls.

Master and drives of CiA 402 are on one bus in one thread, which takes their turns: no side waits,
so what is measured is work. The bare calls make the messages of the same frames, send and
receive them; each of their buses only sends or only receives, since python-can hears itself.

Beside both is a cycle with nothing in it that could be left out, compiled: the frames of SocketCAN
(16 bytes) are packed, sent, received and unpacked between two connected datagram sockets, by system
calls, with no protocol, no checks and no time-outs. Run it with
`python -m scripts.benchmarks.can_cycle`.
"""

from __future__ import annotations

import ctypes
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from bus_schema.can.cia402.codec import Cia402Codec, Cia402Settings
from bus_schema.can.cia402.master import Cia402Master
from bus_schema.can.exchange import FrameExchange
from bus_schema.can.frame import CanFrame
from bus_schema.can.medium import CandumpLog, CanMedium
from bus_schema.can.session import open_can_bus, open_python_can, to_message
from bus_schema.link.can_configuration import CanConfiguration
from bus_schema.runtime.compiled import c_function, compiled
from deploy.run.network.links import free_ports
from deploy.studies.bench.command import show_section
from deploy.studies.bench.measure import Costs, Ratio, Section, interleave, ratio
from plant_emulator.drives.bank import DriveBank
from plant_emulator.drives.cia402.drive import Cia402Drive
from plant_emulator.drives.drive import DriveSettings
from plant_emulator.drives.drives_on_bus import DrivesOnBus

SIZES = (3, 7, 14)
_RATED_NM, _LARGEST_NM = 10.0, 300.0
_PERIOD_NS = 2_000_000
_GROUPS = "239.74.163.{}"
_LONG_S = 20.0
_INTERFACES = ("virtual", "udp_multicast")
_LIBC = ctypes.CDLL(None)
_send = c_function(_LIBC, "send", "intp", "intc", "uintp", "uintp", "intc")
_receive = c_function(_LIBC, "recv", "intp", "intc", "uintp", "uintp", "intc")


def measure_can_cycles(cycles: int, repetitions: int) -> Section:
    """Measure cycles of 3, 7 and 14 drives.

    Args:
        cycles: in each repetition.
        repetitions: how often everything is measured.

    Raises:
        OSError: there is no multicast here.
    """
    candidates: dict[str, Callable[[], dict[str, float]]] = {}
    with ExitStack() as stack:
        for interface in _INTERFACES:
            for size in SIZES:
                bus = f"{interface}, {size} drives"
                for whose, opened in (("", _ours), ("bare ", _bare)):
                    cycle = stack.enter_context(opened(interface, size))
                    names = f"{whose}master, {bus}", f"{whose}drives, {bus}"
                    candidates[whose + bus] = partial(_mean_us, cycle, cycles, names)
        for size in SIZES:
            candidates[f"compiled, {size}"] = partial(_compiled_us, size, cycles)
        costs = interleave(candidates, repetitions)
    return Section("Cycle over CAN, CiA 402", costs, _ratios(costs))


def _ratios(costs: Costs) -> list[Ratio]:
    """To the bare calls; to the compiled loop; growth with the number of drives."""
    sides = [f"{side}, {interface}" for interface in _INTERFACES for side in ("master", "drives")]
    ratios = [
        ratio(costs, f"{side}, {size} drives", f"bare {side}, {size} drives")
        for side in sides for size in SIZES
    ]  # fmt: skip
    for size in SIZES:
        both = [f"{side}, {_INTERFACES[-1]}, {size} drives" for side in ("master", "drives")]
        ratios.append(ratio(costs, both, f"compiled loop, {size} drives"))
    growth = [
        ratio(costs, f"{side}, {size} drives", f"{side}, {SIZES[0]} drives")
        for side in sides for size in SIZES[1:]
    ]  # fmt: skip
    return ratios + growth


def _compiled_us(size: int, cycles: int) -> dict[str, float]:
    return {f"compiled loop, {size} drives": compiled_cycle_us(size, cycles)}


Cycle = Callable[[], Sequence[int]]
"""Runs one cycle; time in ns that the master took, and the drives."""


def _mean_us(cycle: Cycle, cycles: int, names: tuple[str, str]) -> dict[str, float]:
    total_ns = np.sum([cycle() for _ in range(cycles)], axis=0)
    return dict(zip(names, (total_ns / cycles * 1e-3).tolist(), strict=True))


@contextmanager
def _ours(interface: str, size: int) -> Iterator[Cycle]:
    """Master and drives, enabled, with the drives' log and the arithmetic of their bus's time."""
    can = _configuration(interface, size)
    exchange = FrameExchange()
    virtual = interface == "virtual"
    ends = [exchange.join() if virtual else open_can_bus(can) for _ in range(2)]
    with TemporaryDirectory() as folder, ThreadPoolExecutor(1) as executor:
        own = Cia402Settings(_RATED_NM)
        settings = [DriveSettings(node, _LARGEST_NM, own) for node in can.node_ids_of(size)]
        drives = DrivesOnBus(
            ends[1], [], lambda send: DriveBank(Cia402Drive, settings, send),
            CanMedium(can, 1, CandumpLog(Path(folder) / "can.log", "bench")),
        )  # fmt: skip
        codec = Cia402Codec(can.node_ids_of(size), can.counts_per_turn, np.full(size, _RATED_NM))
        master = Cia402Master(ends[0], can, can.node_ids_of(size), codec)
        enabling = executor.submit(master.enable, _LONG_S, lambda: False)
        while not enabling.done():
            drives.advance(0)
            frame = drives.receive(0.001)
            if frame is not None:
                drives.handle(frame, 0)
        if not enabling.result():
            raise RuntimeError("the drives of the benchmark were not enabled")
        drives.begin_run(0)
        yield _OurCycle(master, drives, size).run
        drives.close()
        ends[0].close()


class _OurCycle:
    """Cycles of a master and its drives, one after the other."""

    def __init__(self, master: Cia402Master, drives: DrivesOnBus, size: int) -> None:
        self._master, self._drives = master, drives
        self._position, self._velocity, self._torque = (np.zeros(size) for _ in range(3))
        self._tick = 0

    def run(self) -> tuple[int, int]:
        """See `Cycle`."""
        now_ns = self._tick * _PERIOD_NS
        self._tick += 1
        self._torque[:] = self._tick % 100
        clock = time.thread_time_ns
        instants = [clock()]
        self._drives.bank.measure(self._position, self._velocity, self._torque)
        self._drives.advance(now_ns)
        instants.append(clock())
        self._master.sample(now_ns)
        instants.append(clock())
        self._serve(now_ns)
        instants.append(clock())
        if not self._master.read(_LONG_S, self._position, self._velocity):
            raise RuntimeError("drives of the benchmark did not answer")
        self._master.command(self._torque)
        instants.append(clock())
        self._serve(now_ns)
        self._drives.medium.catch_up()
        instants.append(clock())
        measured, sampled, answered, commanded, taken = np.diff(instants).tolist()
        return sampled + commanded, measured + answered + taken

    def _serve(self, now_ns: int) -> None:
        while (frame := self._drives.receive(0.0)) is not None:
            self._drives.handle(frame, now_ns)


@contextmanager
def _bare(interface: str, size: int) -> Iterator[Cycle]:
    """The same frames with python-can alone."""
    codec = Cia402Codec(range(1, size + 1), 1 << 20, np.full(size, _RATED_NM))
    states = [CanFrame(0x181 + joint, bytes(8)) for joint in range(size)]
    torques = codec.command_frames(np.arange(float(size)))
    there, back = (_configuration(interface, size) for _ in range(2))
    with ExitStack() as stack:
        to_drives, at_drives = (stack.enter_context(open_python_can(there)) for _ in range(2))
        to_master, at_master = (stack.enter_context(open_python_can(back)) for _ in range(2))

        def cycle() -> tuple[int, int]:
            clock = time.thread_time_ns
            instants = [clock()]
            for sender, receiver, frames in (
                (to_drives, at_drives, codec.sampling_frames()),
                (to_master, at_master, states),
                (to_drives, at_drives, torques),
            ):
                for frame in frames:
                    sender.send(to_message(frame))
                instants.append(clock())
                for _ in frames:
                    receiver.recv(_LONG_S)
                instants.append(clock())
            sync, synced, answer, answered, torque, taken = np.diff(instants).tolist()
            return sync + answered + torque, synced + answer + taken

        yield cycle


def _configuration(interface: str, size: int) -> CanConfiguration:
    """A bus without other nodes."""
    port = free_ports(1)[0]
    return CanConfiguration(
        interface=interface,
        channel=f"bench-{port}" if interface == "virtual" else _GROUPS.format(port % 200 + 1),
        port=port,
        node_ids=tuple(range(1, size + 1)),
        answer_timeout_s=_LONG_S,
        command_timeout_ms=60_000,
        heartbeat_timeout_ms=60_000,
    )


def compiled_cycle_us(drives: int, cycles: int) -> float:
    """Mean cost of a cycle, both sides of it, in µs: SYNC, a state from and a torque to each drive.

    Raises:
        OSError: the sockets do not work.
    """
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as master,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as drive,
    ):
        for end in (master, drive):
            end.bind(("127.0.0.1", 0))
        master.connect(drive.getsockname())
        drive.connect(master.getsockname())
        frame = np.zeros(4, dtype=np.uint32)
        values = np.zeros(drives, dtype=np.uint32)
        _cycles(master.fileno(), drive.fileno(), frame, values, 1)
        started_ns = time.thread_time_ns()
        failures = _cycles(master.fileno(), drive.fileno(), frame, values, cycles)
        elapsed_ns = time.thread_time_ns() - started_ns
    if failures:
        raise OSError(f"{failures} frames were not carried")
    return elapsed_ns / cycles * 1e-3


@compiled
def _cycles(
    master: int, drive: int, frame: NDArray[np.uint32], values: NDArray[np.uint32], cycles: int
) -> int:
    """Run cycles; how many frames failed."""
    failures = 0
    for _ in range(cycles):
        failures += _pass_on(master, drive, frame, 0x080, 0)
        for joint in range(values.size):
            failures += _pass_on(drive, master, frame, 0x181 + joint, values[joint])
            values[joint] = frame[2] + 1
        for joint in range(values.size):
            failures += _pass_on(master, drive, frame, 0x201 + joint, values[joint])
    return failures


@compiled
def _pass_on(
    source: int, target: int, frame: NDArray[np.uint32], identifier: int, value: int
) -> int:
    """Pack a frame, send and receive it; 0 if it is through."""
    frame[0], frame[1], frame[2], frame[3] = identifier, 8, value, value
    sent = _send(source, frame.ctypes.data, 16, 0)
    received = _receive(target, frame.ctypes.data, 16, 0)
    return 0 if sent == 16 and received == 16 and frame[0] == identifier else 1


if __name__ == "__main__":
    show_section(Console(), measure_can_cycles(cycles=300, repetitions=4))
