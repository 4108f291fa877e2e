"""What ping, candump, CSV files and MCAP files say becomes a trace."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from deploy.judge.findings.link_delays import share_interval
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
TSHARK = """frame.time_relative,ip.src,tcp.analysis.ack_rtt
0.000,10.0.0.1,
0.002,10.0.0.2,0.002
0.098,10.0.0.1,
0.102,10.0.0.2,0.004
0.200,10.0.0.1,
"""


@pytest.fixture
def imported(tmp_path: Path, funnel_hil):
    """The trace that a command makes of a file, in whole µs."""

    def run(name: str, text: str, *words: str) -> list[int]:
        file, out = tmp_path / name, tmp_path / "trace.parquet"
        file.write_text(text)
        output = funnel_hil.output("trace", "import", words[0], file, *words[1:], "--out", out)
        assert "trace: {file:" in output
        found = read_trace(out)
        assert found.times_ns[0] == 0
        return np.where(found.delays_ns < 0, LOST_NS, (found.delays_ns + 500) // 1000).tolist()

    return run


def test_ping_is_half_a_round_trip(imported, tmp_path: Path) -> None:
    assert imported("ping.txt", PING, "ping", "--interval", "0.2") == [1000, 2000, LOST_NS, 500]
    assert read_trace(tmp_path / "trace.parquet").gap_ns == 200 * MS


def test_ping_says_that_it_measured_round_trips(imported, tmp_path: Path) -> None:
    imported("ping.txt", PING, "ping")
    assert read_trace(tmp_path / "trace.parquet").is_round_trip
    imported("can.log", CAN_LOG, "candump", "--from", "201", "--to", "181")
    assert not read_trace(tmp_path / "trace.parquet").is_round_trip


def test_round_trips_of_tshark_are_halved_and_packets_without_ack_are_not_lost(imported, tmp_path):
    words = ("csv", "--from", "frame.time_relative", "--delay", "tcp.analysis.ack_rtt")
    assert imported("packets.csv", TSHARK, *words) == [1000, 2000]
    trace = read_trace(tmp_path / "trace.parquet")
    assert trace.is_round_trip
    assert trace.times_ns.tolist() == [0, 99 * MS - 1 * MS]  # when the segments were sent


def test_order_of_requests_survives_the_rounding_of_long_round_trips(imported, tmp_path) -> None:
    lines = [
        f"[{9.9 + n / 1e4:.6f}] 64 bytes: icmp_seq={n} time={t} ms" for n, t in enumerate("573")
    ]
    assert imported("ping.txt", "\n".join(lines), "ping") == [2500, 3500, 1500]


def test_ping_counts_on_beyond_its_16_bits(imported, tmp_path: Path) -> None:
    numbers = [65534, 65535, 0, 1]
    lines = [f"[{i}.5] 64 bytes: icmp_seq={n} ttl=1 time=2 ms" for i, n in enumerate(numbers)]
    assert imported("ping.txt", "\n".join(lines), "ping") == [1000] * 4
    assert read_trace(tmp_path / "trace.parquet").gap_ns == 1000 * MS


def test_candump_is_the_time_from_frame_to_frame(imported) -> None:
    words = ("candump", "--from", "201", "--to", "181")
    assert imported("can.log", CAN_LOG, *words) == [700, LOST_NS, 900]


def test_buses_with_the_same_identifiers_are_kept_apart(tmp_path: Path, funnel_hil) -> None:
    """Of two buses a few µs apart, each answers all requests."""
    log = tmp_path / "two.log"
    lines = [
        (time_s + step_s, bus, frame)
        for bus, delay_s, answers in (("can0", 3e-4, True), ("slcan:1", 9e-4, True), ("can2", 0, 0))
        for time_s in np.arange(50) * 2e-3 + (4e-4 if bus == "slcan:1" else 0.0)
        for step_s, frame in ((0.0, "201#01"), (delay_s, "181#02" if answers else "182#"))
    ]
    log.write_text("\n".join(f"({1.7e9 + t:.6f}) {bus} {frame}" for t, bus, frame in sorted(lines)))
    words = ("trace", "import", "candump", log, "--from", "201", "--to", "181")
    output = funnel_hil.output(*words, "--out", tmp_path / "bus.parquet")
    assert output.count("50 messages") == output.count("lost 0") == 2
    for name, delay_us in (("can0", 300), ("slcan_1", 900)):
        assert f"{{trace: {{file: {tmp_path / f'bus_{name}.parquet'}}}}}" in output
        delays_ns = read_trace(tmp_path / f"bus_{name}.parquet").delays_ns
        np.testing.assert_allclose(delays_ns / 1e3, delay_us, atol=1.0)
    words = (*words, "--interface", "slcan:1", "--out", tmp_path / "one.parquet")
    assert funnel_hil.output(*words).count("50 messages") == 1
    np.testing.assert_allclose(read_trace(tmp_path / "one.parquet").delays_ns, 900_000, atol=1000)


@pytest.mark.parametrize(
    ("header", "row", "words"),
    [
        ("time_s,delay_us", "{s},700", ("--from", "time_s", "--delay", "delay_us")),
        ("t [s],owd (µs)", "{s},700", ("--from", "t [s]", "--delay", "owd (µs)")),
        ("t,d", "{s},700", ("--from", "t", "--delay", "d", "--delay-unit", "us")),
        ("t,d_ms", "{s},700", ("--from", "t", "--delay", "d_ms", "--delay-unit", "us")),
        ("t,got_ns", "{ms},{got_ns}", ("--from", "t", "--to", "got_ns", "--unit", "ms")),
        ("a_ns,b_usec", "{ns},{got_us}", ("--from", "a_ns", "--to", "b_usec")),
    ],
)
def test_each_column_has_its_unit(imported, header, row, words) -> None:
    """Messages 2 ms apart take 0.7 ms, whatever the units of the columns."""
    rows = [
        row.format(s=n / 500, ms=2 * n, ns=2_000_000 * n, got_us=2000 * n + 700,
                   got_ns=2_000_000 * n + 700_000) for n in range(20)
    ]  # fmt: skip
    assert imported("log.csv", "\n".join([header, *rows]), "csv", *words) == [700] * 20


def test_csv_is_the_difference_of_two_columns_or_one_of_delays(imported) -> None:
    words = ("csv", "--from", "sent", "--unit", "ms")
    assert imported("log.csv", CSV, *words, "--to", "got") == [2500, LOST_NS, 1000]
    assert imported("log.csv", CSV, *words, "--to", "got", "--least", "4") == [5500, LOST_NS, 4000]
    assert imported("log.csv", CSV, *words, "--delay", "seq") == [1000, 2000, 3000]


@pytest.mark.parametrize(
    ("name", "word", "is_round_trip"),
    [("rtt [ms]", "", True), ("rtt [ms]", "--one-way", False), ("Round trip", "", True),
     ("Latenz", "", False), ("Latenz", "--round-trip", True)],
)  # fmt: skip
def test_a_column_of_round_trips_is_halved(tmp_path, funnel_hil, name, word, is_round_trip):
    """By its name, or as asked; the output says how it was read, if nothing is asked."""
    file, out = tmp_path / "log.csv", tmp_path / "trace.csv"
    file.write_text(f"time_s,{name}\n0,4\n0.01,8\n0.02,\n")
    words = (
        "trace",
        "import",
        "csv",
        file,
        "--from",
        "time_s",
        "--delay",
        name,
        "--delay-unit",
        "ms",
    )
    output = " ".join(funnel_hil.output(*words, *word.split(), "--out", out).split())
    found = read_trace(out)
    expected = [2 * MS, 4 * MS, LOST_NS] if is_round_trip else [4 * MS, 8 * MS, LOST_NS]
    assert (found.delays_ns.tolist(), found.is_round_trip) == (expected, is_round_trip)
    read_as = "read as round trips" if is_round_trip else "read as one-way delays"
    assert (f"column {name} is {read_as}" in output) is (not word)


def test_mcap_is_the_time_to_the_answer_with_the_same_stamp(tmp_path: Path, funnel_hil) -> None:
    settings = ["duration_s=0.1", "link.uplink.delay_ms=2", "link.downlink.delay_ms=3"]
    funnel_hil.output(
        "simulate",
        "paper_arm",
        *(w for s in settings for w in ("--set", s)),
        "--out",
        tmp_path / "run",
    )
    log, out = tmp_path / "run" / "run.mcap", tmp_path / "trace.csv"
    words = ("trace", "import", "mcap", log, "--from", "/joint_states", "--out", out)
    funnel_hil.output(*words, "--to", "/joint_commands")
    assert len(read_trace(out).delays_ns) > 90
    output = funnel_hil.output(*words, "--to", "/joint_comands", code=2)
    assert "did you mean /joint_commands" in output


@pytest.mark.parametrize(
    ("text", "words", "complaint"),
    [
        ("hello", ("ping",), "does not contain two replies in the format of ping"),
        (CAN_LOG, ("ping",), "is a log of candump: funnel-hil trace import candump makes"),
        (
            PING,
            ("candump", "--from", "1", "--to", "2"),
            "is output of ping: funnel-hil trace import",
        ),
        ("".join(f"{n}\n" for n in range(0, 1500, 7)), ("ping",), "it is a trace of mahimahi"),
        ("Loss%   Snt   Last\n", ("csv", "--from", "a", "--to", "b"), "is output of mtr, which"),
        (CAN_LOG, ("candump", "--from", "201"), "--to must be given"),
        (CAN_LOG, ("candump", "--from", "7ff", "--to", "181"), "does not contain frame 7ff"),
        (CSV, ("csv", "--from", "sent"), "give one of --to and --delay"),
        (
            CSV,
            ("csv", "--from", "sent", "--to", "nowhere"),
            "line 1: column nowhere is missing: the columns are seq, sent, got",
        ),
        (CSV, ("csv", "--from", "sent", "--to", "sent"), "--from and --to must differ"),
        (CAN_LOG, ("candump", "--from", "201", "--to", "201"), "--from and --to must differ"),
        (
            CAN_LOG,
            ("candump", "--from", "201", "--to", "0x201"),
            "does not contain frame 201",
        ),
        (
            CAN_LOG,
            ("candump", "--from", "20x", "--to", "181"),
            "--from 20x --to 181: must be CAN identifiers in hexadecimal",
        ),
        ("a,b,a\n1,2,3\n", ("csv", "--from", "a", "--to", "b"), "column 1 'a' occurs twice"),
        (
            "a,b\n1,2\n,3\n",
            ("csv", "--from", "a", "--to", "b"),
            "line 3, column a = empty: must be a",
        ),
        ("a,b\n1,2\n2,x\n", ("csv", "--from", "a", "--to", "b"), "line 3, column b = 'x': is not"),
        (
            "a,b,c\nx,y,z\n",
            ("csv", "--from", "a", "--delay", "b"),
            "line 2, column a = 'x': is not",
        ),
        (
            CSV.replace("2,20,\n", ""),
            ("csv", "--from", "got", "--to", "sent", "--unit", "ms"),
            "give the true smallest delay with --least MS",
        ),
        ("", ("mcap", "--from", "/a"), "cannot be read as MCAP"),
        (
            CAN_LOG.replace("can0 181", "can1 181"),
            ("candump", "--from", "201", "--to", "181"),
            "no frame 201 is followed by 181 on its bus: requests on can0, answers on can1",
        ),
        (
            CAN_LOG,
            ("candump", "--from", "201", "--to", "181", "--interface", "can1"),
            "--interface can1: has no frame 201: these frames are on can0",
        ),
        (PING, ("ping", "--interface", "can0"), "--interface is for candump"),
        (PING, ("ping", "--one-clock"), "trace import ping: --one-clock is for csv and mcap"),
        (PING, ("ping", "--from", "201"), "--from is for candump and csv and mcap"),
        (PING, ("ping", "--unit", "ms"), "trace import ping: --unit is for csv"),
        (
            PING.replace("64 bytes", "[1700000000.5] 64 bytes"),
            ("ping", "--interval", "0.2"),
            "file: --interval must be left out: it has times, by ping -D",
        ),
        (
            CAN_LOG,
            ("candump", "--from", "201", "--to", "181", "--one-clock"),
            "trace import candump: --one-clock is for csv and mcap",
        ),
        (CAN_LOG, ("candump", "--from", "201", "--delay", "d"), "candump: --delay is for csv"),
        (CSV, ("csv", "--from", "sent", "--interval", "2"), "csv: --interval is for ping"),
        (
            CSV,
            ("csv", "--from", "sent", "--delay", "seq", "--one-clock"),
            "trace import csv: --one-clock must be left out with --delay",
        ),
        (
            "",
            ("mcap", "--from", "/a", "--to", "/b", "--one-clock"),
            "trace import mcap: --one-clock must be left out with --to",
        ),
        (
            CSV,
            ("csv", "--from", "sent", "--to", "got", "--delay-unit", "ms"),
            "trace import csv: --delay-unit must be left out without --delay",
        ),
        (
            "time_s,delay_us\n",
            ("csv", "--from", "time_s", "--delay", "delay_us", "--unit", "us"),
            "--unit us: must be left out, as by their names time_s is in s, delay_us is in us",
        ),
        (CAN_LOG, ("candump", "--from", "201", "--delay-unit", "us"), "--delay-unit is for csv"),
        (
            "".join(["t,delay\n", *(f"{n / 1e3},700\n" for n in range(50))]),
            ("csv", "--from", "t", "--delay", "delay", "--unit", "us"),
            "usually 1e-09 s apart, must be 10 µs to 10 s: is their unit another?",
        ),
        (
            "".join(["t,delay\n", *(f"{n * 1_000_000},0.7\n" for n in range(50))]),
            ("csv", "--from", "t", "--delay", "delay", "--delay-unit", "ms"),
            "usually 1e+06 s apart, must be 10 µs to 10 s",
        ),
    ],
)
def test_what_is_no_measurement_is_refused(tmp_path, funnel_hil, text, words, complaint):
    file = tmp_path / "file"
    file.write_text(text)
    out = tmp_path / "trace.csv"
    output = funnel_hil.output("trace", "import", words[0], file, *words[1:], "--out", out, code=2)
    assert complaint in output
    assert not out.exists()


def test_output_of_ping_is_the_same_trace_with_and_without_import(imported, tmp_path) -> None:
    lines, time_s = ["PING robot (10.0.0.2) 56(84) bytes of data."], 1_700_000_000.0
    for number, round_trip_ms in enumerate((2.04, 3.18, 70.5, 1.0), 1):
        end = f"[{time_s + 0.01 * number + round_trip_ms / 1e3:.6f}]"
        lines.append(f"{end} 64 bytes from x: icmp_seq={number} ttl=64 time={round_trip_ms} ms")
    imported("ping.txt", "\n".join(lines), "ping")
    direct = read_trace(tmp_path / "ping.txt")
    through = read_trace(tmp_path / "trace.parquet")
    assert direct.is_round_trip
    assert through.is_round_trip
    np.testing.assert_array_equal(direct.delays_ns, through.delays_ns)
    np.testing.assert_allclose(direct.times_ns, through.times_ns, atol=1)


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
