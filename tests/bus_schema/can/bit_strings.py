"""CAN frames written out bit by bit, as strings: a second implementation, to measure the first by.

It takes its rules straight from the pictures of frame formats in Bosch's CAN Specification 2.0
(3.1, 5) and ISO 11898-1:2015 (10.4, 10.5), and shares no code or representation with the other.
"""

from __future__ import annotations

import re

from bus_schema.can.frame import CanFrame

FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)


def field(value: int, width: int) -> str:
    return format(value, f"0{width}b")


def crc15(bits: str) -> str:
    """Remainder of the division by x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1."""
    generator = int("1100010110011001", 2)
    value = int(bits + "0" * 15, 2)
    while value.bit_length() > 15:
        value ^= generator << (value.bit_length() - 16)
    return field(value, 15)


def stuffed(bits: str) -> str:
    """After each five equal bits the opposite one; an inserted bit counts for the next five."""
    out, since = "", 0
    for bit in bits:
        out += bit
        if re.search(r"(0{5}|1{5})$", out[since:]):
            since = len(out)
            out += "1" if bit == "0" else "0"
    return out


def classical(frame: CanFrame) -> str:
    """A classical frame from start of frame to the end of the interframe space, as sent."""
    remote = "1" if frame.is_remote else "0"
    data = b"" if frame.is_remote else frame.data
    if frame.is_extended:
        text = field(frame.identifier, 29)
        head = "0" + text[:11] + "11" + text[11:] + remote + "00"
    else:
        head = "0" + field(frame.identifier, 11) + remote + "00"
    covered = head + field(len(data), 4) + "".join(field(byte, 8) for byte in data)
    return stuffed(covered + crc15(covered)) + "1" + "01" + "1111111" + "111"


def fd_lengths(frame: CanFrame) -> tuple[int, int]:
    """Bits of an FD frame at the nominal rate and at the data rate."""
    dlc = min(index for index, length in enumerate(FD_LENGTHS) if length >= len(frame.data))
    data = frame.data + b"\0" * (FD_LENGTHS[dlc] - len(frame.data))
    if frame.is_extended:
        text = field(frame.identifier, 29)
        slow = "0" + text[:11] + "11" + text[11:] + "0" + "101"
    else:
        slow = "0" + field(frame.identifier, 11) + "00" + "101"
    fast = "0" + field(dlc, 4) + "".join(field(byte, 8) for byte in data)
    slow_sent = stuffed(slow)
    # where the CRC field begins, its fixed stuff bit stands in for a dynamic one
    sent = stuffed((slow + fast)[:-1]) + fast[-1]
    crc_field = 5 + 4 * 5 + 2 + 1 if len(data) <= 16 else 5 + 5 * 5 + 2 + 1
    return len(slow_sent) + 2 + 7 + 3, len(sent) - len(slow_sent) + crc_field
