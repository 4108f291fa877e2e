"""What the terminal shows of a run, beside what its tables hold."""

from __future__ import annotations

import io
import shlex
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from bus_schema.messages import topics
from deploy.cli.commands import LazyCommand
from deploy.judge.metrics import judge, summarise
from deploy.judge.run_data import RunData
from deploy.reports.runs.run_pages import run_page
from deploy.reports.runs.run_tables import health_table
from deploy.reports.terminal import print_conditions, print_page
from deploy.run.execute import JudgedRun
from deploy.run.simulate import simulate
from deploy.scenario.effective import write_scenario
from deploy.scenario.scenario import load_setup

GRANTED = {"granted": True, "detail": "in force"}
REFUSED = {"granted": False, "detail": "refused"}


@pytest.fixture(scope="module")
def run() -> RunData:
    return simulate(load_setup("paper_arm", ["duration_s=0.1", "metrics.from_s=0.04"])).data()


@pytest.fixture
def held_up(run: RunData) -> RunData:
    """A run in real time, one tick of which came 102 ms late."""
    truth = run.tables[topics.PLANT_TRUTH.name].copy()
    truth["timing.lateness_ns"][50] = 102_000_000
    tables = {**run.tables, topics.PLANT_TRUTH.name: truth}
    return replace(run, clock="realtime", tables=tables)


def shown(run: RunData, *settings: dict[str, object]) -> str:
    """What the terminal shows of a run whose plant was granted or refused some settings."""
    manifest = {"realtime": {"plant": list(settings)} if settings else {}}
    console = Console(file=io.StringIO(), width=200)
    print_page(console, run_page(JudgedRun("", run), manifest))
    return console.file.getvalue()


def setting(name: str, values: dict[str, object]) -> dict[str, object]:
    return {"name": name, **values}


@pytest.mark.parametrize(
    ("affinity", "scheduler", "cause"),
    [
        (GRANTED, GRANTED, "most likely by the host:"),
        (REFUSED, GRANTED, "another loop on its CPU, as a loop of this run had no CPU affinity:"),
        (GRANTED, REFUSED, "by other programs, as a loop of this run had no real-time scheduler:"),
        (
            REFUSED,
            REFUSED,
            "by other programs or another loop on its CPU, as a loop of this run had no real-time"
            " scheduler and no CPU affinity:",
        ),
    ],
)
def test_cause_of_a_delay_follows_from_missing_settings(held_up, affinity, scheduler, cause):
    text = shown(
        held_up, setting("CPU affinity", affinity), setting("real-time scheduler", scheduler)
    )
    assert "A loop could not run for 102 ms" in text
    assert cause in text
    assert ("by the host" in text) == (affinity is scheduler is GRANTED)


def test_unknown_settings_do_not_blame_the_host_alone(held_up):
    assert "could not run for 102 ms, by the host or by other processes:" in shown(held_up)


def missing(run: RunData, ticks: slice, *, clock: str = "realtime") -> RunData:
    """A run that missed its deadline at these ticks."""
    truth = run.tables[topics.PLANT_TRUTH.name].copy()
    truth["deadline_met"] = 1
    truth["deadline_met"][ticks] = 0
    return replace(run, clock=clock, tables={**run.tables, topics.PLANT_TRUTH.name: truth})


def test_late_host_is_named_after_the_verdict_with_its_share_and_longest_run(run):
    page = run_page(JudgedRun("", missing(run, slice(10, 14))))
    assert page.verdict.headline == "Bounds kept"  # the law's; the host is no part of it
    first, second, *others = page.verdict.reasons
    assert first.startswith("The true error was inside its bounds")
    assert second == (  # 0.1 s at 1 kHz
        "The host was late: 4 of 100 ticks (4 %) missed their deadline, at most 4 in a row (4 ms)."
    )
    assert "late" not in " ".join(others)


def test_misses_in_virtual_time_are_not_the_host(run):
    assert "was late" not in shown(missing(run, slice(10, 14), clock="lockstep"))
    assert "was late" not in shown(missing(run, slice(0, 0)))


@pytest.mark.parametrize(
    ("settings", "who"),
    [
        (["link.uplink.delay_ms=2"], "The host was late"),
        (["link.uplink.delay_ms=2", "link.deadline_ms=2"], "The host or the emulated link was"),
        (["link.uplink.jitter_ms=3"], "The host or the emulated link was late"),
        (["link.downlink.loss=0.3"], "The host or the emulated link was late"),
        (
            ["faults=[{kind: link_cut, direction: uplink, at_s: 0.05, for_s: 0.01}]"],
            "The host or the emulated link or a fault was late",
        ),
    ],
)
def test_host_alone_is_blamed_only_where_the_link_cannot_be_late(settings, who):
    data = simulate(load_setup("paper_arm", ["duration_s=0.1", *settings])).data()
    assert who in shown(missing(data, slice(50, 53)))


def test_a_controller_that_was_killed_is_named_in_place_of_the_host(run):
    """Its last command ages until the end; virtual time is no help."""
    late = missing(run, slice(60, 100))
    killed = replace(late, failures=["the controller was killed by SIGKILL"])
    said = " ".join(run_page(JudgedRun("", killed)).verdict.reasons)
    assert (
        "40 of 100 ticks (40 %) missed their deadline, at most 40 in a row (40 ms), as the"
        " controller process ended: the controller was killed by SIGKILL."
    ) in said
    assert "host" not in said
    assert "The host was late" in " ".join(run_page(JudgedRun("", late)).verdict.reasons)


def test_one_command_repeats_a_late_run_in_lockstep(run, tmp_path):
    folder = tmp_path / "late run"
    folder.mkdir()
    late = missing(run, slice(10, 14))
    write_scenario(run.setup, folder / "scenario.yaml")
    *_, command = [
        text for text in run_page(JudgedRun("", late, path=folder)).verdict.reasons if "run" in text
    ]
    program, name, *arguments = shlex.split(command.partition(": ")[2])
    assert (program, name) == ("funnel-hil", "run")
    context = LazyCommand("run").load().make_context("run", arguments)
    repeated = load_setup(context.params["scenario"], context.params["overrides"])
    assert repeated.scenario.clock == "lockstep"
    assert repeated.scenario.link == run.setup.scenario.link
    real_delay = run_page(JudgedRun("", late, path=folder), {"real_delay": {}})
    assert "lockstep" not in " ".join(real_delay.verdict.reasons)  # it would have no delay


def test_time_range_of_the_errors_is_shown(run):
    assert "Joints, errors from 0.04 s on, torques of the whole run\n" in shown(run)


def test_ticks_skipped_by_a_late_plant_are_shown(run):
    truth = run.tables[topics.PLANT_TRUTH.name].copy()
    truth["timing.skipped"][60:] = 7
    skipped = replace(run, tables={**run.tables, topics.PLANT_TRUTH.name: truth})
    assert summarise(skipped)["recording"]["ticks_skipped"] == 7
    said = "the plant was late: it skipped 7 ticks, which count as missed, and sent 100 states"
    assert said in shown(skipped)
    truth["timing.skipped"][60:] = 1
    assert "it skipped 1 tick, which counts as missed, and" in shown(skipped)
    rows = dict(health_table(judge(skipped)).rows)
    assert (rows["Ticks"], rows["Ticks skipped by a late plant"]) == (100, 1)
    assert "skipped" not in shown(run)
    assert not any("skipped" in name for name, _ in health_table(judge(run)).rows)


def test_skipped_ticks_are_missed_deadlines_of_a_late_host(run):
    """20 skipped and 5 late ticks of 100, of which 2 are both: 77 % on time."""
    late = missing(run, slice(28, 33))
    truth = late.tables[topics.PLANT_TRUTH.name]
    truth["timing.lateness_ns"][10:30] = -1
    truth["timing.skipped"][10:] = np.minimum(np.arange(1, len(truth) - 9), 20)
    timing = summarise(late)["timing"]
    assert (timing["deadline_misses"], timing["success_rate"]) == (5, pytest.approx(0.95))
    assert (timing["late_ticks"], timing["late_longest_run"]) == (23, 23)
    assert timing["on_time_rate"] == pytest.approx(0.77)
    text = " ".join(shown(late).split())
    assert "deadlines met 77 %" in text
    assert "The host was late: 23 of 100 ticks (23 %) were skipped or missed their deadline" in text


def test_a_host_that_only_skips_ticks_is_late_too(run):
    late = missing(run, slice(0, 0))
    late.tables[topics.PLANT_TRUTH.name]["timing.lateness_ns"][10:30] = -1
    text = shown(late)
    assert "The host was late: 20 of 100 ticks (20 %) were skipped" in text
    assert "deadlines met 100 %" not in text


def test_timing_messages_and_events_are_folded_and_marked_where_something_is_odd(run):
    usual = run_page(JudgedRun("", run))
    assert usual.folded[0] == "Timing, messages and events"
    titles = {table.title for cards in usual.folded[1] for table in cards.tables}
    assert {"Timing", "Transport", "Events"} <= titles
    assert "Transport" not in shown(run)
    lossy = simulate(load_setup("paper_arm", ["duration_s=0.1", "link.uplink.loss=0.2"])).data()
    lost = summarise(lossy)["transport"]["uplink"]["lost"]
    assert lost > 5  # of 100
    title = run_page(JudgedRun("", lossy)).folded[0]
    assert f"{lost} messages lost" in title
    assert "⚠" in title


def test_a_terminal_shows_the_verdict_first_and_the_main_conditions_on_one_line(run):
    lines = shown(run).splitlines()
    assert lines[1] == "bounds kept"
    (conditions,) = [line for line in lines if line.startswith("Conditions:")]
    assert "physics:" in conditions
    assert conditions.endswith("The report has all conditions.")
    assert len(conditions) < 250


def test_folded_part_names_what_is_odd_in_it(run):
    judged = JudgedRun("", run)
    assert "⚠" not in run_page(judged).folded[0]
    judged.result.transport.uplink.rejected.update(stale=2, invalid=1)
    assert run_page(judged).folded[0].endswith("⚠ 3 messages rejected")


def test_conditions_shorten_long_overrides_and_say_where_all_are():
    console = Console(file=io.StringIO(), width=400)
    print_conditions(console, {"law": "pid", "set": "a=1, " * 40, "host": "h"})
    (line,) = console.file.getvalue().splitlines()
    assert "law: pid; set: a=1, a=1" in line
    assert line.endswith("a=.... The report has all conditions.")
    assert "host" not in line
