"""Logs of real robots, which lie beside the project: errors on data that were not fitted."""

import json
from pathlib import Path

import numpy as np
import pinocchio
import pytest

from bus_schema.robot_description import load_robot
from controller.manipulator_model import ManipulatorModel
from deploy.scenario.scenario import load_setup
from tests.arms import shipped_arm
from tests.warm_process import output_of

pytest.importorskip("scipy", reason="the extra identify is not installed")
SHARED = Path(__file__).parents[5] / "shared"
LOGS = SHARED / "logs"
UR10E = "ur10e_20_02_{}.csv.gz"


def expanded(maker: str, file: str, folder: Path, **arguments: str) -> Path:
    """Write the URDF of a maker's xacro file, without its meshes."""
    import xacro
    from xacro import substitution_args

    package = SHARED / "arms" / maker
    if not (package / file).is_file() or not LOGS.is_dir():
        pytest.skip(f"{package} or {LOGS} is not here")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(substitution_args, "_eval_find", lambda _: str(package))
        document = xacro.process_file(str(package / file), mappings=arguments)
    urdf = folder / "arm.urdf"
    urdf.write_text(document.toxml())
    return urdf


def ur(kind: str, folder: Path) -> Path:
    package = "04-ur/Universal_Robots_ROS2_Description"
    return expanded(package, "urdf/ur.urdf.xacro", folder, ur_type=kind, name="ur")


@pytest.mark.parametrize(("kind", "has_own_inertias"), [("ur10e", False), ("ur5e", True)])
def test_shipped_ur_has_the_links_that_its_maker_publishes(kind, has_own_inertias, tmp_path):
    """Torques of any motion, and where the flange is, depend on all lengths, masses and centres."""
    published = load_robot(ur(kind, tmp_path))
    models = [ManipulatorModel(robot) for robot in (published, shipped_arm(kind))]
    files = (published.path, shipped_arm(kind).path)
    poses = [pinocchio.buildModelFromUrdf(str(each)) for each in files]
    random = np.random.default_rng(1)
    for _ in range(20):
        q, v, a = random.uniform(-2.0, 2.0, (3, 6))
        if has_own_inertias:
            v = a = np.zeros(6)
        torques = [model.inverse_dynamics(q, v, a) for model in models]
        np.testing.assert_allclose(torques[1], torques[0], atol=1e-5)
        reach = [_flange(pose, q) for pose in poses]
        np.testing.assert_allclose(reach[1], reach[0], atol=1e-6)
    masses = [model.body_parameters()[-6:, 0] for model in models]
    np.testing.assert_allclose(masses[1], masses[0], rtol=1e-9)


def _flange(pose, q) -> np.ndarray:
    """Height of the tool's frame above the base, and its distance from the vertical axis."""
    data = pose.createData()
    pinocchio.framesForwardKinematics(pose, data, q)
    x, y, z = data.oMf[pose.getFrameId("tool0")].translation
    return np.array([z, np.hypot(x, y)])


def identified(folder: Path, *words: object) -> dict:
    output_of("identify", *words, "--out", folder / "found")
    return json.loads((folder / "found" / "summary.json").read_text())


def errors(summary: dict) -> np.ndarray:
    return np.array([joint["relative_error_held_out"] for joint in summary["joints"]])


def test_panda_is_predicted_on_the_second_half_of_its_log(tmp_path):
    arm = expanded("03-franka-fr3/franka_description", "robots/fr3/fr3.urdf.xacro", tmp_path,
                   hand="false")  # fmt: skip
    log = LOGS / "panda_exciting.csv.gz"
    summary = identified(tmp_path, log, "--robot", arm, "--held-out", 0.5)
    assert (errors(summary) <= [0.10] * 6 + [0.20]).all()
    assert any("link-side" in note for note in summary["notes"])
    published = [0.273, 0.436, 0.320, 0.640, 0.420, 0.152, 0.282]  # Gaz et al., another robot
    coulomb = np.array([joint["coulomb_nm"]["value"] for joint in summary["joints"]])
    assert (coulomb / published > 0.4).all()
    assert (coulomb / published < 1.2).all()


def test_shipped_panda_as_a_start_gives_the_same_errors(tmp_path):
    if not LOGS.is_dir():
        pytest.skip(f"{LOGS} is not here")
    log = LOGS / "panda_exciting.csv.gz"
    words = (log, "--robot", "panda", "--held-out", 0.5, "--link-side")
    assert (errors(identified(tmp_path, *words)) <= [0.10] * 6 + [0.20]).all()


def test_shipped_panda_without_its_hand_predicts_the_log_without_any_friction(tmp_path):
    log = LOGS / "panda_exciting.csv.gz"
    if not log.is_file():
        pytest.skip(f"{log} is not here")
    arm = tmp_path / "arm.urdf"
    head, _, _ = shipped_arm("panda").path.read_text().partition('<joint name="panda_hand_joint"')
    arm.write_text(head + "</robot>")
    summary = identified(tmp_path, log, "--robot", arm, "--held-out", 0.5, "--link-side")
    before = [joint["relative_error_before"] for joint in summary["joints"]]
    # Joint 7's torque is friction. With the inertials of pybullet_data: 0.61, 0.19, …, 1.0, 0.86.
    assert (np.array(before[:6]) <= [0.2, 0.03, 0.04, 0.05, 0.35, 0.25]).all()


def test_shipped_ur10e_is_predicted_on_another_day(tmp_path):
    fitted = [LOGS / UR10E.format(each) for each in ("10-30sec_12harm", "12-50sec_12harm")]
    if not fitted[0].is_file():
        pytest.skip(f"{LOGS} is not here")
    words = (*fitted, "--test", LOGS / UR10E.format("19_15harm50sec"), "--robot", "ur10e")
    summary = identified(tmp_path, *words)
    assert (errors(summary) <= [0.10, 0.06, 0.06, 0.12, 0.22, 0.20]).all()
    drives = load_setup("ur10e_motors").scenario.plant
    viscous = [joint["viscous_nm_s"]["value"] for joint in summary["joints"]]
    np.testing.assert_allclose(drives.friction.viscous_nm_s, viscous, rtol=0.02)


def test_ur10_bag_is_predicted_on_its_second_half(tmp_path):
    log = LOGS / "ur10_exciting_trajectory.db3"
    summary = identified(tmp_path, log, "--robot", ur("ur10", tmp_path), "--held-out", 0.5)
    assert (errors(summary) <= [0.16, 0.05, 0.07, 0.09, 0.10, 0.35]).all()


def test_ur10e_is_predicted_on_another_day_and_its_payload_is_found(tmp_path):
    fitted = [LOGS / UR10E.format(each) for each in ("10-30sec_12harm", "12-50sec_12harm")]
    tested, loaded = (LOGS / UR10E.format(f"19_15harm50sec{each}") for each in ("", "Load"))
    arm = ur("ur10e", tmp_path)
    words = (*fitted, "--test", tested, "--robot", arm)
    summary = identified(tmp_path, *words, "--payload", loaded, "--payload-kg", 2.805)
    assert (errors(summary) <= [0.10, 0.06, 0.06, 0.12, 0.22, 0.20]).all()
    assert summary["payload"]["kg"] == pytest.approx(2.805, rel=0.12)
    rotors = [joint["rotor_inertia_kg_m2"]["value"] for joint in summary["joints"]]
    assert rotors == pytest.approx([5.1, 5.7, 1.1, 0.40, 0.40, 0.42], rel=0.7)
    by_weight = [joint["nm_per_a"]["value"] for joint in summary["joints"]]
    assert all(9.0 < each < 12.5 for each in by_weight)
    assert by_weight[4:] == [by_weight[3]] * 2  # their own weight does not show theirs
    by_payload = np.array(summary["payload"]["nm_per_a_by_payload"])
    assert by_payload[4:] == pytest.approx(by_payload[3], rel=0.02)  # a known mass does
    apart = by_payload / by_weight - 1.0
    assert (np.abs(apart) < 0.25).all()
    assert any("by the payload" in note for note in summary["notes"])


def test_a_log_with_payload_among_others_is_refused_by_name(tmp_path):
    fitted, loaded = (LOGS / UR10E.format(f"19_15harm50sec{each}") for each in ("", "Load"))
    arm = ur("ur10e", tmp_path)
    words = ("identify", fitted, loaded, "--robot", arm, "--out", tmp_path / "found")
    output = output_of(*words, code=2)
    assert f"{loaded.name}: carries about" in output
