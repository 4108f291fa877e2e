"""Virtual robots with known parameters are identified; formats, intervals, files."""

import gzip
import json
import re
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest
import yaml
from mcap.writer import Writer
from pyarrow import csv, parquet

from bus_schema.errors import InputError
from bus_schema.messages.types import JOINT_STATE, TYPESTORE, schema_text
from bus_schema.robot_description import load_robot
from controller.manipulator_model import ManipulatorModel
from deploy.measure.identify.base_parameters import grouping
from deploy.measure.identify.identification import Wishes, _without_rotor, identify
from deploy.measure.identify.regression import COULOMB, ROTOR, STRIBECK, TERMS
from deploy.measure.identify.robot_log import read_robot_log
from deploy.scenario.referenced_files import ROBOTS
from deploy.scenario.scenario import load_setup
from tests.arms import PAPER_ARM
from tests.deploy.measure.identify.virtual_logs import (
    excitation,
    intervals,
    to_currents,
    truth_of,
    write_log,
)
from tests.warm_process import here, output_of

pytest.importorskip("scipy", reason="the extra identify is not installed")
NAME, SHORT_S = "paper_arm", 25.0


@pytest.fixture(scope="module")
def virtual(tmp_path_factory):
    """A log of a virtual robot, and the truth."""
    random = np.random.default_rng(4)
    robot, model, *_ = excitation(NAME, SHORT_S)
    truth = truth_of(robot, model, random)
    file = tmp_path_factory.mktemp("logs") / "log.csv"
    write_log(file, NAME, truth, random)
    return file, truth


@pytest.mark.parametrize(
    ("arm", "correlations_s", "noise", "draws"),
    [
        (NAME, [0.0], 0.01, 2),
        (NAME, [0.1, 10.0], 0.01, 2),
        (NAME, [1.0, 10.0], 0.05, 2),
        ("ur5e", [1.0], 0.01, 1),
    ],
)
def test_intervals_hold_the_truth_and_are_not_too_wide(arm, correlations_s, noise, draws, tmp_path):
    """Noise of torques is white or correlated; scripts.experiments.identify_coverage has more."""
    robot, model, *_ = excitation(arm, SHORT_S)
    values = []
    for correlation_s in correlations_s:
        for seed in range(draws):
            random = np.random.default_rng(seed)
            truth = truth_of(robot, model, random)
            write_log(tmp_path / "log.csv", arm, truth, random, SHORT_S, noise, correlation_s)
            found = identify([tmp_path / "log.csv"], [], None, robot, Wishes())
            values += [each for each in intervals(found, truth) if each[1].half > 0.0]
    off = np.array([abs(value.value - true) / value.half for _, value, true in values])
    inside = off <= 1.0
    seen = np.array([value.seen for _, value, _ in values])
    assert seen.sum() > 15 * draws
    assert inside[seen].mean() > 0.88
    assert inside.mean() > 0.88  # masses of links among them, seen or not
    assert np.median(off[seen]) > 0.2  # 0.34 if errors are normal; intervals twice as wide: 0.17


def test_all_formats_give_the_same_arm(virtual, tmp_path):
    file, _ = virtual
    table = csv.read_csv(file)
    packed, columns = tmp_path / "log.csv.gz", tmp_path / "log.parquet"
    packed.write_bytes(gzip.compress(file.read_bytes()))
    parquet.write_table(_as_lists(table), columns)
    bag = tmp_path / "log.mcap"
    _write_bag(bag, table)
    robot = excitation(NAME, SHORT_S)[0]
    own = identify([file], [], None, robot, Wishes()).fit.terms
    for other in (packed, columns, bag, _as_rosbag2(bag, tmp_path / "bag")):
        found = identify([other], [], None, robot, Wishes()).fit.terms
        assert found == pytest.approx(own, rel=1e-3, abs=1e-4)


def test_own_run_is_read_from_its_folder(tmp_path):
    folder = tmp_path / "run"
    assert here("simulate", NAME, "--set", "duration_s=0.2", "--out", folder)[0] == 0
    own, bag = (read_robot_log(each, PAPER_ARM.joint_names, {})
                for each in (folder, folder / "run.mcap"))  # fmt: skip
    assert len(own.times_s) == 200
    np.testing.assert_array_equal(own.torque, bag.torque)


def test_log_with_a_payload_among_others_is_refused(tmp_path):
    random = np.random.default_rng(3)
    robot, model, *_ = excitation("ur5e", SHORT_S)
    truth = truth_of(robot, model, random)
    write_log(tmp_path / "log.csv", "ur5e", truth, random)
    truth.bodies[-10:] += 2.0 * np.array([1, 0, 0, 0.1, 0.02, 0, 0.02, 0, 0, 0.01])
    write_log(tmp_path / "loaded.csv", "ur5e", truth, random)
    with pytest.raises(
        InputError, match=r"loaded.csv: carries about (1\.[6-9]|2\.?[0-4]?) kg more"
    ):
        identify([tmp_path / "log.csv", tmp_path / "loaded.csv"], [], None, robot, Wishes())


@pytest.mark.parametrize("stribeck", [0.0, 0.6])
def test_stribeck_friction_is_found_where_there_is_some(stribeck, virtual, tmp_path):
    table = csv.read_csv(virtual[0])
    column, speed = table.column_names[-1], table["velocity.elbow"].to_numpy()
    more = stribeck * np.tanh(speed / 0.02) * np.exp(-((speed / 0.1) ** 2))
    table = table.set_column(9, column, pa.array(table[column].to_numpy() + more))
    csv.write_csv(table, tmp_path / "log.csv")
    found = identify([tmp_path / "log.csv"], [], None, excitation(NAME, SHORT_S)[0], Wishes())
    assert found.fit.has_term[2, STRIBECK] == bool(stribeck)
    assert found.fit.terms[2, STRIBECK] == pytest.approx(stribeck, rel=0.4, abs=0.0)


@pytest.mark.parametrize(
    ("rotors", "deviations", "none"),
    [
        ([0.0, 0.5, 0.1], [0.01, 0.1, 0.01], [False, False, False]),  # the elbow shows its own
        ([0.0, 0.5, 0.0], [0.01, 0.1, 0.01], [True, True, True]),  # torques beyond the gears
        ([0.0, 0.5, 0.0], [0.01, 0.1, 0.9], [False, False, False]),  # the elbow hardly moves
    ],
)
def test_a_rotor_that_no_motion_tells_from_its_link_is_judged_by_the_others(
    rotors, deviations, none
):
    model = ManipulatorModel(load_robot(ROBOTS / "paper_arm.urdf"))
    group = grouping(model)
    assert group.of_rotor.any(axis=1).tolist() == [True, True, False]
    terms, sd = np.ones((2, 3, len(TERMS)))
    terms[:, ROTOR], sd[:, ROTOR] = rotors, deviations
    prior = SimpleNamespace(terms_sd=np.ones((3, len(TERMS))))
    fitted = SimpleNamespace(terms=terms, terms_sd=sd, has_term=terms > -1.0, prior=prior)
    assert _without_rotor(fitted, group).tolist() == none


def test_episodes_of_one_table_are_motions_of_their_own(virtual, tmp_path):
    """Time restarts with each; the arm jumps in between; one is too short."""
    file, _ = virtual
    table = csv.read_csv(file)
    cuts, parts = (slice(0, 900), slice(905, 1000), slice(1100, 2200), slice(2300, 3100)), []
    for number, rows in enumerate(cuts):
        each = table.slice(rows.start, rows.stop - rows.start)
        start_s = each["time_s"][0].as_py()
        each = each.set_column(0, "time_s", pa.array(each["time_s"].to_numpy() - start_s))
        csv.write_csv(each, tmp_path / f"{number}.csv")
        episode = pa.array([number] * len(each))
        parts.append(_as_lists(each).append_column("episode_index", episode))
    together = tmp_path / "file-000.parquet"
    parquet.write_table(pa.concat_tables(parts), together)
    robot = excitation(NAME, SHORT_S)[0]
    apart = [tmp_path / f"{number}.csv" for number in (0, 2, 3)]
    own = identify(apart, [], None, robot, Wishes())
    found = identify([together], [], None, robot, Wishes())
    np.testing.assert_allclose(found.fit.terms, own.fit.terms, rtol=1e-9, atol=1e-12)
    assert "file-000.parquet: 1 of 4 episodes are too short, and left out" in found.notes
    with pytest.raises(InputError, match="must have one motion, has several episodes"):
        identify(apart, [], together, robot, Wishes())


def test_damage_in_an_episode_is_named_by_its_row_in_the_file(virtual, tmp_path):
    table = _as_lists(csv.read_csv(virtual[0]))
    table = table.append_column("episode_index", pa.array((np.arange(len(table)) > 1499) * 1))
    times_s = table["timestamp"].to_numpy().copy()
    times_s[1600] = times_s[1598]
    table = table.set_column(0, "timestamp", pa.array(times_s))
    parquet.write_table(table, tmp_path / "log.parquet")
    with pytest.raises(InputError, match=r"log.parquet, row 1601: time runs backwards"):
        identify([tmp_path / "log.parquet"], [], None, excitation(NAME, SHORT_S)[0], Wishes())


def _as_lists(table: pa.Table) -> pa.Table:
    """As LeRobot writes it: a list per kind."""
    names = {"position": "observation.state", "velocity": "observation.velocity",
             "effort": "observation.effort"}  # fmt: skip
    lists = {"timestamp": table["time_s"]}
    for kind, name in names.items():
        own = [c for c in table.column_names if c.startswith(f"{kind}.")]
        rows = np.column_stack([table[c].to_numpy() for c in own])
        lists[name] = pa.array(rows.tolist(), pa.list_(pa.float64()))
    return pa.table(lists)


def _as_rosbag2(file, folder):
    """The same messages as a bag's folder."""
    from mcap.reader import make_reader
    from rosbags.rosbag2 import Writer as BagWriter

    with file.open("rb") as stream, BagWriter(folder, version=9) as writer:
        connection = writer.add_connection("/joint_states", JOINT_STATE, typestore=TYPESTORE)
        for _, _, message in make_reader(stream).iter_messages():
            writer.write(connection, message.log_time, message.data)
    return folder


def _write_bag(file, table: pa.Table) -> None:
    """JointState whose order of joints changes from message to message."""
    joints = [c.removeprefix("position.") for c in table.column_names if c.startswith("position.")]
    values = {c: table[c].to_numpy() for c in table.column_names}
    header, stamp = (TYPESTORE.types[f"{t}"] for t in ("std_msgs/msg/Header",
                                                      "builtin_interfaces/msg/Time"))  # fmt: skip
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        schema = writer.register_schema(JOINT_STATE, "ros2msg", schema_text(JOINT_STATE).encode())
        channel = writer.register_channel("/joint_states", "cdr", schema)
        for row, time_s in enumerate(values["time_s"]):
            names = joints if row % 2 else joints[::-1]
            kinds = [np.array([values[f"{kind}.{name}"][row] for name in names])
                     for kind in ("position", "velocity", "effort")]  # fmt: skip
            sec, ns = divmod(round(1e9 * time_s), 1_000_000_000)
            message = TYPESTORE.types[JOINT_STATE](header(stamp(sec, ns), ""), names, *kinds)
            data = TYPESTORE.serialize_cdr(message, JOINT_STATE)
            writer.add_message(channel, round(1e9 * time_s), bytes(data), round(1e9 * time_s))
        writer.finish()


def test_results_are_files_that_other_commands_take(virtual, tmp_path):
    file, truth = virtual
    folder = tmp_path / "found"
    output_of("identify", file, "--robot", NAME, "--out", folder)
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["kind"] == "identify"
    assert all(0.0 < j["relative_error_held_out"] < 0.05 for j in summary["joints"])
    assert all(j["relative_error_held_out"] < j["relative_error_before"] for j in summary["joints"])
    setup = load_setup(str(folder / "scenario.yaml"), ["duration_s=0.1"])
    coulomb = setup.scenario.plant.friction.coulomb_nm
    assert coulomb == pytest.approx(truth.coulomb, rel=0.1)
    model = ManipulatorModel(load_robot(folder / "robot.urdf"))
    group = grouping(model)
    written = group.matrix @ model.body_parameters().ravel()
    assert written == pytest.approx([e["value"] for e in summary["base_parameters"]], abs=1e-6)
    output_of("simulate", folder / "scenario.yaml", "--set", "duration_s=0.1", "--out",
                        tmp_path / "run")  # fmt: skip
    short = ("--plants", 2, "--values", 4, "--duration", 0.2, "--laws", "pid", "--workers", 1)
    output_of(
        "margin", folder / "scenario.yaml", "--uncertainty", folder / "uncertainty.yaml", *short,
        "--out", tmp_path / "margin",
    )  # fmt: skip
    assert "Measured and predicted torque" in (folder / "report.html").read_text()
    code, output = here("identify", file, "--robot", NAME, "--out", folder)
    assert (code, "holds results" in output) == (2, True)
    assert here("identify", file, "--robot", NAME, "--out", folder, "--overwrite")[0] == 0


def test_drawn_plants_keep_values_of_one_draw_together(virtual, tmp_path):
    folder = tmp_path / "found"
    assert here("identify", virtual[0], "--robot", NAME, "--out", folder)[0] == 0
    ranges = yaml.safe_load((folder / "uncertainty.yaml").read_text())
    from pydantic import TypeAdapter

    from deploy.scenario.uncertainty import Uncertainty, draw_plant
    from deploy.scenario.yaml_files import plain

    draws = TypeAdapter(Uncertainty).validate_python(ranges)
    setup = load_setup(str(folder / "scenario.yaml"))
    for number in range(1, 6):
        plant = draw_plant(draws, plain(setup.scenario), 3, seed=1, number=number)
        rows = {key: each["rows"] for key, each in ranges.items()}
        drawn = {key: np.atleast_1d(value).tolist() for key, value in plant.values.items()}
        place = rows["plant.friction.coulomb_nm"].index(drawn["plant.friction.coulomb_nm"])
        assert drawn == {key: each[place] for key, each in rows.items()}


def test_currents_need_the_weight_and_find_a_payload(tmp_path):
    random = np.random.default_rng(2)
    robot, model, *_ = excitation("ur5e", SHORT_S)
    truth = truth_of(robot, model, random)
    truth.bodies[:] = model.body_parameters().ravel()  # its weight is the scale
    write_log(tmp_path / "log.csv", "ur5e", truth, random)
    constants = np.array([11.0, 12.0, 9.0, 10.0, 10.5, 10.0])
    to_currents(tmp_path / "log.csv", constants)
    found = identify([tmp_path / "log.csv"], [], None, robot, Wishes())
    assert (found.constants.tool, found.constants.fits) == (None, True)
    sure = np.isfinite(found.constants.half)
    assert sure.sum() >= 3
    assert found.constants.nm_per_a[sure] == pytest.approx(constants[sure], rel=0.05)
    truth.bodies[-10:] += 2.0 * np.array([1, 0, 0, 0.1, 0.02, 0, 0.02, 0, 0, 0.01])
    write_log(tmp_path / "loaded.csv", "ur5e", truth, random)
    to_currents(tmp_path / "loaded.csv", constants)
    wishes = Wishes(payload_kg=2.0, constants=constants)
    found = identify([tmp_path / "log.csv"], [], tmp_path / "loaded.csv", robot, wishes)
    assert found.payload.kg[0] == pytest.approx(2.0, rel=0.1)


def test_dead_time_from_command_to_position_becomes_a_delay_of_the_link(virtual, tmp_path):
    head, *rows = virtual[0].read_text().splitlines()
    values = np.array([list(map(float, row.split(","))) for row in rows])
    late = [np.interp(values[:, 0] + 0.03, values[:, 0], column) for column in values[:, 1:4].T]
    names = ",".join(f"target_q_{n}" for n in range(3))
    file, folder = tmp_path / "log.csv", tmp_path / "found"
    values = np.column_stack([values, *late])
    np.savetxt(file, values, "%.9g", ",", header=f"{head},{names}", comments="")
    output_of("identify", file, "--robot", NAME, "--out", folder)
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["dead_time_ms"]["value"] == pytest.approx(30.0, abs=2.0)
    link = load_setup(str(folder / "scenario.yaml")).scenario.link
    assert link.downlink.delay_ms == pytest.approx(30.0, abs=2.0)
    code, output = here("report", folder)
    assert (code, "report.html shows them" in output) == (2, True)


def test_rounded_and_lost_samples_and_spikes_change_little(virtual, tmp_path):
    file, truth = virtual
    head, *rows = file.read_text().splitlines()
    random = np.random.default_rng(1)
    values = np.array([list(map(float, row.split(","))) for row in rows])
    values[random.integers(0, len(values), 15), -1] += 500.0  # spikes of a sensor
    values = np.delete(values, random.integers(500, len(values), 120), axis=0)  # lost ones
    values = np.delete(values, slice(1000, 1100), axis=0)  # a gap
    np.savetxt(tmp_path / "log.csv", values, "%.9g", ",", header=head, comments="")
    found = identify([tmp_path / "log.csv"], [], None, excitation(NAME, SHORT_S)[0], Wishes())
    assert found.fit.terms[:, COULOMB] == pytest.approx(truth.coulomb, rel=0.15)
    assert any("gaps are left out" in note for note in found.notes)


def test_an_arm_is_read_with_the_options_of_robot(tmp_path):
    """Joints to drive, packages to look in, and a mass as `robot` takes them."""
    file = tmp_path / "arm.urdf"
    text = (ROBOTS / "paper_arm.urdf").read_text()
    file.write_text(re.sub(r"<inertial>.*?</inertial>", "", text, flags=re.DOTALL))
    design_file = tmp_path / "d.csv"
    words = ("identify", "--robot", file, "--design", design_file, "--duration", 12)
    output_of(*words, "--joints", "base_yaw,shoulder", "--mass", 20, "--include", tmp_path)
    header = design_file.read_text().partition("\n")[0]
    assert "shoulder" in header
    assert "elbow" not in header
    output = output_of(*words, "--joints", "shoulder,hip", code=2)
    assert "hip" in output


def test_designed_trajectory_is_a_reference_and_a_joint_trajectory(tmp_path):
    file = tmp_path / "excite.csv"
    output = output_of("identify", "--robot", NAME, "--design", file, "--duration", 12)
    assert "condition number" in output
    trajectory = yaml.safe_load(file.with_suffix(".yaml").read_text())
    robot = load_robot(load_setup(NAME).robot.path)
    assert trajectory["joint_names"] == list(robot.joint_names)
    first, last = trajectory["points"][0], trajectory["points"][-1]
    assert np.abs([first["velocities"], last["velocities"]]).max() < 0.01
    assert last["time_from_start"]["sec"] >= 11
    position = np.array([each["positions"] for each in trajectory["points"]])
    assert (position > robot.lower_rad).all()
    assert (position < robot.upper_rad).all()
    words = ["reference.kind=csv", f"reference.file={file}", "duration_s=12",
             "robot.initial_offset_rad=0"]  # fmt: skip
    values = {"extends": NAME, "name": "excited", "reference": {"kind": "csv", "file": str(file)}}
    (tmp_path / "excited.yaml").write_text(yaml.safe_dump(values))
    load_setup(str(tmp_path / "excited.yaml"), words[2:])
