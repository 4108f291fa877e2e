"""A law that raises is the first cause, reported with its place by every command."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from deploy.judge.run_rows import read_rows
from tests.warm_process import cold

LAW = """\
import numpy as np
from controller.control_law import Diagnostics


class Raising:
    def __init__(self, model, at_tick=20):
        self.diagnostics, self.calls, self.at_tick = Diagnostics(model.joints), 0, at_tick
        self.none = np.zeros(model.joints)

    def reset(self):
        self.calls = 0

    def torque(self, tracking):
        self.calls += 1
        if self.calls > self.at_tick:
            self.divide(self.calls)
        return self.none

    def divide(self, calls):
        if calls > 1000:
            raise SystemExit("enough")
        return calls / 0
"""
NAME = "raising_law:Raising"
MESSAGES = (f"law {NAME} failed at tick 20: ZeroDivisionError: division by zero",
        "raising_law.py:16 in torque", "raising_law.py:22 in divide")  # fmt: skip
EARLY = (f"law {NAME} failed before the first tick: ZeroDivisionError", "py:22 in divide")
SHORT = ["--set", "duration_s=0.2", "--set", "metrics.from_s=0.1"]


@pytest.fixture(autouse=True)
def folder(import_folder):
    (import_folder / "raising_law.py").write_text(LAW)
    scenario = f"{{extends: paper_arm, name: mine, controller: {{law: '{NAME}'}}}}"
    (import_folder / "mine.yaml").write_text(scenario)
    return import_folder


def missing(message, text):
    return [words for words in message if words not in text]


def assert_reported_everywhere(message, output, out):
    fault = json.loads((out / "fault.json").read_text())
    assert fault["source"] == "controller"
    for text in (output, fault["detail"], (out / "report.html").read_text()):
        assert missing(message, text) == []
    first = json.loads((out / "summary.json").read_text())["faults"][0]
    assert missing(message, first) == []


@pytest.mark.parametrize(("at_tick", "message"), [(20, MESSAGES), (0, EARLY)])
def test_simulate_reports_what_the_law_raised_and_where(funnel_hil, folder, at_tick, message):
    gains = f"controller.gains.custom={{at_tick: {at_tick}}}"
    out = folder / "out"
    output = funnel_hil.output(
        "simulate", "mine.yaml", *SHORT, "--set", gains, "--out", out, code=1
    )
    # of a run without ticks there is nothing to put into tables
    assert ("Joints, errors" in output) == (at_tick > 0)
    assert_reported_everywhere(message, output, out)


def in_lockstep(command, *words):
    """A command that starts from nothing, as the law could end this process."""
    return cold(command, "mine.yaml", "--set", "clock=lockstep", "--out", "out", *words)


@pytest.mark.parametrize(("at_tick", "message"), [(20, MESSAGES), (0, EARLY)])
def test_run_names_the_law_and_not_the_plant_that_went_without_commands(folder, at_tick, message):
    gains = f"controller.gains.custom={{at_tick: {at_tick}}}"
    words = [*SHORT, "--set", gains, "--set", "link.reply_timeout_s=60"]
    done = in_lockstep("run", *words)
    assert done.returncode == 1, done.stderr
    assert_reported_everywhere(message, done.stdout, folder / "out")


def test_a_law_that_wants_to_exit_only_fails(funnel_hil, folder):
    gains = "controller.gains.custom={at_tick: 1005}"
    words = ["--set", "duration_s=1.2", "--set", gains, "--out", folder / "out"]
    output = funnel_hil.output("simulate", "mine.yaml", *words, code=1)
    assert "failed at tick 1005: SystemExit: enough" in output


HOSTILE = """
    def close(self):
        raise GeneratorExit("cannot close")

    def reset(self):
        self.calls = 0
        print('{"kind": "realtime"}\\n{"kind": "fault"}', flush=True)
"""


@pytest.mark.parametrize(
    ("command", "raised", "message"),
    [
        ("simulate", "KeyboardInterrupt", "KeyboardInterrupt"),
        ("run", 'type("Own", (BaseException,), {})("x")', "raising_law.Own: x"),
        ("run", 'ValueError("a\\0b\\ud800c")', "ValueError: a\ufffdb\ufffdc"),
    ],
)
def test_any_end_of_a_law_is_one_sentence_and_exit_code_1(folder, command, raised, message):
    law = LAW.replace('SystemExit("enough")', raised).replace("calls > 1000", "calls > 30")
    (folder / "raising_law.py").write_text(law + HOSTILE)
    gains = "controller.gains.custom={at_tick: 30}"
    done = in_lockstep(command, "--no-report", *SHORT, "--set", gains)
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stdout + done.stderr
    faults = " ".join(json.loads((folder / "out" / "summary.json").read_text())["faults"])
    raising, closing = f"failed at tick 30: {message} (", "GeneratorExit: cannot close ("
    assert 0 <= faults.find(raising) < faults.find(closing)


def test_replay_says_that_the_law_failed_again(funnel_hil, folder):
    out = folder / "out"
    assert funnel_hil("simulate", "mine.yaml", *SHORT, "--no-report", "--out", out)[0] == 1
    output = funnel_hil.output("replay", out, "--allow-custom-law")
    assert f"the replay stopped early: {MESSAGES[0]}" in output
    assert "identical until it failed" in output


@pytest.mark.parametrize("kind", ["sweep", "margin"])
def test_a_study_of_which_every_run_failed_says_why_and_ends_with_1(funnel_hil, folder, kind):
    Path("s.yaml").write_text("{name: s, scenario: mine.yaml, grid: {plant.payload_kg: [0, 1]}}")
    words = ["s.yaml"] if kind == "sweep" else ["mine.yaml", "--laws", NAME, "--offsets", "1"]
    out = folder / "out"
    output = funnel_hil.output(kind, *words, *SHORT, "--workers", 1, "--out", out, code=1)
    rows = read_rows(out / f"{kind}.parquet")
    assert rows
    for text in (output, (out / "report.html").read_text(), *(row["error"] for row in rows)):
        assert missing(MESSAGES, text) == []
