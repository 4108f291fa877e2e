import numpy as np
import pytest

from bus_schema.runtime.clock import TickGrid
from bus_schema.runtime.modes import Mode
from controller.manipulator_model import ManipulatorModel
from plant_emulator.arm_plant import ArmPlant
from plant_emulator.configuration import PlantConfiguration
from tests.arms import PAPER_ARM, forward_dynamics, shipped_arm

GRID = TickGrid(1000.0, 4)
SUBSTEP_S = GRID.substep_s
START = np.array([0.3, -0.9, 1.2])
PUSH = np.array([60.0, -250.0, -20.0])
ROBOT = PAPER_ARM


pytestmark = pytest.mark.usefixtures("engine")


class Bench:
    """An arm that is stepped through time."""

    def __init__(self, robot=ROBOT, start=START, seed=1, **plant):
        configuration = PlantConfiguration.model_validate(plant)
        self.arm = ArmPlant(configuration, robot, start, GRID, seed)
        self.arm.begin()
        self.steps = 0

    def run(self, duration_s):
        """Advance; positions and velocities after each substep."""
        rows = []
        for _ in range(round(duration_s / SUBSTEP_S)):
            self.arm.advance(self.steps, self.steps + 1)
            self.steps += 1
            rows.append((self.arm.position.copy(), self.arm.velocity.copy()))
        positions, velocities = zip(*rows, strict=True)
        return np.array(positions), np.array(velocities)


@pytest.fixture
def bench(made_and_freed):
    return made_and_freed(Bench)


@pytest.mark.parametrize("payload_kg", [0.0, 5.0])
@pytest.mark.parametrize("name", ["paper_arm", "iiwa"])
def test_brakes_hold_under_gravity(bench, name, payload_kg):
    robot = shipped_arm(name)
    start = np.resize(START, robot.joints)
    held = bench(robot=robot, start=start, payload_kg=payload_kg)
    positions, _ = held.run(1.0)
    assert held.arm.mode is Mode.READY
    # A velocity motor under load creeps by the order of a substep of free fall per second, 0.3
    # mrad; released, the arm would fall by more than 100 mrad in the first 0.2 s.
    assert np.abs(positions - start).max() < 1e-3


def test_braked_arm_feels_neither_disturbance_nor_friction(bench):
    terms = [{"joint": "all", "kind": "constant", "torque_nm": 100.0}]
    held = bench(disturbance={"terms": terms}, friction={"viscous_nm_s": 10.0})
    positions, _ = held.run(0.2)
    assert np.abs(positions - START).max() < 1e-3
    torques = held.arm.torques
    assert not np.any([torques.actuator, torques.friction, torques.disturbance])


def test_first_command_releases_the_brakes(bench):
    released = bench()
    released.run(0.01)
    released.arm.command(np.zeros(3))
    assert released.arm.mode is Mode.TRACKING
    model = ManipulatorModel(ROBOT)
    fall = forward_dynamics(model, released.arm.position, np.zeros(3), np.zeros(3))
    _, velocities = released.run(4 * SUBSTEP_S)
    # After 1 ms of falling from rest: v = a t, but for the 0.3 mrad/s at which the brakes creep.
    np.testing.assert_allclose(velocities[-1], fall * 1e-3, atol=5e-4, rtol=0.01)
    assert np.abs(fall).max() > 5.0


def test_commanded_torque_stays_in_force_until_the_next(bench):
    moving = bench()
    moving.arm.command(PUSH)
    moving.run(0.02)
    assert moving.arm.torques.actuator.tolist() == PUSH.tolist()
    moving.arm.command(-PUSH)
    moving.run(SUBSTEP_S)
    assert moving.arm.torques.actuator.tolist() == (-PUSH).tolist()


def moving_arm(bench, **plant):
    moving = bench(**plant)
    moving.arm.command(PUSH)
    _, velocities = moving.run(0.15)
    assert (np.abs(velocities[-1]) > 0.3).all()
    return moving, velocities[-1]


def test_brake_stop_stands_still_within_milliseconds_and_holds(bench):
    stopped, _ = moving_arm(bench, safe_stop="brake")
    stopped.arm.stop()
    assert stopped.arm.mode is Mode.STOPPING
    positions, velocities = stopped.run(0.5)
    # Ten times the torque limits against 2.4 rad/s of the elbow's 1.5 kg m²: about 2 ms.
    after = round(0.005 / SUBSTEP_S)
    assert np.abs(velocities[after:]).max() < 1e-3
    assert np.abs(positions[-1] - positions[after]).max() < 1e-3
    assert not stopped.arm.torques.actuator.any()


def test_damping_stop_takes_energy_out_with_its_own_torque_alone(bench):
    stopped, _ = moving_arm(bench, safe_stop="damping", stop_damping_nm_s=[30.0, 60.0, 15.0])
    model = ManipulatorModel(ROBOT)
    stopped.arm.stop()
    before = stopped.arm.velocity.copy()
    stopped.run(SUBSTEP_S)
    np.testing.assert_allclose(stopped.arm.torques.actuator, [-30, -60, -15] * before, rtol=1e-12)
    energies = []
    for _ in range(20):
        positions, velocities = stopped.run(0.01)
        energies.append(model.energy(positions[-1], velocities[-1]))
    assert (np.diff(energies) < 0.0).all()
    assert energies[0] - energies[-1] > 5.0


def test_zero_torque_stop_falls_freely(bench):
    stopped, _ = moving_arm(bench, safe_stop="zero_torque")
    model = ManipulatorModel(ROBOT)
    stopped.arm.stop()
    energy = model.energy(stopped.arm.position, stopped.arm.velocity)
    positions, velocities = stopped.run(0.2)
    assert not stopped.arm.torques.actuator.any()
    # Conserved to the order of the substep (see test_physics), out of 30 J of motion.
    assert model.energy(positions[-1], velocities[-1]) == pytest.approx(energy, abs=0.2)
    assert np.abs(velocities[-1] - velocities[0]).max() > 1.0


@pytest.mark.parametrize("kind", ["brake", "damping", "zero_torque"])
def test_there_is_no_way_back_from_a_stop(bench, kind):
    stopped, _ = moving_arm(bench, safe_stop=kind)
    stopped.arm.stop()
    stopped.run(0.01)
    stopped.arm.command(np.array([123.0, 123.0, 123.0]))
    assert stopped.arm.mode is Mode.STOPPING
    stopped.run(SUBSTEP_S)
    assert 123.0 not in stopped.arm.torques.actuator


@pytest.mark.parametrize("kind", ["brake", "damping", "zero_torque"])
def test_brakes_that_were_never_released_hold_through_a_stop(bench, kind):
    held = bench(safe_stop=kind)
    held.run(0.01)
    held.arm.stop()
    positions, _ = held.run(0.2)
    assert np.abs(positions - START).max() < 1e-3


@pytest.mark.parametrize("kind", ["damping", "zero_torque"])
def test_brake_ends_everything(bench, kind):
    stopped, _ = moving_arm(bench, safe_stop=kind)
    stopped.arm.stop()
    stopped.run(0.01)
    stopped.arm.end()
    assert stopped.arm.mode is Mode.FAULT
    stopped.arm.command(PUSH)
    assert stopped.arm.mode is Mode.FAULT
    positions, _ = stopped.run(0.2)
    assert np.abs(positions[-1] - positions[len(positions) // 2]).max() < 1e-3


def test_same_seed_same_bits_other_seed_other_noise(bench):
    noise = {"joint": "all", "kind": "noise", "rms_nm": 20.0, "lowest_hz": 1.0, "highest_hz": 50.0}
    runs = []
    for seed in (1, 1, 2):
        shaken = bench(
            seed=seed, disturbance={"terms": [noise]}, encoder={"velocity_noise_rad_s": 0.1}
        )
        shaken.arm.command(np.zeros(3))
        positions, _ = shaken.run(0.1)
        shaken.arm.read_encoders()
        runs.append((positions.tobytes(), shaken.arm.measured[1].tobytes()))
    assert runs[0] == runs[1]
    assert runs[0][0] != runs[2][0]
    assert runs[0][1] != runs[2][1]


def test_held_joints_stay_where_they_are_and_feel_nothing_while_others_move(bench):
    terms = [{"joint": "all", "kind": "constant", "torque_nm": 50.0}]
    some = bench(disturbance={"terms": terms})
    some.arm.hold(np.array([True, False, True]))
    some.arm.command(PUSH)
    positions, _ = some.run(0.2)
    moved = np.abs(positions[-1] - START)
    assert moved[1] > 0.05
    assert moved[[0, 2]].max() < 2e-3
    assert some.arm.torques.actuator.tolist() == [0.0, PUSH[1], 0.0]
    some.arm.hold(np.array([False, False, False]))
    positions, _ = some.run(0.2)
    assert np.abs(positions[-1] - positions[0])[0] > 0.005
