"""Files of other programs are refused with the program's name and the nearest way."""

import json
import re
from pathlib import Path

import pytest

from bus_schema.foreign_files import refuse_foreign
from plant_emulator.channel.jitter import read_delays_ms
from plant_emulator.channel.trace_file import LOST_NS, read_trace

FILES = {
    "mahimahi": "".join(f"{7 * (n // 3)}\n" for n in range(600)),
    "netem": "# This is the distribution table for the normal distribution.\n-32768 -28307\n",
    "netem without comment": f"{-31473} {' '.join(map(str, range(-30000, -29300, 100)))}\n",
    "iperf3": "Connecting to host 10.0.0.2, port 5201\n[  5] local 10.0.0.1 port 1 connected\n"
    "[ ID] Interval           Transfer     Bitrate\n[  5]   0.00-1.00   sec  1.1 MBytes\n",
    "iperf3 --json": '{\n\t"start":\t{\n\t\t"connected":\t[],\n\t\t"version":\t"iperf 3.12",\n',
    "mtr": "Start: 2026-11-25T10:00:00+0000\n"
    "HOST: lab          Loss%   Snt   Last   Avg  Best  Wrst StDev\n  1.|-- a  0.0%    10\n",
    "mtr --csv": "Mtr_Version,Start_Time,Status,Host,Hop,Ip,Loss%,Snt,Last\nMTR.0.95,1,OK,a,1\n",
    "mtr --raw": "x 0 33000\nh 0 10.0.0.2\np 0 1234 33000\n",
    "ping": "PING 10.0.0.2 (10.0.0.2) 56(84) bytes of data.\n64 bytes from 10.0.0.2: icmp_seq=1\n",
    "candump": "(1700000000.000000) can0 201#0011\n",
}
WAYS = {
    "mahimahi": "use rate_kbit_s: 5169, its mean",  # 600 packets in 1.398 s
    "netem": "use distribution normal, pareto or uniform with jitter_ms",
    "iperf3": "go to rate_kbit_s, jitter_ms and loss",
    "mtr": "use ping -D, and funnel-hil trace import ping",
    "ping": "funnel-hil trace import ping",
    "candump": "funnel-hil trace import candump",
}


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("read", [read_trace, read_delays_ms])
def test_refusal_names_the_program_and_the_nearest_way(tmp_path: Path, name: str, read) -> None:
    file, program = tmp_path / "file", name.split()[0]
    if read is read_trace and program == "ping":
        pytest.skip("it reads output of ping")
    file.write_text(FILES[name])
    with pytest.raises(ValueError, match=rf"{file}.* {program}.*") as refused:
        read(file)
    assert WAYS[program] in str(refused.value)


@pytest.mark.parametrize(
    "text",
    [
        "5\n6\n7\n7\n9\n12\n12\n13\n20\n999\n",  # delays that someone sorted
        "1500\n20\n" * 10,
        "0.5\n" * 20,
        "# PING robot (10.0.0.2)\ntime_s,delay_ms\n0,1\n1,2\n",
        "delay_ms\n1\n2\n",
        "1 fast\n2 slow\n",
    ],
)
def test_files_of_delays_are_not_taken_for_others(text: str) -> None:
    refuse_foreign(Path("file"), text.encode())


PING = """PING robot (10.0.0.2) 56(84) bytes of data.
[1700000000.010000] 64 bytes from 10.0.0.2: icmp_seq=1 ttl=64 time=4.00 ms
[1700000000.038000] 64 bytes from 10.0.0.2: icmp_seq=3 ttl=64 time=8.00 ms
"""
TSHARK = """frame.time_epoch,tcp.analysis.ack_rtt
1700000000.000,
1700000000.006,0.004
1700000000.020,
1700000000.030,0.008
"""


@pytest.mark.parametrize("name", ["ping", "tshark"])
def test_round_trips_of_others_are_traces_as_they_are(tmp_path: Path, name: str) -> None:
    """Requests are sent at 6 ms, 30 ms (ping) and take 4 ms and 8 ms; ping's second is lost."""
    (tmp_path / name).write_text({"ping": PING, "tshark": TSHARK}[name])
    trace = read_trace(tmp_path / name)
    assert trace.is_round_trip
    delays_ms = [each / 1e6 for each in trace.delays_ns.tolist()]
    times_ms = [each / 1e6 for each in trace.times_ns.tolist()]
    if name == "ping":
        assert delays_ms == [2.0, LOST_NS / 1e6, 4.0]
        assert times_ms == pytest.approx([0.0, 12.0, 24.0], abs=1e-3)
    else:
        assert delays_ms == [2.0, 4.0]
        assert times_ms == pytest.approx([0.0, 20.0], abs=1e-3)


@pytest.mark.parametrize(
    ("end", "interval_ms", "source"),
    [("3 packets transmitted, 2 received, 33% packet loss, time 40ms\n", 20, "by its statistics"),
     ("", 1000, "ping's default, assumed")],
)  # fmt: skip
def test_ping_without_times_has_the_interval_of_its_statistics(
    tmp_path: Path, end: str, interval_ms: int, source: str
) -> None:
    (tmp_path / "ping.txt").write_text(re.sub(r"\[.*\] ", "", PING) + end)
    trace = read_trace(tmp_path / "ping.txt")
    assert trace.times_ns.tolist() == [0, interval_ms * 1_000_000, 2 * interval_ms * 1_000_000]
    assert trace.delays_ns.tolist() == [2_000_000, LOST_NS, 4_000_000]
    assert source in trace.assumed
    assert ("a message each 1 s: bursts between them are not in it" in trace.assumed) is (
        interval_ms == 1000
    )
    assert "each direction replays half of each round trip" in trace.assumed


HEAD = "PING robot (10.0.0.2): 56 data bytes\n"
REPLIES = "".join(f"64 bytes from x: icmp_seq={n} ttl=64 time=4.0 ms\n" for n in (2, 3, 5))


@pytest.mark.parametrize(
    ("text", "first", "last"),
    [
        (HEAD + REPLIES + "13 packets transmitted, 3 received, 76% packet loss", 1, 13),
        (HEAD + REPLIES + "9 packets transmitted, 3 packets received, 66.6% packet loss", 0, 8),
        (HEAD + "Request timeout for icmp_seq 0\n" + REPLIES + "Request timeout for icmp_seq 7",
         0, 7),
        (REPLIES + "From 10.0.0.1 icmp_seq=6 Destination Host Unreachable\n", 2, 6),
        (REPLIES + "64 bytes from x: icmp_seq=9 ttl=64 ti", 2, 5),
        (REPLIES + "70000 packets transmitted, 3 received, 99% packet loss", 2, 5),
    ],
)  # fmt: skip
@pytest.mark.parametrize("has_times", [False, True])
def test_losses_at_the_ends_of_ping_count(
    tmp_path: Path, text: str, first: int, last: int, has_times: bool
) -> None:
    """Requests 2, 3 and 5, one a second, are answered after 4 ms; those beside them are lost."""
    if has_times:
        text = re.sub(r"(64 bytes.*icmp_seq=(\d) .* ms)", r"[170000000\2.004] \1", text)
    (tmp_path / "ping.txt").write_text(text)
    trace = read_trace(tmp_path / "ping.txt")
    expected = [2_000_000 if n in (2, 3, 5) else LOST_NS for n in range(first, last + 1)]
    assert trace.delays_ns.tolist() == expected
    times_s = [each / 1e9 for each in trace.times_ns.tolist()]
    assert times_s == pytest.approx(list(range(last - first + 1)), abs=1e-6)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (REPLIES + "64 bytes from x: icmp_seq=99999999999 ttl=1 time=1 ms",
         "line 4: seq=99999999999: must be at most 65536 above 5"),
        (REPLIES + f"64 bytes from x: icmp_seq={'9' * 5000} ttl=1 time=1 ms", "line 4: "),
        (REPLIES + "64 bytes from x: icmp_seq=30000 ttl=1 time=1 ms",
         "4 replies to requests 2 to 30000: must be at least one of 1000"),
        (HEAD + REPLIES + "99999999999 packets transmitted, 3 received", "3 replies to requests 1"),
        (REPLIES + "64 bytes from x: icmp_seq=6 ttl=1 time=1.2.3 ms", "line 4: .*'1.2.3'"),
        ("PING robot (10.0.0.2) 56(84) Bytes an Daten.\n"
         "64 Bytes von 10.0.0.2: icmp_seq=1 ttl=64 Zeit=4.00 ms\n", "LC_ALL=C ping -D HOST"),
        ("\nPinging 10.0.0.2 with 32 bytes of data:\n"
         "Reply from 10.0.0.2: bytes=32 time=4ms TTL=64\n", "is output of Windows' ping"),
        ("Antwort von 10.0.0.2: Bytes=32 Zeit<1ms TTL=64\n",
         "ping -D -i 0.01 HOST on Linux or in WSL"),
    ],
)  # fmt: skip
def test_damaged_or_localised_ping_is_refused(tmp_path: Path, text: str, complaint: str) -> None:
    (tmp_path / "ping.txt").write_text(text)
    with pytest.raises(ValueError, match=f"ping.txt.*{complaint}"):
        read_trace(tmp_path / "ping.txt")


def iperf(intervals: list[dict[str, object]], end: dict[str, object]) -> str:
    start = {"connected": [], "version": "iperf 3.16"}
    streams = [{"streams": [each]} for each in intervals]
    return json.dumps({"start": start, "intervals": streams, "end": end})


def test_tcp_report_of_iperf_is_halves_of_its_round_trips(tmp_path: Path) -> None:
    """rtt is in µs (iperf3's field of struct tcp_info); what is omitted is the slow start."""
    intervals = [{"end": 0.1 * n, "rtt": rtt, "omitted": n == 1}
                 for n, rtt in enumerate((90_000, 4_000, 8_000), 1)]  # fmt: skip
    (tmp_path / "iperf.json").write_text(iperf(intervals, {"sum_sent": {}}))
    trace = read_trace(tmp_path / "iperf.json")
    assert trace.is_round_trip
    assert trace.delays_ns.tolist() == [2_000_000, 4_000_000]
    assert trace.times_ns.tolist() == [0, 100_000_000]
    assert "smooths" in trace.assumed


def test_udp_report_of_iperf_is_refused_with_keys_of_the_link(tmp_path: Path) -> None:
    total = {"bits_per_second": 1.05e6, "jitter_ms": 0.25, "lost_percent": 2.0}
    (tmp_path / "f").write_text(iperf([{"end": 1.0}, {"end": 2.0}], {"sum": total}))
    expected = "use rate_kbit_s: 1050, jitter_ms: 0.25 and loss: 0.02; measure delays with ping"
    with pytest.raises(ValueError, match=expected):
        read_trace(tmp_path / "f")


def test_version_of_iperf_may_stand_far_from_the_beginning(tmp_path: Path) -> None:
    report = json.loads(iperf([{"end": n, "rtt": 4000 * n} for n in (1, 2)], {}))
    report["start"]["connected"] = ["x" * 5000]
    (tmp_path / "iperf.json").write_text(json.dumps(report))
    assert read_trace(tmp_path / "iperf.json").delays_ns.tolist() == [2_000_000, 4_000_000]


UDP = {"bits_per_second": 1.05e6, "jitter_ms": 0.25, "lost_percent": None}
ROWS: list[dict[str, object]] = [{"end": 1.0}, {"end": 2.0}]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (iperf(ROWS, {"sum": UDP}), "use rate_kbit_s: 1050 and jitter_ms: 0.25; measure"),
        (iperf([], {})[:-1] + ', "error": "unable to connect to server"}',
         "iperf3 failed: 'unable to connect to server'"),
        (iperf(ROWS, {"sum_sent": {}}), "run iperf3 -J on the sender, over TCP"),
        (iperf([{"end": 2.0, "rtt": 1}, {"end": 1.0, "rtt": 1}], {}), "must not fall"),
        (iperf([{"end": "soon", "rtt": 1}], {}), "damaged report of iperf3.*soon"),
        ('{"a":' * 100_000, "one must be of times"),
    ],
)  # fmt: skip
def test_reports_of_iperf_without_delays_say_why(tmp_path: Path, text: str, complaint: str) -> None:
    (tmp_path / "iperf.json").write_text(text)
    with pytest.raises(ValueError, match=complaint):
        read_trace(tmp_path / "iperf.json")


@pytest.mark.parametrize(
    ("text", "delays_us", "is_round_trip"),
    [
        ("seq,T (S),RTT (MS)\n1,0,3\n2,0.01,\n3,0.02,5\n", [1500, None, 2500], True),
        ("seq,Timestamp,RTT [ms]\n1,0,3\n2,0.01,\n3,0.02,5\n", [1500, None, 2500], True),
        ("t_us,latency_us\n20000,5000\n0,3000\n10000,\n", [3000, None, 5000], False),
    ],
)
def test_tables_are_read_by_the_names_of_their_columns(
    tmp_path: Path, text: str, delays_us: list[int | None], is_round_trip: bool
) -> None:
    (tmp_path / "log.csv").write_text(text)
    trace = read_trace(tmp_path / "log.csv")
    expected = [LOST_NS if each is None else 1000 * each for each in delays_us]
    assert trace.delays_ns.tolist() == expected
    assert trace.times_ns.tolist() == [0, 10_000_000, 20_000_000]
    assert trace.is_round_trip is is_round_trip


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"time,latency\n0,1\n1,2\n", "column latency has no unit, such as latency_ms: rename"),
        (b"time,latency_ms\n0,1\n100,2\n", "column time: the times are usually 100 s apart"),
        (b"time,latency_ms\n0,1\n2,2\n4,1\n", "usually 2 apart: name it time_ms or time_s"),
        (
            b"time_s,latency_ms\n0,1\n1,-1\n",
            "line 3, column latency_ms = -1: delays must be 0 to 60000 ms",
        ),
        (
            b"when,how_long\n0,1\n1,2\n",
            "columns are 'when, how_long': one must be of times .*sent.*delays .*rtt",
        ),
        (b"\x89MCAP0\r\n", "is an MCAP file: funnel-hil trace import mcap"),
        (b"\x0a\x0d\x0d\x0a\x1c\0\0\0", "is a pcap file: give its table, tshark -r FILE"),
    ],
)
def test_files_that_need_a_choice_are_refused_with_the_way(
    tmp_path: Path, content: bytes, complaint: str
) -> None:
    (tmp_path / "log").write_bytes(content)
    with pytest.raises(ValueError, match=complaint):
        read_trace(tmp_path / "log")
