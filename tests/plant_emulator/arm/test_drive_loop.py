"""The loop that drives close themselves: what it adds to torques, and when it adds nothing."""

import numpy as np
import pytest

from bus_schema.drive_feedback import DriveGains
from bus_schema.limits import Hit
from bus_schema.runtime.clock import TickGrid
from controller.manipulator_model import ManipulatorModel
from plant_emulator.arm.joint_torques import ACTUATOR, WANTED, joint_torques
from plant_emulator.arm_plant import ArmPlant
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.faults.kinds import parse_fault
from tests.arms import PAPER_ARM, torques_of

GRID = TickGrid(1000.0, 4)
SUBSTEP_NS = 250_000
ROBOT = PAPER_ARM
LIMITS = ROBOT.effort_limits_nm
START = np.array([0.3, -0.9, 1.2])
GAINS = DriveGains(True, np.array([900.0, 1600.0, 200.0]), np.array([60.0, 80.0, 10.0]))
FEED_FORWARD = np.array([20.0, -150.0, -10.0])
TARGET = np.array([START + np.array([0.02, -0.01, 0.03]), [0.5, -0.4, 0.3]])
STAMP_NS = 3_000_000


def drives_of(encoder):
    configuration = PlantConfiguration.model_validate({"drive_feedback": {"encoder": encoder}})
    return torques_of(configuration, seed=4, gains=GAINS)


def aim(torques, target=TARGET, stamp_ns=STAMP_NS):
    torques.asked[:] = FEED_FORWARD
    torques.drive.target[:] = target
    torques.drive.stamp_s[0] = stamp_ns * 1e-9


def expected_sum(position, velocity, age_s, target=TARGET, gains=GAINS):
    away = target[0] + target[1] * age_s - position
    return (
        FEED_FORWARD
        + gains.stiffness_nm_rad * away
        + gains.damping_nm_s * (target[1] - velocity)
    )  # fmt: skip


@pytest.mark.parametrize("resolution_rad", [0.0, 1e-3])
def test_torque_of_a_substep_is_that_of_a_spring_on_the_way(resolution_rad):
    torques = drives_of({"resolution_rad": resolution_rad})
    aim(torques)
    for number in range(12, 40):
        time_s = number * GRID.substep_s
        motion = np.array([START + 0.0123 * np.sin(number), 0.2 * np.cos([number] * 3)])
        joint_torques(motion, time_s, torques.tables)
        seen = motion[0]
        if resolution_rad:
            seen = np.round(motion[0] / 1e-3) * 1e-3
            assert 0.0 < np.abs(seen - motion[0]).max() <= 0.5e-3 + 1e-12
        wanted = expected_sum(seen, motion[1], time_s - 0.003)
        np.testing.assert_allclose(torques.tables.torques_nm[WANTED], wanted, rtol=1e-12)
        np.testing.assert_array_equal(torques.actuator, torques.tables.torques_nm[WANTED])


def test_velocity_is_seen_with_fresh_noise_at_every_substep():
    torques = drives_of({"velocity_noise_rad_s": 0.05})
    motion = np.array([START, np.zeros(3)])
    aim(torques)
    quiet = expected_sum(START, np.zeros(3), -0.003)
    seen = np.empty((2000, 3))
    for row in seen:
        joint_torques(motion, 0.0, torques.tables)
        row[:] = (torques.tables.torques_nm[WANTED] - quiet) / -GAINS.damping_nm_s
    # 2000 draws: a standard deviation to 1.6 %, a mean to 1.1e-3, a correlation to 0.022
    np.testing.assert_allclose(seen.std(axis=0), 0.05, rtol=0.06)
    assert np.abs(seen.mean(axis=0)).max() < 4e-3
    assert np.abs(np.corrcoef(seen[:-1, 0], seen[1:, 0])[0, 1]) < 0.08


def test_the_sum_is_kept_within_the_torque_limits():
    torques = drives_of({})
    aim(torques, np.array([START + np.array([10.0, -10.0, 10.0]), np.zeros(3)]))
    saturated, hits = joint_torques(np.array([START, np.zeros(3)]), 0.003, torques.tables)
    np.testing.assert_array_equal(torques.tables.torques_nm[ACTUATOR], LIMITS * [1, -1, 1])
    assert saturated
    assert hits & Hit.TORQUE
    aim(torques)
    saturated, hits = joint_torques(np.array([START, np.zeros(3)]), 0.003, torques.tables)
    assert not saturated
    assert not hits


class Bench:
    """An arm that is stepped through time from a first command at `STAMP_NS` on."""

    def __init__(self, drive=GAINS, faults=(), **plant):
        faults = [parse_fault(values) for values in faults]
        configuration = PlantConfiguration.model_validate(plant)
        self.arm = ArmPlant(configuration, ROBOT, START, GRID, 1, faults=faults, drive=drive)
        self.arm.begin()
        self.number = STAMP_NS // SUBSTEP_NS

    def run(self, substeps):
        """Motion before each substep, and what the actuators delivered in it."""
        motions, torques = [], []
        for _ in range(substeps):
            motions.append(self.arm.motion.copy())
            self.arm.advance(self.number, self.number + 1)
            self.number += 1
            torques.append(self.arm.torques.actuator.copy())
        return np.array(motions), np.array(torques)


@pytest.fixture
def bench(engine, made_and_freed):
    return made_and_freed(Bench)


def test_target_moves_on_between_commands(bench):
    moving = bench()
    moving.arm.command(FEED_FORWARD, TARGET, STAMP_NS)
    motions, torques = moving.run(80)
    wanted = [
        expected_sum(*motion, k * GRID.substep_s) for k, motion in enumerate(motions)
    ]  # fmt: skip
    np.testing.assert_allclose(torques, wanted, rtol=1e-9)
    # Had the target stood still, 20 ms at 0.5 rad/s of 900 N m/rad would be missing in the end.
    held = expected_sum(*motions[-1], 0.0)
    assert torques[-1][0] - held[0] == pytest.approx(900.0 * 0.5 * 0.01975, rel=1e-6)


def test_drives_in_one_call_of_many_substeps_are_those_of_one_at_a_time(bench):
    noisy = {"drive_feedback": {"encoder": {"velocity_noise_rad_s": 0.05}}}
    single, whole = bench(**noisy), bench(**noisy)
    for each in (single, whole):
        each.arm.command(FEED_FORWARD, TARGET, STAMP_NS)
    single.run(40)
    for first in range(12, 52, 4):
        whole.arm.advance(first, first + 4)
    assert single.arm.motion.tobytes() == whole.arm.motion.tobytes()


def test_a_command_without_a_target_ends_the_chase_of_the_last_one(bench):
    moving = bench()
    moving.arm.command(FEED_FORWARD, TARGET, STAMP_NS)
    _, torques = moving.run(4)
    assert (torques != FEED_FORWARD).all()
    moving.arm.command(FEED_FORWARD, None, STAMP_NS + 1_000_000)
    _, torques = moving.run(4)
    np.testing.assert_array_equal(torques, np.tile(FEED_FORWARD, (4, 1)))


@pytest.mark.parametrize("kind", ["brake", "damping", "zero_torque"])
def test_no_target_is_chased_after_a_safe_stop(bench, kind):
    stopped = bench(safe_stop=kind, stop_damping_nm_s=[30.0, 60.0, 15.0])
    stopped.arm.command(FEED_FORWARD, TARGET + 1.0, STAMP_NS)
    stopped.run(40)
    stopped.arm.stop()
    motions, torques = stopped.run(40)
    damping = {"damping": np.array([30.0, 60.0, 15.0])}.get(kind, np.zeros(3))
    np.testing.assert_allclose(torques, -damping * motions[:, 1], rtol=1e-12)
    stopped.arm.command(FEED_FORWARD, TARGET + 1.0, STAMP_NS + 30_000_000)  # nor a later one
    motions, torques = stopped.run(4)
    np.testing.assert_allclose(torques, -damping * motions[:, 1], rtol=1e-12)
    stopped.arm.end()
    _, torques = stopped.run(4)
    assert not torques.any()


def test_a_dead_actuator_does_not_follow_its_drive_either(bench):
    fault = {"kind": "actuator_dead", "joint": "shoulder", "at_s": 0.008}
    broken, sound = bench(faults=[fault]), bench()
    for each in (broken, sound):
        each.arm.command(FEED_FORWARD, TARGET, STAMP_NS)
    before = [each.run(20) for each in (broken, sound)]
    np.testing.assert_array_equal(before[0][1], before[1][1])
    motions, torques = broken.run(20)
    assert not torques[:, 1].any()
    wanted = np.array([
        expected_sum(*motion, 0.005 + k * GRID.substep_s) for k, motion in enumerate(motions)
    ])  # fmt: skip
    np.testing.assert_allclose(torques[:, [0, 2]], wanted[:, [0, 2]], rtol=1e-9)


def test_a_braked_joint_feels_no_drive(bench):
    some = bench()
    some.arm.hold(np.array([True, False, False]))
    some.arm.command(ManipulatorModel(ROBOT).gravity(START), TARGET + 0.1, STAMP_NS)
    _, torques = some.run(40)
    assert not torques[:, 0].any()
    assert torques[:, 1:].all()
