"""What the loop is compared with: bare transports, the kernel's wake-ups, the MCAP library."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path

import pytest

from scripts.benchmarks import cyclictest, echo
from scripts.benchmarks.context_switches import switches_per_exchange
from scripts.benchmarks.middlewares import OTHERS
from scripts.benchmarks.recordings import measure_finishing, measure_recorder
from scripts.benchmarks.round_trip import TRANSPORTS
from scripts.benchmarks.transports.bare import RawUdp

HISTOGRAM = """# /dev/cpu_dma_latency set to 0us
# Histogram
000000 000000
000003 000050
000004 000048
000010 000001
000011 000001
# Total: 000000100
# Min Latencies: 00003
# Max Latencies: 00011
# Histogram Overflows: {overflows}
"""


def test_the_histogram_of_cyclictest_is_read():
    lateness = cyclictest.parse_histogram(HISTOGRAM.format(overflows="00000"))
    assert (lateness["p50"], lateness["p99"]) == (3.0, 10.0)


def test_what_lies_beyond_the_histogram_counts_as_latest():
    lateness = cyclictest.parse_histogram(HISTOGRAM.format(overflows="00020"))
    assert (lateness["p50"], lateness["p99"]) == (4.0, 20_000.0)


@pytest.mark.parametrize("output", ["", "000001 000000\n", "not permitted"])
def test_output_without_a_histogram_is_refused(output):
    with pytest.raises(ValueError, match="no histogram"):
        cyclictest.parse_histogram(output)


def test_missing_cyclictest_is_reported(monkeypatch):
    monkeypatch.setenv("PATH", "")
    assert "not installed" in cyclictest.why_not()


def test_the_recorder_is_measured():
    section = measure_recorder("paper_arm", 0.01, 1)
    assert section.ratios[0].value.lowest > 0


def test_what_comes_after_a_run_is_measured():
    section = measure_finishing("paper_arm", 0.05, 1)
    assert [len(section.costs_us), len(section.ratios)] == [4, 2]
    assert all(cost.lowest > 0 for cost in section.costs_us.values())


@pytest.mark.parametrize("name", [*TRANSPORTS, *OTHERS])
def test_every_transport_carries_an_exchange(name):
    if name in OTHERS:
        module, library = OTHERS[name]
        pytest.importorskip(library)
    transport = TRANSPORTS[name] if name in TRANSPORTS else import_module(module).Near
    with echo.EchoPair(transport, ("a", "b", "c"), realtime=False) as pair:
        times = pair.round_trips_us(20, 1_000_000)
    assert times.median > 0
    assert not any(Path(f"/proc/{pid}").exists() for pid in pair.pids.values())


class Broken(RawUdp):
    """Nothing to talk to."""

    def __init__(self, messages):
        raise OSError("no such transport")


def test_failing_transport_is_reported():
    with pytest.raises(RuntimeError), echo.EchoPair(Broken, ("a",), realtime=False):
        pass


@pytest.mark.skipif(sys.platform != "linux", reason="counts are read from /proc")
def test_waits_are_counted_at_both_ends():
    waits = switches_per_exchange(RawUdp, 50)
    assert set(waits) == {"near", "far"}
    assert all(sum(by_thread.values()) > 0.0 for by_thread in waits.values())
