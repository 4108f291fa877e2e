"""Names the program whose file was given in place of delays, and the nearest way to use it."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

_PROGRAMS = (
    ("ping", rb"^PING \S+ \(|^(\[[\d.]+\] )?\d+ bytes from .* time[=<]",
     "output of ping: funnel-hil trace import ping makes a trace of it"),
    ("candump", rb"^ *\(\d+\.\d+\) +\S+ +[0-9A-Fa-f]+(#|  )",
     "a log of candump: funnel-hil trace import candump makes a trace of it"),
    ("netem", rb"distribution table|\A(\s*#.*\n)*\s*(-?\d{1,5}[ \t]+){7,}",
     "a table of netem, without unit: use distribution normal, pareto or uniform with jitter_ms"),
    ("iperf3", rb"^\[ *ID\] Interval|\"version\":\s*\"iperf|^Connecting to host \S+, port",
     "output of iperf3, which measures no delays: funnel-hil link and ping do, and a trace may be"
     " its output with --json over TCP. Its bitrate, jitter and loss go to rate_kbit_s, jitter_ms"
     " and loss"),
    ("MCAP", rb"\A\x89MCAP0",
     "an MCAP file: funnel-hil trace import mcap makes a trace of it"),
    ("pcap", rb"\A(\xd4\xc3\xb2\xa1|\xa1\xb2\xc3\xd4|\x4d\x3c\xb2\xa1|\x0a\x0d\x0d\x0a)",
     "a pcap file: give its table, tshark -r FILE -T fields -E header=y -E separator=, -e"
     " frame.time_epoch -e tcp.analysis.ack_rtt"),
    ("mtr", rb"Loss% +Snt|^Mtr_Version,|\"mtr\": *\{|^<MTR |\A[xhdp] \d+ ",
     "output of mtr, which gives averages: use ping -D, and funnel-hil trace import ping"),
)  # fmt: skip
"""Name, beginning or typical line, and what to say."""
_BEGINNING = 4000
_WHOLE_NUMBERS = re.compile(rb"[\d\s]+")
_PACKET_BITS = 1500 * 8
_FEWEST_PACKETS, _SHORTEST_MS = 10, 1000


def refuse_foreign(path: Path, content: bytes, expected: str = "") -> None:
    """Refuse a file that another program writes for another purpose.

    Args:
        path: the file.
        content: of it.
        expected: program whose output it should be.

    Raises:
        ValueError: it is one of another program; the message names program and nearest way.
    """
    for program, typical, description in _PROGRAMS:
        if program != expected and re.search(typical, content[:_BEGINNING], re.MULTILINE):
            raise ValueError(f"{path} is {description}")
    if (rate_kbit_s := _mean_rate_kbit_s(content)) is not None:
        raise ValueError(
            f"{path} only rises: it is a trace of mahimahi, the times at which packets may leave,"
            f" in ms. It has no delays: use rate_kbit_s: {rate_kbit_s:.0f}, its mean, or measure"
            " with ping inside mahimahi and use funnel-hil trace import ping"
        )


def _mean_rate_kbit_s(content: bytes) -> float | None:
    """Return the mean rate of a trace of mahimahi; None if it is none."""
    times_ms = list(map(float, content.split())) if _WHOLE_NUMBERS.fullmatch(content) else [0]
    if len(times_ms) < _FEWEST_PACKETS or times_ms[-1] < _SHORTEST_MS:
        return None
    is_rising = all(before <= after for before, after in pairwise(times_ms))
    return len(times_ms) * _PACKET_BITS / times_ms[-1] if is_rising else None
