"""Answers of a program for the next ticks, with targets for the drives."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import controller.external
from controller.control_law import Diagnostics
from controller.laws.custom import laws_given
from deploy.judge.metrics import summarise
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from tests.waiting import HANG_S

HERE = Path(controller.external.__file__).parent
DRIVES = "controller.drive_feedback.enabled=true"
ROWS, PERIOD_S = 20, 0.001
INTEGRAL = (20000.0, 40000.0, 6000.0)


class Chunk:
    """The law of chunk.c, operation by operation."""

    def __init__(self, model):
        self.diagnostics = Diagnostics(model.joints)
        self.reset()

    def reset(self):
        self.sum = [0.0, 0.0, 0.0]

    def torque(self, tracking):
        torques, self.targets = np.zeros((ROWS, 3)), np.zeros((ROWS, 2, 3))
        for row in range(ROWS):
            ahead_s = row * PERIOD_S
            for i in range(3):
                velocity = float(tracking.reference_velocity[i])
                change = ahead_s * float(tracking.reference_acceleration[i])
                reference = float(tracking.reference_position[i])
                self.sum[i] += PERIOD_S * (float(tracking.position[i]) - reference)
                torques[row, i] = -INTEGRAL[i] * self.sum[i]
                self.targets[row, 0, i] = reference + ahead_s * (velocity + 0.5 * change)
                self.targets[row, 1, i] = velocity + change
        return torques

    def target(self, tracking):
        return self.targets


def simulated(*overrides):
    return simulate(load_setup("paper_arm", [DRIVES, "duration_s=0.5", *overrides])).data()


def external(command, rows, *overrides):
    words = ", ".join(f"'{word}'" for word in command)
    return simulated(
        "controller.law=external", f"controller.external.command=[{words}]",
        f"controller.external.rows={rows}", f"controller.external.start_timeout_s={HANG_S}",
        f"controller.external.timeout_s={HANG_S}", *overrides,
    )  # fmt: skip


def test_chunks_of_the_c_example_and_of_a_law_in_python_give_the_same_bits(tmp_path):
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("needs a C compiler, cc")
    program = tmp_path / "chunk"
    subprocess.run(
        [compiler, "-std=c99", "-Wall", "-Wextra", "-Werror", "-O2", "-ffp-contract=off",
         "-I", HERE, "-o", program, HERE / "examples" / "chunk.c"],
        check=True,
    )  # fmt: skip
    in_c = external([str(program)], ROWS, "controller.every=20", "controller.external.targets=true")
    with laws_given({"chunk:Law": Chunk}):
        in_python = simulated("controller.law=chunk:Law", "controller.every=20")
    assert in_c.digest == in_python.digest
    # The second row is in force at tick 1: targets move along the reference, not in steps of 20 ms.
    targets = in_c.tables["joint_commands"]["position"]
    assert np.diff(targets[:, 1]).all()
    assert summarise(in_c)["bounds"]["violation_fraction"] == 0.0


SCRIPT = """
import struct, sys
while header := sys.stdin.buffer.read(64):
    question, _, joints, time_s, _, _, rows, targets = struct.unpack("8d", header)
    sys.stdin.buffer.read(8 * 8 * int(joints))
    values = {values}
    sys.stdout.buffer.write(struct.pack(f"{{1 + len(values)}}d", 0.0, *values))
    sys.stdout.buffer.flush()
"""


def program(tmp_path, values):
    """A program that answers each question with these values, an expression in Python."""
    path = tmp_path / "law.py"
    path.write_text(SCRIPT.format(values=values))
    return [sys.executable, str(path)]


def test_each_row_acts_at_its_tick_and_the_last_is_held(tmp_path):
    command = program(tmp_path, "[rows, 0, 0, 10 + time_s, 0, 0]")
    run = external(command, 2, "controller.every=4", "duration_s=0.006")
    torques = run.tables["joint_commands"]["effort"][:, 0]
    np.testing.assert_allclose(torques, [2, 10, 10, 10, 2, 10.004])


@pytest.mark.parametrize(
    ("rows", "later", "complaint"),
    [
        (2, "[1.0] * 3", "did not answer within 0.2 s"),
        (2, "[1.0] * 5 + [float('nan')]", "torques[1, 2] = nan: must be finite"),
        (1, "[1.0] * 8 + [float('inf')]", "targets[0, 1, 2] = inf: must be finite"),
    ],
)
def test_answer_without_all_numbers_is_a_fault(tmp_path, rows, later, complaint):
    command = program(
        tmp_path, f"{later} if time_s else [0.0] * int(joints * rows * (1 + 2 * targets))"
    )
    patience_s = 0.2 if "within 0.2 s" in complaint else 60
    more = ["controller.every=2", f"controller.external.timeout_s={patience_s}"]
    run = external(command, rows, *more, f"controller.external.targets={rows == 1}")
    assert complaint in " ".join(run.faults())
