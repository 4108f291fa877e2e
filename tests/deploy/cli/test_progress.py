from __future__ import annotations

import io
import logging
import re
import threading

import pytest
from rich.console import Console

from bus_schema.runtime.compiled import COMPILES, HAS_SAID
from deploy.cli import run_and_simulate
from deploy.cli.commands import LogLines
from deploy.cli.parts import progress as progress_module
from deploy.cli.parts.progress import CommandProgress
from deploy.cli.parts.study_command import RunCounter
from deploy.cli.show_run import status_handler
from deploy.run.processes.status import StatusMessage
from tests.waiting import HANG_S


@pytest.fixture
def console():
    return Console(file=io.StringIO(), width=200)


def lines(console):
    return console.file.getvalue().splitlines()


def test_without_a_terminal_the_last_state_is_a_plain_line(console):
    with CommandProgress(console, "arm", 8, "s") as progress:
        progress.update(1.0)
        progress.update(2.5, note="joint [elbow]")
    (line,) = lines(console)
    assert line.startswith("2.5 of 8 s, ")
    assert line.endswith(", joint [elbow]")


def test_runs_of_earlier_commands_are_counted_apart_and_have_no_speed(console):
    with CommandProgress(console, "study", 4, "runs") as progress:
        counter = RunCounter(progress)
        counter.done({"error": None}, 4, True)
        counter.done({"error": "it broke"}, 4, True)
    assert lines(console) == [
        "2 of 4 runs, 2 runs were there from before, 1 ended by a fault or reflex"
    ]


def test_a_total_of_a_search_never_rises_and_its_time_left_counts_down(console, monkeypatch):
    """Searches end early; each run takes 2 s, later ones 1 or 6 s; the first waits for 30 s."""
    now_s = [0.0]
    monkeypatch.setattr(progress_module.time, "monotonic", lambda: now_s[0])
    with CommandProgress(console, "search", 60, "runs") as progress:
        counter = RunCounter(progress)
        for done, most in enumerate([60] * 5 + [50] * 10 + [55] * 5 + [40] * 20, start=1):
            usual_s = 2.0 if done <= 20 else 1.0 if done <= 25 else 6.0
            now_s[0] += 30.0 if done == 1 else usual_s
            counter.done({"error": None}, most, False)
    shown = lines(console)
    assert shown[0] == "1 of 60 runs, 0.0333 runs/s"
    assert any(re.match("9 of at most 50 runs, .*, at most 82 s left", line) for line in shown)
    totals = [int(re.search(r" of (?:at most )?(\d+) runs", line)[1]) for line in shown]
    assert totals == sorted(totals, reverse=True)
    assert {60, 50, 40} == set(totals)
    left = {
        int(line.split()[0]): int(found[1])
        for line in shown
        if (found := re.search(r"at most (\d+) s left", line))
    }
    until_slower = [left_s for done, left_s in left.items() if done <= 25]
    assert until_slower == sorted(until_slower, reverse=True)
    assert left[35] > 5 * 2  # each of the last five takes 6 s, which raises the mean
    assert shown[-1].startswith("40 of at most 40 runs, ")
    assert "left" not in shown[-1]


def test_studies_in_turn_have_one_total(console):
    with CommandProgress(console, "data sheet", 4 + 3, "runs") as progress:
        counter = RunCounter(progress)
        counter.begin(3)
        counter.done({"error": None}, 4, False)
        counter.done({"error": None}, 2, False)  # it ends early
        counter.begin(0)
        counter.done({"error": None}, 3, False)
    (line,) = lines(console)
    assert line.startswith("3 of at most 5 runs, ")


def test_the_speed_of_runs_is_that_of_all_that_this_command_did(console, monkeypatch):
    now_s = [0.0]
    monkeypatch.setattr(progress_module.time, "monotonic", lambda: now_s[0])
    with CommandProgress(console, "study", 8, "runs") as progress:
        counter = RunCounter(progress)
        for now_s[0], before in ((10.0, True), (12.0, False), (13.0, True), (14.0, False)):
            counter.done({"error": None}, 8, before)
    assert lines(console)[-1] == "4 of 8 runs, 0.5 runs/s, 8 s left, 2 runs were there from before"


def test_what_processes_say_is_shown(console):
    with CommandProgress(console, "arm", 8, "s") as progress:
        handle = status_handler(progress)
        handle(StatusMessage("plant", "progress", {"time_s": 1.5, "late_ticks": 3}))
        handle(StatusMessage("controller", "fault", {"text": "[it] broke"}))
    fault, last = lines(console)
    assert fault == "controller: [it] broke"
    assert last.startswith("1.5 of 8 s")
    assert last.endswith("deadlines missed 3")


NAMED = ("base_yaw", "shoulder", "elbow")
NUMBERED = tuple(f"lbr_iiwa_joint_{number}" for number in range(1, 8))


def last_live_line(monkeypatch, width, name, joints, worst_mrad, misses):
    """What a terminal shows in the end of 15.25 s of 20 s, a little slower than real time."""
    now_s = [0.0]
    monkeypatch.setattr(progress_module.time, "monotonic", lambda: now_s[0])
    console = Console(
        file=io.StringIO(), width=width, force_terminal=True, color_system=None,
        get_time=lambda: 0.0,
    )  # fmt: skip
    with CommandProgress(console, name, 20, "s") as progress:
        handle = status_handler(progress, joints)
        worst = {"joint": 1, "error_mrad": worst_mrad, "bound_mrad": 10.0}
        handle(StatusMessage("plant", "progress", {"time_s": 0.0, "late_ticks": 0}))
        handle(StatusMessage("controller", "progress", worst))
        now_s[0] = 15.28
        handle(StatusMessage("plant", "progress", {"time_s": 15.25, "late_ticks": misses}))
    output = re.split(r"[\r\n]|\x1b\[2K", console.file.getvalue())
    return [line for line in output if "of 20 s" in line][-1].rstrip()


def test_at_80_columns_time_speed_error_and_misses_are_seen(monkeypatch):
    line = last_live_line(monkeypatch, 80, "paper_arm", NAMED, -12.345, 3)
    assert line == "15.25 of 20 s, speed 0.998, base_yaw -12.345 of 10.0 mrad, deadlines missed 3"
    line = last_live_line(monkeypatch, 80, "iiwa", NUMBERED, 0.123, 12345)
    assert (
        line == "15.25 of 20 s, speed 0.998, …joint_1 +0.123 of 10.0 mrad, deadlines missed 12345"
    )


def test_the_time_of_starting_up_says_nothing_of_the_time_left(console, monkeypatch):
    now_s = [0.0]
    monkeypatch.setattr(progress_module.time, "monotonic", lambda: now_s[0])
    with CommandProgress(console, "arm", 8, "s") as progress:
        handle = status_handler(progress)
        for now_s[0], time_s in ((100.0, 0.0), (102.0, 2.0)):
            handle(StatusMessage("plant", "progress", {"time_s": time_s}))
    assert lines(console)[-1] == "2 of 8 s, speed 1, 6 s left"


def test_what_is_logged_beside_a_live_line_has_a_line_of_its_own(monkeypatch):
    logger = logging.getLogger("beside")
    monkeypatch.setattr(logger, "handlers", [LogLines()])
    terminal = Console(file=io.StringIO(), force_terminal=True, width=200)
    with CommandProgress(terminal, "arm", 8, "s"):
        logger.warning("something is odd")
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", terminal.file.getvalue())
    assert "something is odd" in re.split(r"[\r\n]+", plain)


def test_compilation_by_several_processes_is_reported_once(console, monkeypatch):
    monkeypatch.delenv(HAS_SAID)
    with CommandProgress(console, "arm", 8, "s") as progress:
        handle = status_handler(progress)
        for role in ("plant", "controller"):
            handle(StatusMessage(role, "compiles", {}))
    assert lines(console) == [COMPILES]


def test_report_is_loaded_once_the_plant_has_ended(monkeypatch):
    loaded, shown = threading.Semaphore(0), []
    monkeypatch.setattr(run_and_simulate, "load_report", loaded.release)
    handle = run_and_simulate.loading_report(shown.append)
    early = [
        StatusMessage("plant", "note", {}),
        StatusMessage("plant", "progress", {"time_s": 0.2}),
        StatusMessage("controller", "result", {}),
    ]
    for message in early:
        handle(message)
    assert not loaded.acquire(blocking=False)
    results = [StatusMessage("plant", "result", {})] * 2  # of a plant that was started again, too
    for message in results:
        handle(message)
    assert loaded.acquire(timeout=HANG_S)
    assert not loaded.acquire(blocking=False)
    assert shown == [*early, *results]


def test_time_left_is_shown_once_the_speed_is_steady(console, monkeypatch):
    now_s = [0.0]
    monkeypatch.setattr(progress_module.time, "monotonic", lambda: now_s[0])
    with CommandProgress(console, "study", 284, "runs") as progress:
        for done in range(1, 285):
            now_s[0] += 0.75 if done < 20 else 1.5  # the first runs are short
            progress.update(done)
    left_s = [
        (int(line.split()[0]), int(found[1]))
        for line in lines(console)
        if (found := re.search(r"(\d+) s left", line))
    ]
    assert min(left_s)[0] >= 28  # not at 5 of 284
    assert len(left_s) > 50
    for done, said_s in left_s:
        assert abs(said_s - 1.5 * (284 - done)) < 0.25 * 1.5 * (284 - done) + 1
