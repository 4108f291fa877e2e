"""A run that is not known to have kept its bounds counts as kept nowhere."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import typer
from rich.console import Console

from bus_schema.messages import topics
from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import Role
from bus_schema.recording.atomic_files import write_json
from deploy.api.funnel_hil.results import Run
from deploy.cli.parts.common import finish
from deploy.cli.parts.options import OneRunOptions
from deploy.judge.bounds import plant_count
from deploy.judge.metrics import RunResult, summarise
from deploy.judge.run_rows import held, row
from deploy.judge.verdict import verdict_of
from deploy.reports.run_index import results_in
from deploy.reports.verdict_texts import verdict_on_run
from deploy.run.execute import JudgedRun
from deploy.run.recording import record_failures
from deploy.run.run_folder import RunFolder, load_run
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.studies.comparison.sentences import verdict_on_laws
from deploy.studies.comparison.tables import status_cell
from deploy.study.comparison.compared_runs import ComparedRuns
from deploy.study.comparison.settling import settling_test
from deploy.study.statistics import spread_of_runs

TICKS = 200


@pytest.fixture(scope="module")
def simulation():
    return simulate(load_setup("paper_arm", ["duration_s=0.2", "metrics.from_s=0.1"]))


@pytest.fixture(scope="module")
def run(simulation):
    return simulation.data()


def with_end(run, **changes):
    """The run, whose plant says something else at its end."""
    reported = {**run.last_values(Role.PLANT, EventKind.ENDED), **changes}
    others = [event for event in run.events if event.kind != EventKind.ENDED]
    end = RunEvent(TICKS * 10**6, "plant", EventKind.ENDED, json.dumps(reported))
    return replace(run, events=[*others, end])


def without_end(run):
    return replace(run, events=[e for e in run.events if e.kind != EventKind.ENDED])


def with_truth(run, change):
    truth = change(run.tables[topics.PLANT_TRUTH.name].copy())
    return replace(run, tables={**run.tables, topics.PLANT_TRUTH.name: truth})


def without(first, last):
    return lambda truth: np.delete(truth, slice(first, last))


def nowhere(truth):
    truth["position"][50, 1] = np.nan
    return truth


def outside(run, ticks):
    return with_end(run, bounds={"ticks": TICKS + 1, "outside": ticks, "margin_min": -474.0})


def law_error(run):
    event = RunEvent(TICKS * 10**6, "controller", EventKind.FAULT, "the law failed")
    return replace(run, events=[*run.events, event])


CASES = {
    "a process was killed": ("faulted", lambda run: replace(run, failures=["it was killed"])),
    "the law raised at the last tick": ("faulted", law_error),
    "the recording is damaged": ("unknown", lambda run: replace(run, damage=["x"], complete=False)),
    "the recording was not finished": ("unknown", lambda run: replace(run, complete=False)),
    "ticks are missing": ("unknown", lambda run: with_truth(run, without(40, 110))),
    "ticks are missing, where the plant left": (
        "lost", lambda run: outside(with_truth(run, without(40, 110)), 7)
    ),
    "the plant counted more outside": ("lost", lambda run: outside(run, 7)),
    "the plant counted other ticks": (
        "unknown",
        lambda run: with_end(run, bounds={"ticks": 150, "outside": 0, "margin_min": 0.3}),
    ),
    "the plant counted another margin": (
        "unknown",
        lambda run: with_end(run, bounds={"ticks": TICKS + 1, "outside": 0, "margin_min": 0.9}),
    ),
    "the state is not a number": ("lost", lambda run: with_truth(run, nowhere)),
    "it was stopped": ("interrupted", lambda run: with_end(run, completed=False)),
    "an earlier end is reported": (
        "interrupted",
        lambda run: with_end(
            with_truth(run, without(101, None)), ticks=100,
            bounds={**plant_count(run), "ticks": 101},
        ),
    ),
    "the recording ends before the plant": (
        "unknown", lambda run: without_end(with_truth(run, without(101, None)))
    ),
    "nothing was recorded": ("nothing", lambda run: with_truth(run, without(0, None))),
}  # fmt: skip


@pytest.fixture(params=CASES)
def case(request, run):
    """A verdict, and a run that deserves it."""
    verdict, change = CASES[request.param]
    return verdict, change(run)


def test_a_whole_run_inside_its_bounds_is_kept(run):
    summary = summarise(run)
    assert (summary["verdict"], summary["bounds"]["kept"]) == ("kept", True)
    counted = plant_count(run)
    assert (counted["ticks"], counted["outside"]) == (TICKS + 1, 0)
    assert counted["margin_min"] == summary["bounds"]["margin_min"]
    assert held(row(RunResult(**summary), 1))
    assert Run(JudgedRun("", run)).kept


def test_a_run_that_is_not_known_to_be_kept_counts_as_kept_nowhere(case, tmp_path):
    expected, run = case
    summary = summarise(run)
    assert (summary["verdict"], summary["bounds"]["kept"]) == (expected, False)
    assert not (summary["completed"] and expected in ("faulted", "interrupted", "nothing"))
    head = verdict_on_run(JudgedRun("", run, RunResult(**summary)))
    assert head.level != "good"
    assert not head.headline.startswith("Bounds kept")
    law_run = JudgedRun("law", run)
    assert status_cell(law_run).text == expected
    assert verdict_on_laws(ComparedRuns([law_run])).level != "good"
    values = row(RunResult(**summary), 1)
    assert not held(values)
    assert spread_of_runs([{**values, "point": "p"}])["runs_kept"] == 0
    assert not Run(law_run).kept
    assert expected in repr(Run(law_run))
    (tmp_path / "one").mkdir()
    write_json(tmp_path / "one" / "summary.json", summary)
    write_json(tmp_path / "one" / "manifest.json", {})
    assert [each.result for each in results_in(tmp_path)] != ["bounds kept"]
    test = settling_test("law", [([0.1], values)])
    assert not test.starts[0].bounds_kept
    if expected in ("faulted", "interrupted", "nothing"):
        assert test.starts[0].settling_time_s is None


def test_no_such_run_ends_in_order_where_bounds_are_required(case, tmp_path):
    expected, run = case
    options = OneRunOptions(require_bounds=True, no_report=True)
    with RunFolder.begin(run.setup, tmp_path / "out") as folder, pytest.raises(typer.Exit) as ended:
        finish(Console(quiet=True), folder, JudgedRun("law", run), options)
    summary = json.loads(folder.summary.read_text(), parse_constant=pytest.fail)
    assert ended.value.exit_code == (3 if summary["completed"] else 1)
    assert (summary["verdict"], summary["bounds"]["kept"]) == (expected, False)


def test_a_summary_of_an_older_version_has_no_verdict():
    assert verdict_of({}) == verdict_of({"verdict": "fine"}) == "nothing"


@pytest.mark.parametrize("is_partial", [False, True])
def test_what_ended_a_run_is_in_its_recording(simulation, tmp_path, is_partial):
    simulation.write_log(tmp_path / "whole.mcap")
    file = tmp_path / "run.mcap"
    written = (tmp_path / "whole.mcap").read_bytes()
    if is_partial:
        written = written[: len(written) * 9 // 10]
        file = tmp_path / "run.partial.mcap"
    file.write_bytes(written)
    assert summarise(load_run(file)[0])["verdict"] == ("unknown" if is_partial else "kept")
    for number in (1, 2):  # one after the other
        record_failures(tmp_path / "run.mcap", [f"the controller was killed {number} times"])
    data, contents = load_run(file)
    assert data.complete is not is_partial
    assert not data.damage
    assert not contents.lacks_checksums
    summary = summarise(data)
    assert summary["verdict"] == "faulted"
    assert summary["faults"] == ["the controller was killed 2 times"]
    assert summary["digest"] == summarise(simulation.data())["digest"] or is_partial


@pytest.mark.parametrize(
    ("delay_ms", "verdict"), [(60, "nothing"), (50, "nothing"), (49, "kept"), (0, "kept")]
)
def test_run_in_which_no_command_acted_shows_nothing(delay_ms, verdict):
    """A command that comes into force at the last tick moves nothing."""
    words = ["duration_s=0.05", "metrics.from_s=0", f"link.downlink.delay_ms={delay_ms}"]
    run = simulate(load_setup("paper_arm", words)).data()
    summary = summarise(run)
    assert (summary["verdict"], summary["completed"], summary["bounds"]["kept"]) == (
        verdict, True, verdict == "kept",
    )  # fmt: skip
    head = verdict_on_run(JudgedRun("", run, RunResult(**summary)))
    assert head.headline.startswith("No command ever acted") is (verdict == "nothing")
