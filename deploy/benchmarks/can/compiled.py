"""A control cycle over CAN with nothing in it that could be left out, compiled.

The frames of SocketCAN (16 bytes) are packed, sent, received and unpacked between two connected
datagram sockets, by system calls from compiled code: no protocol, no checks, no time-outs.
"""

from __future__ import annotations

import ctypes
import socket
import time

import numpy as np
from numpy.typing import NDArray

from bus_schema.runtime.compiled import c_function, compiled

_FRAME_WORDS = 4
_LIBC = ctypes.CDLL(None)
_send = c_function(_LIBC, "send", "intp", "intc", "uintp", "uintp", "intc")
_receive = c_function(_LIBC, "recv", "intp", "intc", "uintp", "uintp", "intc")


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
        frame = np.zeros(_FRAME_WORDS, dtype=np.uint32)
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
