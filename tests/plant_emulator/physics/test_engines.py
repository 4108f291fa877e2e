"""What holds for every physics engine, and that they agree."""

import ctypes
from contextlib import closing

import numpy as np
import pytest

from bus_schema.configuration import ConfigurationError
from bus_schema.errors import RobotDescriptionError
from bus_schema.robot_description import load_robot
from controller.manipulator_model import ManipulatorModel
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.physics import mujoco_arm
from plant_emulator.physics.engines import ENGINES, engine_in_force, engine_name
from tests.arms import ARMS, INSTALLED, PAPER_ARM, FreeArm, shipped_arm

TICKS = 50
START = [0.3, -0.9, 1.2]
TWICE = '<robot name="a"><link name="a"/><link name="a"/></robot>'
PLANT = PlantConfiguration.model_validate(
    {
        "friction": {"coulomb_nm": 2.0, "viscous_nm_s": 3.0, "stribeck_nm": 1.0},
        "disturbance": {"terms": [
            {"joint": "all", "kind": "sine", "amplitude_nm": 5.0, "frequency_rad_s": 9.0}
        ]},
        "actuator": {"lag_ms": 1.0},
    }
)  # fmt: skip
every_engine = pytest.mark.parametrize("engine", INSTALLED)


def thrown(robot, engine, payload_kg=0.0):
    """Positions and velocities after each tick of four substeps of being thrown about."""
    with closing(FreeArm(robot, engine, 2.5e-4, PLANT, payload_kg=payload_kg)) as free:
        start = np.clip(np.resize(START, robot.joints), robot.lower_rad + 1, robot.upper_rad - 1)
        free.place(start)
        rows = []
        for tick in range(TICKS):
            wave = np.sin(0.1 * tick + np.arange(robot.joints))
            free.push(0.3 * np.nan_to_num(robot.effort_limits_nm, posinf=100.0) * wave, 4)
            rows.append(free.arm.motion.copy())
    return np.array(rows)


@pytest.mark.parametrize("payload_kg", [0.0, 2.0])
@pytest.mark.parametrize("name", ARMS)
def test_engines_move_an_arm_alike(name, payload_kg):
    robot = shipped_arm(name)
    reference, *others = (thrown(robot, engine, payload_kg) for engine in INSTALLED)
    assert np.abs(reference[-1, 1]).max() > 0.1
    # Both are semi-implicit Euler's: what differs is rounding that grows, most for a wrist of
    # 0.002 kg m² without its rotor.
    tolerance = 1e-4 if name == "panda" else 1e-6
    for other in others:
        np.testing.assert_allclose(other, reference, rtol=0, atol=tolerance)


@every_engine
def test_several_arms_do_not_know_of_each_other(engine):
    robot = PAPER_ARM
    with closing(FreeArm(robot, engine)) as bystander:
        bystander.place(np.array([0.1, 0.2, 0.3]))
        assert thrown(robot, engine).tobytes() == thrown(robot, engine).tobytes()
        assert bystander.position.tolist() == [0.1, 0.2, 0.3]


@every_engine
def test_brake_of_a_moving_joint_passes_its_momentum_on(engine):
    """What the free joints gain is M_ff⁻¹ M_fh q̇_h: the brake acts on its own joint alone."""
    robot = PAPER_ARM
    with closing(FreeArm(robot, engine, 1e-4)) as free:
        free.place(np.array(START))
        free.push(np.zeros(3), substeps=2000)
        position, velocity = free.position.copy(), free.velocity.copy()
        mass = ManipulatorModel(robot).mass_matrix(position)
        others = np.ix_([0, 2], [0, 2])
        gained = np.linalg.solve(mass[others], mass[[0, 2], 1] * velocity[1])
        assert np.abs(gained).max() > 0.5
        free.arm.hold([False, True, False])
        free.push(np.zeros(3), substeps=60)  # in which Bullet's brake stops it
        assert free.velocity[1] == pytest.approx(0.0, abs=1e-3)
        np.testing.assert_allclose(free.velocity[[0, 2]], velocity[[0, 2]] + gained, atol=0.15)


@every_engine
def test_urdf_that_an_engine_cannot_load_is_named(engine, tmp_path):
    robot, kind = shipped_arm("paper_arm"), ENGINES[engine].arm_type
    kind.check(robot, 0.0, gui=False)
    object.__setattr__(robot, "path", tmp_path / "arm.urdf")
    object.__setattr__(robot, "resolved_urdf", lambda *_: TWICE)
    for _ in range(2):
        with pytest.raises(RobotDescriptionError, match=r"arm\.urdf: "):
            kind.check(robot, 0.0, gui=False)


@every_engine
def test_engine_prints_nothing(engine, capfd):
    """What its C code prints would stand in the middle of a command's output."""
    FreeArm(PAPER_ARM, engine).close()
    ctypes.CDLL(None).fflush(None)
    assert capfd.readouterr() == ("", "")


@every_engine
def test_links_may_have_any_name(engine, tmp_path):
    text = PAPER_ARM.path.read_text()
    for old, new in (("upper_arm", "world"), ("forearm", "a/b c")):
        text = text.replace(f'"{old}"', f'"{new}"')
    (tmp_path / "arm.urdf").write_text(text)
    renamed = load_robot(tmp_path / "arm.urdf")
    assert thrown(renamed, engine).tobytes() == thrown(PAPER_ARM, engine).tobytes()


def test_mujoco_that_shows_no_addresses_gives_the_same_bits(monkeypatch):
    expected = thrown(PAPER_ARM, "mujoco")
    monkeypatch.setattr(mujoco_arm, "step", None)
    assert thrown(PAPER_ARM, "mujoco").tobytes() == expected.tobytes()


def test_diverging_arm_writes_no_log_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with closing(FreeArm(PAPER_ARM, "mujoco")) as free:
        free.place(np.full(3, 1e300))
        free.push(np.zeros(3), substeps=3)
    assert not list(tmp_path.iterdir())


def plant(**physics):
    return PlantConfiguration.model_validate({"physics": physics})


def test_bullet_is_the_default_where_it_is_installed(monkeypatch):
    monkeypatch.setattr(type(ENGINES["bullet"]), "is_installed", True)
    assert engine_name(plant()) == "bullet"
    monkeypatch.setattr(type(ENGINES["bullet"]), "is_installed", False)
    assert engine_name(plant()) == "mujoco"
    with pytest.raises(
        ConfigurationError, match=r"'bullet': Bullet is not installed \(pip install"
    ):
        engine_in_force(plant(engine="bullet"))


def test_mujoco_has_no_window():
    with pytest.raises(ConfigurationError, match=r"plant\.gui = True: MuJoCo has no window"):
        engine_in_force(
            PlantConfiguration.model_validate({"gui": True, "physics": {"engine": "mujoco"}})
        )
