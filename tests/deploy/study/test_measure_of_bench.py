"""Arithmetic and order of the benchmarks; what things cost is asserted nowhere."""

from __future__ import annotations

import io
import json
import signal

import pytest
from rich.console import Console

from bus_schema.errors import Stopped
from deploy.run.stop_signals import stop_at_once
from deploy.scenario.yaml_files import ScenarioError
from deploy.studies.bench import command as bench
from deploy.studies.bench import first_runs
from deploy.studies.bench.loop import measure_control_steps
from deploy.studies.bench.measure import Section, Spread, cost_us, interleave, ratio


class FakeClock:
    """Time that passes only during work."""

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


def test_spread_is_reported_as_median_and_extremes():
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


def test_control_steps_are_measured_for_all_laws():
    section = measure_control_steps(steps=2, repetitions=1)
    assert {ratio.name for ratio in section.ratios} >= {
        "pid, 3 joints / step of physics, 3 joints",
        "fixed_time_neural, 7 joints / step of physics, 7 joints",
    }
    assert all(cost.lowest > 0 for cost in section.costs_us.values())


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


def test_large_costs_are_shown_in_whole_microseconds():
    costs = {"a": Spread((33_333.3,)), "b": Spread((516_000.0,)), "c": Spread((0.5,))}
    ratios = [ratio(costs, "a", "b"), ratio(costs, "c", "b")]
    shown = io.StringIO()
    bench.show_section(Console(file=shown, width=120), Section("Things", costs, ratios))
    output = shown.getvalue().split()
    assert {"33,333", "516,000", "0.5"} <= set(output)


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


class StoppedInDestructor:
    """Gets a request to stop where Python ignores what its handler raises."""

    def __del__(self):
        signal.raise_signal(signal.SIGTERM)


@pytest.mark.usefixtures("heeded_signals")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_request_to_stop_that_python_ignored_ends_the_measurement():
    stop_at_once()
    StoppedInDestructor()
    with pytest.raises(Stopped):
        interleave({"a": lambda: pytest.fail("measured")}, 1)


def test_the_first_run_fills_the_folder_of_kernels_and_the_next_compiles_none(tmp_path):
    def written():
        return {file: file.stat().st_mtime_ns for file in tmp_path.rglob("*.nbc")}

    first_runs.cpu_s("paper_arm", [], str(tmp_path))
    after_first = written()
    first_runs.cpu_s("paper_arm", [], str(tmp_path))
    assert after_first
    assert written() == after_first
    with pytest.raises(RuntimeError, match="no_such_arm"):
        first_runs.cpu_s("no_such_arm", [], str(tmp_path))
