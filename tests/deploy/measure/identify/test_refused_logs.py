"""Logs that cannot be identified are refused, with file, column or line, and what is allowed."""

import sys
from unittest import mock

import numpy as np
import pytest

from deploy.measure.identify.robot_log import _chosen, read_robot_log
from deploy.measure.identify.signals import checked
from deploy.scenario.referenced_files import ROBOTS
from tests.arms import PAPER_ARM
from tests.warm_process import here, output_of

pytest.importorskip("scipy", reason="the extra identify is not installed")
NAMES = ("base_yaw", "shoulder", "elbow")
ROWS, RATE_HZ = 1500, 100.0


def rows(**changed) -> np.ndarray:
    """Return time, positions, velocities and torques of a slow motion, shape (rows, 10)."""
    times_s = np.arange(ROWS) / RATE_HZ
    speeds = np.array([1.1, 1.7, 2.3])
    angle = np.outer(times_s, speeds)
    values = {
        "time": times_s[:, None],
        "position": 0.5 * np.sin(angle),
        "velocity": 0.5 * speeds * np.cos(angle),
        "torque": np.sign(np.cos(angle)) + 5.0 * np.sin(angle),
    } | changed
    return np.hstack([values[kind] for kind in ("time", "position", "velocity", "torque")])


def write(file, values: np.ndarray, names=NAMES) -> None:
    columns = ["time_s", *(f"{kind}.{name}" for kind in ("position", "velocity", "effort")
                           for name in names)]  # fmt: skip
    np.savetxt(file, values, "%.9g", ",", header=",".join(columns), comments="")


def backwards() -> np.ndarray:
    values = rows()
    values[700, 0] = values[698, 0]
    return values


def still() -> np.ndarray:
    values = rows(velocity=np.zeros((ROWS, 3)))
    values[:, 1:4] = [0.1, 0.2, 0.3] + 1e-4 * values[:, 1:4]
    return values


def damaged() -> np.ndarray:
    values = rows()
    values[100:200, 2] = np.nan
    return values


SLOW = rows(position=0.5 * np.sin(0.01 * np.arange(ROWS)[:, None] / RATE_HZ * [1, 1.7, 2.3]),
            velocity=np.zeros((ROWS, 3)))  # fmt: skip
REFUSED = [
    (rows()[:150], "has 150 rows over 1.49 s", "--design"),
    (SLOW, "too slow", "--design"),
    (still(), "too slow: base_yaw, shoulder, elbow", "both directions"),
    (rows(torque=np.zeros((ROWS, 3))), "column effort.base_yaw is always 0", "measured torques"),
    (backwards(), "line 702: time runs backwards", "must be later"),
    (rows(position=np.degrees(rows()[:, 1:4])), "looks like degrees", "--degrees"),
    (damaged(), "line 102: 100 of 1500 rows", "at most 1 %"),
    (rows(time=10.0 * np.arange(ROWS)[:, None]), "column time_s has a row every 10 s", "--unit"),
]


@pytest.mark.parametrize(("values", "begins", "allowed"), REFUSED)
def test_unusable_log_is_refused(values, begins, allowed, tmp_path):
    write(tmp_path / "log.csv", values)
    output = output_of("identify", tmp_path / "log.csv", "--robot", "paper_arm", "--out",
                        tmp_path / "found", code=2)  # fmt: skip
    assert str(tmp_path / "log.csv") in output
    assert begins in output
    assert allowed in output
    assert not (tmp_path / "found").exists()


def test_other_joints_are_named(tmp_path):
    write(tmp_path / "log.csv", rows(), ("a", "b", "c"))
    output = output_of("identify", tmp_path / "log.csv", "--robot", "paper_arm", code=2)
    assert "has no position of each of the 3 joints base_yaw, shoulder, elbow" in output
    assert "position.a" in output


def test_missing_column_of_one_joint_is_named(tmp_path):
    write(tmp_path / "log.csv", rows(), ("base_yaw", "shoulder", "knee"))
    code, output = here("identify", tmp_path / "log.csv", "--robot", "paper_arm")
    assert code == 2
    assert "position.elbow is missing" in output


def test_folder_without_a_recording_is_refused(tmp_path):
    code, output = here("identify", tmp_path, "--robot", "paper_arm")
    assert code == 2
    assert "0 MCAP or .db3 files" in output


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["log.csv"], "--robot must name"),
        (["--robot", "paper_arm"], "give one or more LOG files"),
        (["nowhere.csv", "--robot", "paper_arm"], "nowhere.csv cannot be read"),
        (["log.csv", "--robot", "panda_arm"], "did you mean panda"),
        (["log.csv", "--robot", "paper_arm", "--held-out", "1"], "between 0.05 and 0.9"),
        (["log.csv", "--robot", "paper_arm", "--torque", "effort.base_yam,b,c"],
         "column effort.base_yam is missing; did you mean effort.base_yaw?"),
        (["log.csv", "--robot", "paper_arm", "--current-constants", "1,2"], "3 positive numbers"),
        (["--robot", "paper_arm", "--design", "d.csv", "--duration", "2"], "between 10 and 600 s"),
        (["--robot", "paper_arm", "--design", "d.yaml"], "must end in .csv"),
        (["--robot", "paper_arm", "--design", "log.csv"], "log.csv exists"),
        (["--robot", "paper_arm", "--design", "none/d.csv"], "there is no folder"),
        (["log.csv", "--robot", "paper_arm", "--design", "d.csv"], "without LOG files"),
        (["log.csv", "--robot", "paper_arm", "--torque", "effort{}"], "may contain {n} or {joint}"),
        (["log.csv", "--robot", "paper_arm", "--torque", "a{n.x}"], "may contain {n} or {joint}"),
        (["log.csv", "--robot", "paper_arm", "--torque", "t,t,t"], "names a column twice"),
        (["log.csv", "--robot", "paper_arm", "--payload-kg", "2"], "be given with --payload"),
        (["log.csv", "--robot", "paper_arm", "--duration", "20"], "be given with --design"),
        (["log.csv", "--robot", "paper_arm", "--test", "log.csv", "--held-out", "0.5"],
         "given without --test"),
        (["log.csv", "--robot", "paper_arm", "--current-constants", "1,2,3"], "has torques"),
    ],
)  # fmt: skip
def test_unusable_words_are_refused(words, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "log.csv", rows())
    output = output_of("identify", *words, code=2)
    assert message in output


def test_files_of_the_user_are_not_replaced(tmp_path):
    write(tmp_path / "log.csv", rows())
    (tmp_path / "robot.urdf").write_text("mine")
    words = ["identify", tmp_path / "log.csv", "--robot", "paper_arm", "--out", tmp_path]
    for more in ([], ["--overwrite"]):
        output = output_of(*words, *more, code=2)
        assert "robot.urdf is there" in output
    assert (tmp_path / "robot.urdf").read_text() == "mine"


@pytest.mark.parametrize("first", [0, 1])
def test_columns_by_number_begin_at_the_first_that_is_there(first):
    """Also where a gripper adds one."""
    names = [f"effort_{number}" for number in range(first, first + 4)]
    found = _chosen("torque", "effort_{n}", names, NAMES)
    assert found == names[:3]


def test_missing_scipy_is_named_with_the_command_that_installs_it(tmp_path):
    write(tmp_path / "log.csv", rows())
    with mock.patch.dict(sys.modules, {"scipy.linalg": None, "scipy.optimize": None}):
        code, output = here("identify", tmp_path / "log.csv", "--robot", "paper_arm", "--out",
                            tmp_path / "found")  # fmt: skip
    assert code == 2
    assert "identify needs scipy: pip install 'funnel-hil[identify]'" in output


def test_degrees_are_converted_where_the_option_says_so(tmp_path):
    values = rows()
    write(tmp_path / "log.csv", values)
    words = ("identify", tmp_path / "log.csv", "--robot", ROBOTS / "paper_arm.urdf", "--out")
    own = here(*words, tmp_path / "a")
    assert "is this the robot of the log" in own[1]  # made up: no arm has these torques
    values[:, 1:7] = np.degrees(values[:, 1:7])
    write(tmp_path / "log.csv", values)
    converted = here(*words, tmp_path / "b", "--degrees")
    assert own[0] == converted[0] == 0
    assert own[1].split("results:")[0] == converted[1].split("results:")[0]


def test_stuck_joint_is_listed_as_not_seen(tmp_path):
    values = rows()
    values[:, 3], values[:, 6] = 0.2, 0.0
    write(tmp_path / "log.csv", values)
    output = output_of("identify", tmp_path / "log.csv", "--robot", "paper_arm", "--out",
                        tmp_path / "found")  # fmt: skip
    assert "all of elbow: move it faster" in output
    assert "the torques of elbow show no rotor" not in output  # nothing shows whether there is one


def test_lost_samples_of_exact_stamps_are_no_rounded_times(tmp_path):
    """Steps of one and two periods may be either; the motion tells which."""
    kept = np.random.default_rng(1).random(ROWS) > 0.2
    exact = rows()[kept]
    rounded = rows(time=0.7 * np.arange(ROWS)[:, None] / RATE_HZ)  # of a clock of 100 Hz
    rounded[:, 0] = np.floor(rounded[:, 0] * RATE_HZ) / RATE_HZ
    for values, smoothed in ((exact, False), (rounded, True)):
        write(tmp_path / "log.csv", values)
        log, notes = checked(read_robot_log(tmp_path / "log.csv", NAMES, {}), PAPER_ARM)
        assert any("were smoothed" in each for each in notes) == smoothed
        if not smoothed:
            np.testing.assert_array_equal(log.times_s, exact[:, 0])


def test_rows_after_a_pause_are_not_damaged_but_wild_stamps_are(tmp_path):
    # Ten minutes between two halves of 7.5 s; four stamps in a row that are an hour off.
    values = rows()
    values[750:, 0] += 600.0
    values[300:304, 0] += 3600.0
    write(tmp_path / "log.csv", values)
    log = read_robot_log(tmp_path / "log.csv", NAMES, {})
    kept, notes = checked(log, PAPER_ARM)
    assert kept.times_s.size == ROWS - 4
    assert kept.velocity is not None  # which are the positions' derivatives on both sides
    (note,) = notes
    assert note.startswith("4 damaged rows are left out")
