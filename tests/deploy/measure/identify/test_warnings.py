"""A result that may be wrong says so, and what to do; a good one has few notes."""

import json

import numpy as np
import pytest

from deploy.measure.identify.identification import Wishes, identify
from tests.deploy.measure.identify.virtual_logs import excitation, to_currents, truth_of, write_log
from tests.warm_process import output_of

pytest.importorskip("scipy", reason="the extra identify is not installed")
SHORT_S, NM_PER_A = 25.0, 10.0


def log_of(file, arm, tool_kg=0.0):
    """Write the log of currents of an arm as its file has it, with a tool; return its truth."""
    random = np.random.default_rng(2)
    robot, model, *_ = excitation(arm, SHORT_S)
    truth = truth_of(robot, model, random)
    truth.bodies[:] = model.body_parameters().ravel()
    tool = [1, 0.03, 0.02, 0.08, 0.009, -0.0006, 0.01, -0.0024, -0.0016, 0.004]
    truth.bodies[-10:] += tool_kg * np.array(tool)
    write_log(file, arm, truth, random)
    to_currents(file, np.full(robot.joints, NM_PER_A))
    return truth


def test_tool_that_the_file_does_not_have_is_found_from_currents(tmp_path):
    truth = log_of(tmp_path / "log.csv", "ur5e", tool_kg=1.1)
    folder = tmp_path / "found"
    output = output_of("identify", tmp_path / "log.csv", "--robot", "ur5e", "--out", folder)
    assert "warning: the last link carries about 1.1 ± 0.0" in output
    summary = json.loads((folder / "summary.json").read_text())
    assert "--current-constants" in summary["warnings"][0]
    for joint in summary["joints"]:
        constant = joint["nm_per_a"]
        assert abs(constant["value"] - NM_PER_A) < 1.3 * constant["half_95"] < 1.0
    coulomb = [joint["coulomb_nm"]["value"] for joint in summary["joints"]]
    assert coulomb == pytest.approx(truth.coulomb, rel=0.05)
    report = (folder / "report.html").read_text()
    assert "the last link carries about 1.1" in report
    assert "± is noise alone" in report
    assert "± (95 %)" not in report


@pytest.mark.parametrize(
    ("tool_kg", "begins"),
    [(0.0, "current constants, and"), (3.0, "the weight in the robot's file does not explain")],
)
def test_constants_by_weight_are_as_true_as_the_masses_of_the_file(tool_kg, begins, tmp_path):
    """The three joints of this arm do not tell a tool from the scale."""
    log_of(tmp_path / "log.csv", "paper_arm", tool_kg)
    robot = excitation("paper_arm", SHORT_S)[0]
    found = identify([tmp_path / "log.csv"], [], None, robot, Wishes())
    (warning,) = found.warnings
    assert warning.startswith(begins)
    assert np.isfinite(found.constants.shown_half).any() == (tool_kg == 0.0)
    assert "--current-constants. Intervals (±) have the noise of the log alone" in warning
    given = Wishes(constants=np.full(3, NM_PER_A))
    assert identify([tmp_path / "log.csv"], [], None, robot, given).warnings == []


@pytest.mark.parametrize(("per_a", "size"), [(NM_PER_A, "smaller"), (0.01, "larger")])
def test_currents_given_as_torques_are_recognized(per_a, size, tmp_path):
    log_of(tmp_path / "log.csv", "paper_arm")
    to_currents(tmp_path / "log.csv", np.full(3, per_a / NM_PER_A))
    wishes = Wishes(columns={"torque": "current{n}_a"})
    robot = excitation("paper_arm", SHORT_S)[0]
    (warning,) = identify([tmp_path / "log.csv"], [], None, robot, wishes).warnings
    assert f"times {size} than those of the robot's file: if they are motor currents" in warning
    assert "--current" in warning


@pytest.mark.parametrize(("size", "notes", "matters"), [(0.0, 0, ""), (0.12, 2, "a small error"),
                                                        (1.0, 2, "fit a log with")])  # fmt: skip
def test_at_most_two_joints_are_noted_for_friction_of_another_form(size, notes, matters, tmp_path):
    log_of(tmp_path / "log.csv", "paper_arm")
    robot, _, _, (_, velocity, _), _ = excitation("paper_arm", SHORT_S)
    file = tmp_path / "log.csv"
    head, *_ = file.read_text().splitlines()
    values = np.loadtxt(file, delimiter=",", skiprows=1)
    waves = np.sin(3.0 * np.pi * velocity / np.abs(velocity).max(axis=0))
    values[:, -3:] += size * waves * values[:, -3:].std(axis=0)
    np.savetxt(file, values, "%.9g", ",", header=head, comments="")
    wishes = Wishes(constants=np.full(3, NM_PER_A))
    found = identify([file], [], None, robot, wishes)
    assert len(found.notes) == notes
    assert all("its friction depends on speed or load" in each for each in found.notes)
    assert all(matters in each for each in found.notes)
