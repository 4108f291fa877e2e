"""Arithmetic and order of the benchmarks; what things cost is asserted nowhere."""

from __future__ import annotations

import io
import json
import sys

import pytest
from rich.console import Console

from deploy.benchmarks import bench, cyclictest, echo
from deploy.benchmarks.context_switches import switches_per_exchange
from deploy.benchmarks.costs.control_step import measure_control_steps
from deploy.benchmarks.costs.finishing import measure_finishing
from deploy.benchmarks.costs.long_arm import write_long_arm
from deploy.benchmarks.costs.recorder import measure_recorder
from deploy.benchmarks.measure import Section, Spread, cost_us, interleave, ratio
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError


class FakeClock:
    """Time that passes only when somebody works."""

    def __init__(self):
        self.now_ns = 0

    def __call__(self):
        return self.now_ns

    def work(self, ns):
        self.now_ns += ns


def scripted(*costs, log=None, name=None):
    remaining = list(costs)

    def measure():
        if log is not None:
            log.append(name)
        return remaining.pop(0)

    return measure


def test_candidates_take_turns():
    log = []
    interleave({name: scripted(1, 1, 1, log=log, name=name) for name in "ab"}, 2)
    assert log == ["a", "b"] * 3


def test_the_first_turn_does_not_count():
    costs = interleave({"a": scripted(1000.0, 3.0, 1.0, 2.0)}, 3)
    assert costs["a"].samples == (3.0, 1.0, 2.0)


def test_a_candidate_may_have_several_costs():
    runs = iter([{"p50": 9.0, "p99": 9.0}, {"p50": 1.0, "p99": 4.0}, {"p50": 2.0, "p99": 5.0}])
    costs = interleave({"run": lambda: next(runs)}, 2)
    assert {name: cost.samples for name, cost in costs.items()} == {
        "p50": (1.0, 2.0),
        "p99": (4.0, 5.0),
    }


def test_a_spread_is_told_by_median_and_extremes():
    spread = Spread((5.0, 1.0, 2.0, 10.0))
    assert spread.as_dict() == {"median": 3.5, "lowest": 1.0, "highest": 10.0}


def test_ratios_are_formed_turn_by_turn():
    """A machine that halves its speed for one turn changes no ratio."""
    costs = {"a": Spread((2.0, 4.0, 2.0)), "b": Spread((1.0, 2.0, 1.0))}
    assert ratio(costs, "a", "b").value.samples == (2.0, 2.0, 2.0)


def test_ratios_of_sums():
    costs = {"a": Spread((6.0, 9.0)), "b": Spread((1.0, 1.0)), "c": Spread((2.0, 2.0))}
    found = ratio(costs, "a", ("b", "c"))
    assert found.name == "a / b + c"
    assert found.value.samples == (2.0, 3.0)


def test_a_cost_is_the_mean_on_the_given_clock():
    clock = FakeClock()
    assert cost_us(lambda: clock.work(5000), 7, clock) == 5.0


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


def test_cyclictest_that_is_missing_is_said_to_be(monkeypatch):
    monkeypatch.setenv("PATH", "")
    assert "not installed" in cyclictest.why_not()


@pytest.mark.parametrize("joints", [1, 14])
def test_the_long_arm_is_an_arm(tmp_path, joints):
    setup = load_setup(str(write_long_arm(tmp_path, joints)))
    assert setup.robot.joints == joints


def test_control_steps_are_measured_for_all_arms():
    section = measure_control_steps(steps=2, repetitions=1)
    assert len(section.costs_us) == 6
    assert all(cost.lowest > 0 for cost in section.costs_us.values())
    assert len(section.ratios) == 7


def test_the_recorder_is_measured():
    section = measure_recorder("paper_arm", 0.01, 1)
    assert section.ratios[0].value.lowest > 0


def test_what_comes_after_a_run_is_measured():
    section = measure_finishing("paper_arm", 0.05, 1)
    assert [len(section.costs_us), len(section.ratios)] == [4, 2]
    assert all(cost.lowest > 0 for cost in section.costs_us.values())


@pytest.mark.parametrize(
    "transport", ["zenoh", "zenoh_callbacks", "udp", "pyzmq", "lcm_udp", "cyclone"]
)
def test_every_transport_carries_an_exchange(transport):
    library = {"pyzmq": "zmq", "lcm_udp": "lcm", "cyclone": "cyclonedds"}.get(transport, "socket")
    pytest.importorskip(library)
    with echo.EchoPair(transport, ("a", "b", "c"), realtime=False) as pair:
        times = pair.round_trips_us(20, 1_000_000)
    assert times.median > 0


def test_a_transport_that_fails_is_told():
    with pytest.raises(RuntimeError), echo.EchoPair("no_such", ("a",), realtime=False):
        pass


def test_bench_writes_all_sections_as_a_table_and_json(monkeypatch, tmp_path):
    costs = {"a": Spread((2.0,)), "b": Spread((1.0,))}
    section = Section("Things", costs, [ratio(costs, "a", "b")], ["b is missing"])
    monkeypatch.setattr(bench, "_plan", lambda *, quick: {"things": lambda: section})
    shown = io.StringIO()
    file = tmp_path / "below" / "bench.json"
    bench.run_bench(Console(file=shown, width=120), file, quick=True)
    numbers = json.loads(file.read_text())
    assert numbers["quick"] is True
    assert numbers["sections"]["Things"]["ratios"]["a / b"]["median"] == 2.0
    assert numbers["sections"]["Things"]["notes"] == ["b is missing"]
    assert "a / b" in shown.getvalue()
    assert "b is missing" in shown.getvalue()


def test_large_costs_are_told_to_the_last_whole_microsecond():
    costs = {"a": Spread((33_333.3,)), "b": Spread((516_000.0,)), "c": Spread((0.5,))}
    ratios = [ratio(costs, "a", "b"), ratio(costs, "c", "b")]
    shown = io.StringIO()
    bench.show_section(Console(file=shown, width=120), Section("Things", costs, ratios))
    said = shown.getvalue().split()
    assert {"33,333", "516,000", "0.5"} <= set(said)


def test_a_section_that_fails_leaves_the_others(monkeypatch, tmp_path):
    def fail():
        raise RuntimeError("the plant was killed")

    section = Section("Things", {}, [], [])
    monkeypatch.setattr(bench, "_plan", lambda *, quick: {"ticks": fail, "things": lambda: section})
    broken, whole = bench.run_bench(Console(file=io.StringIO()), None, quick=True)
    assert broken.notes == [f"{bench.FAILED} the plant was killed"]
    assert whole is section


def test_a_file_that_cannot_be_written_is_refused_before_measuring(monkeypatch, tmp_path):
    monkeypatch.setattr(bench, "_plan", lambda *, quick: pytest.fail("measured"))
    (tmp_path / "file").touch()
    with pytest.raises(ScenarioError, match="--json"):
        bench.run_bench(Console(), tmp_path / "file" / "bench.json", quick=True)


@pytest.mark.skipif(sys.platform != "linux", reason="counts are read from /proc")
def test_waits_are_counted_at_both_ends():
    waits = switches_per_exchange("udp", 50)
    assert set(waits) == {"near", "far"}
    assert all(sum(by_thread.values()) > 0.0 for by_thread in waits.values())
