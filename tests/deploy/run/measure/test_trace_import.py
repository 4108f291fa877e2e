"""What ping, candump, CSV files and MCAP files say becomes a trace."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from deploy.judge.link_delays import share_interval
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from plant_emulator.channel.trace_file import LOST_NS, read_trace

MS = 1_000_000
PING = """PING 10.0.0.2 (10.0.0.2) 56(84) bytes of data.
64 bytes from 10.0.0.2: icmp_seq=1 ttl=64 time=2.00 ms
64 bytes from 10.0.0.2: icmp_seq=2 ttl=64 time=4.00 ms
64 bytes from 10.0.0.2: icmp_seq=2 ttl=64 time=4.10 ms (DUP!)
no answer yet for icmp_seq=3
64 bytes from 10.0.0.2: icmp_seq=4 ttl=64 time=1.00 ms

--- 10.0.0.2 ping statistics ---
4 packets transmitted, 3 received, 25% packet loss
"""
CAN_LOG = """(1700000000.000000) can0 201#0011
(1700000000.000700) can0 181#2233
(1700000000.010000) can0 201#0011
(1700000000.010100) can0 080#
(1700000000.020000) can0 201#0011
(1700000000.020900) can0 181#2233
"""
CSV = "seq,sent,got\n1,10,12.5\n2,20,\n3,30,31\n"


@pytest.fixture
def imported(tmp_path: Path, funnel_hil):
    """The trace that a command makes of a file, in whole µs."""

    def run(name: str, text: str, *words: str) -> list[int]:
        file, out = tmp_path / name, tmp_path / "trace.parquet"
        file.write_text(text)
        code, said = funnel_hil("trace", "import", words[0], file, *words[1:], "--out", out)
        assert code == 0, said
        assert "trace: {file:" in said
        found = read_trace(out)
        assert found.times_ns[0] == 0
        return np.where(found.delays_ns < 0, LOST_NS, (found.delays_ns + 500) // 1000).tolist()

    return run


def test_ping_is_half_a_round_trip(imported, tmp_path: Path) -> None:
    assert imported("ping.txt", PING, "ping", "--interval", "0.2") == [1000, 2000, LOST_NS, 500]
    assert read_trace(tmp_path / "trace.parquet").gap_ns == 200 * MS


def test_ping_counts_on_beyond_its_16_bits(imported, tmp_path: Path) -> None:
    numbers = [65534, 65535, 0, 1]
    lines = [f"[{i}.5] 64 bytes: icmp_seq={n} ttl=1 time=2 ms" for i, n in enumerate(numbers)]
    assert imported("ping.txt", "\n".join(lines), "ping") == [1000] * 4
    assert read_trace(tmp_path / "trace.parquet").gap_ns == 1000 * MS


def test_candump_is_the_time_from_frame_to_frame(imported) -> None:
    words = ("candump", "--from", "201", "--to", "181")
    assert imported("can.log", CAN_LOG, *words) == [700, LOST_NS, 900]


def test_csv_is_the_difference_of_two_columns_or_one_of_delays(imported) -> None:
    words = ("csv", "--from", "sent", "--unit", "ms")
    assert imported("log.csv", CSV, *words, "--to", "got") == [2500, LOST_NS, 1000]
    assert imported("log.csv", CSV, *words, "--to", "got", "--least", "4") == [5500, LOST_NS, 4000]
    assert imported("log.csv", CSV, *words, "--delay", "seq") == [1000, 2000, 3000]


def test_mcap_is_the_time_to_the_answer_with_the_same_stamp(tmp_path: Path, funnel_hil) -> None:
    settings = ["duration_s=0.1", "link.uplink.delay_ms=2", "link.downlink.delay_ms=3"]
    code, said = funnel_hil(
        "simulate",
        "paper_arm",
        *(w for s in settings for w in ("--set", s)),
        "--out",
        tmp_path / "run",
    )
    assert code == 0, said
    log, out = tmp_path / "run" / "run.mcap", tmp_path / "trace.csv"
    words = ("trace", "import", "mcap", log, "--from", "/joint_states", "--out", out)
    code, said = funnel_hil(*words, "--to", "/joint_commands")
    assert code == 0, said
    assert len(read_trace(out).delays_ns) > 90
    code, said = funnel_hil(*words, "--to", "/joint_comands")
    assert code == 2
    assert "did you mean /joint_commands" in said


@pytest.mark.parametrize(
    ("text", "words", "complaint"),
    [
        ("hello", ("ping",), "does not contain two replies in the format of ping"),
        (CAN_LOG, ("candump", "--from", "201"), "--to must be given"),
        (CAN_LOG, ("candump", "--from", "7ff", "--to", "181"), "does not contain frame 7ff"),
        (CSV, ("csv", "--from", "sent"), "give one of --to and --delay"),
        (CSV, ("csv", "--from", "sent", "--to", "nowhere"), "nowhere"),
        (
            CSV,
            ("csv", "--from", "got", "--to", "sent"),
            "give the true smallest delay with --least MS",
        ),
        ("", ("mcap", "--from", "/a"), "cannot be read as MCAP"),
    ],
)
def test_what_is_no_measurement_is_refused(
    tmp_path: Path, funnel_hil, text: str, words: tuple[str, ...], complaint: str
) -> None:
    file = tmp_path / "file"
    file.write_text(text)
    out = tmp_path / "trace.csv"
    code, said = funnel_hil("trace", "import", words[0], file, *words[1:], "--out", out)
    assert code == 2
    assert complaint in said
    assert not out.exists()


def test_imported_trace_can_be_run(imported, tmp_path: Path) -> None:
    imported("ping.txt", PING, "ping", "--interval", "0.05")
    setup = load_setup(
        "paper_arm", [f"link.uplink.trace.file={tmp_path / 'trace.parquet'}", "duration_s=0.2"]
    )
    assert simulate(setup).data().faults() == []


def test_interval_of_a_share() -> None:
    low, high = share_interval(10, 1000)
    assert (round(low, 4), round(high, 4)) == (0.0054, 0.0183)
    assert share_interval(0, 100)[0] == 0.0
