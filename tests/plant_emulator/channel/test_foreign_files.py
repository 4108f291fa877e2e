"""Files of other programs are refused with the program's name and the nearest way."""

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


def test_ping_without_times_is_refused_with_the_way(tmp_path: Path) -> None:
    file = tmp_path / "ping.txt"
    file.write_text(re.sub(r"\[.*\] ", "", PING))
    with pytest.raises(ValueError, match=r"ping\.txt: its replies have no times: use ping -D"):
        read_trace(file)
