"""The arm of a run against pybullet's own Python functions."""

import ctypes
from pathlib import Path

import numpy as np
import pytest

from bus_schema.drive_feedback import no_drive_feedback
from bus_schema.errors import RobotDescriptionError
from bus_schema.limits import LimitsConfiguration
from bus_schema.robot_description import load_robot
from bus_schema.runtime.clock import TickGrid
from deploy.scenario.referenced_files import find_urdf
from plant_emulator.arm.bullet_arm import BulletArm
from plant_emulator.arm.bullet_server import require_loadable
from plant_emulator.arm.joint_torques import TOTAL, JointTorques, joint_torques
from plant_emulator.arm.pybullet_arm import PybulletArm
from plant_emulator.configuration import PlantConfiguration

GRID = TickGrid(1000.0, 4)
TICKS = 50
START = [0.3, -0.9, 1.2]
ARMS = ["paper_arm", "pybullet_data:kuka_iiwa/model.urdf", "pybullet_data:franka_panda/panda.urdf"]
PLANT = PlantConfiguration.model_validate(
    {
        "friction": {"coulomb_nm": 2.0, "viscous_nm_s": 3.0, "stribeck_nm": 1.0},
        "disturbance": {"terms": [
            {"joint": "all", "kind": "sine", "amplitude_nm": 5.0, "frequency_rad_s": 9.0}
        ]},
        "actuator": {"lag_ms": 1.0},
    }
)  # fmt: skip


def torques_of(robot):
    return JointTorques(
        PLANT,
        robot,
        GRID.substep_s,
        np.random.default_rng(0),
        LimitsConfiguration(),
        no_drive_feedback(robot.joints),
    )


def thrown(robot, payload_kg):
    """Positions and velocities after each tick of being thrown about, four substeps in one call."""
    torques, rows = torques_of(robot), []
    arm = BulletArm(robot, GRID, torques, payload_kg=payload_kg)
    arm.place(np.resize(START, robot.joints))
    for tick in range(TICKS):
        torques.asked[:] = pushes(robot, tick)
        arm.advance(4 * tick, 4 * tick + 4)
        rows.append(arm.motion.copy())
    arm.close()
    return np.array(rows)


def thrown_by_pybullet(robot, payload_kg):
    """The same, one substep and three calls of pybullet at a time."""
    torques, rows = torques_of(robot), []
    arm = PybulletArm(robot, GRID.substep_s, payload_kg=payload_kg)
    arm.place(np.resize(START, robot.joints))
    for tick in range(TICKS):
        torques.asked[:] = pushes(robot, tick)
        for number in range(4 * tick, 4 * tick + 4):
            motion = np.array([arm.position, arm.velocity])
            joint_torques(motion, GRID.substep_ns(number) * 1e-9, torques.tables)
            arm.step(torques.tables.torques_nm[TOTAL])
        rows.append(np.array([arm.position, arm.velocity]))
    arm.close()
    return np.array(rows)


def pushes(robot, tick):
    return (
        0.3
        * np.nan_to_num(robot.effort_limits_nm, posinf=100.0)
        * np.sin(0.1 * tick + np.arange(robot.joints))
    )


@pytest.mark.parametrize("payload_kg", [0.0, 2.0])
@pytest.mark.parametrize("name", ARMS)
def test_substeps_have_the_bits_that_pybullets_python_functions_give(name, payload_kg):
    robot = load_robot(find_urdf(name, Path()))
    motion = thrown(robot, payload_kg)
    assert np.abs(motion[-1, 1]).max() > 0.1
    assert motion.tobytes() == thrown_by_pybullet(robot, payload_kg).tobytes()


def test_several_arms_do_not_know_of_each_other():
    robot = load_robot(find_urdf("paper_arm", Path()))
    bystander = BulletArm(robot, GRID, torques_of(robot))
    bystander.place(np.array([0.1, 0.2, 0.3]))
    assert thrown(robot, 0.0).tobytes() == thrown(robot, 0.0).tobytes()
    assert bystander.position.tolist() == [0.1, 0.2, 0.3]
    bystander.close()


def test_urdf_that_bullet_cannot_load_is_named(tmp_path):
    robot = load_robot(find_urdf("paper_arm", Path()))
    object.__setattr__(robot, "path", tmp_path / "arm.urdf")
    object.__setattr__(robot, "resolved_urdf", lambda *_: "<robot/>")
    with pytest.raises(RobotDescriptionError, match=r"arm\.urdf: pybullet cannot load it"):
        BulletArm(robot, GRID, torques_of(robot))


def test_what_bullet_could_not_load_is_refused_every_time(tmp_path):
    robot, path = load_robot(find_urdf("paper_arm", Path())), tmp_path / "arm.urdf"
    require_loadable(path, robot.resolved_urdf())
    for _ in range(2):
        with pytest.raises(RobotDescriptionError, match="pybullet cannot load it"):
            require_loadable(path, "<robot/>")


def test_arms_say_nothing(capfd):
    """What pybullet's C code prints would stand in the middle of a command's output."""
    robot = load_robot(find_urdf("paper_arm", Path.cwd()))
    PybulletArm(robot, GRID.substep_s).close()
    BulletArm(robot, GRID, torques_of(robot)).close()
    ctypes.CDLL(None).fflush(None)
    assert capfd.readouterr() == ("", "")
