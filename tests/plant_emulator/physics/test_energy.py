"""Undamped joints keep their energy, rigid and elastic, on every engine by every integrator.

Bounds are those of the schemes. Semi-implicit Euler is symplectic: it conserves an energy that
differs from the true one by h/2 times the power of the forces, plus O(h²). For an oscillator of
angular frequency ω, its amplitude stays within the factor (1 + hω/2) / (1 - hω/2), and that of
leapfrog within 1 / (1 - (hω/2)²); both oscillate at Ω with sin(Ωh/2) = ωh/2. After Hairer, Lubich,
Wanner, "Geometric Numerical Integration", sections I.1.4 and IX.3.
"""

import math
from contextlib import closing

import numpy as np
import pytest

from bus_schema.robot_description import load_robot
from controller.manipulator_model import ManipulatorModel
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.physics.engines import ENGINES
from tests.arms import INSTALLED, PAPER_ARM, FreeArm
from tests.one_joint import write_arm

STEP_S, DURATION_S = 2.5e-4, 10.0
LINK_KG_M2, ROTOR_KG_M2 = 1.0, 0.5
ROUNDING = 1e-9
"""Far above what rounding adds up to in 40,000 steps, far below what is looked for."""

every_physics = pytest.mark.parametrize(
    ("engine", "integrator"),
    [(name, rule) for name in INSTALLED for rule in ENGINES[name].integrators],
)
every_integrator = pytest.mark.parametrize("integrator", ENGINES["mujoco"].integrators)


@pytest.fixture
def one_joint(tmp_path):
    """Return a function that makes an arm of one joint on some physics; it is closed at the end."""

    def made(engine, integrator, *, axis="0 0 1", lever_m=0.0, **actuator):
        arm = load_robot(write_arm(tmp_path, LINK_KG_M2, axis=axis, lever_m=lever_m))
        plant = PlantConfiguration.model_validate(
            {"actuator": actuator, "physics": {"engine": engine, "integrator": integrator}}
        )
        return closing(
            FreeArm(
                arm, engine, STEP_S, plant, integrator=integrator,
                rotor_inertia_kg_m2=plant.actuator.rigid_rotor_inertia(1),
            )
        )  # fmt: skip

    return made


def motion_of(free, start_rad, rotor_rad=None):
    """Position and velocity of link and rotor after each step, shape (steps, 4)."""
    free.place(np.array([start_rad]))
    rotors = free.arm._torques.tables.trains.rotors
    if rotor_rad is not None:
        rotors[0] = rotor_rad
    rows = []
    for _ in range(round(DURATION_S / STEP_S)):
        free.push(np.zeros(1))
        rows.append([*free.arm.motion[:, 0], *rotors[:, 0]])
    return np.array(rows)


def allowed_ratio(integrator, rad_s):
    """Largest over smallest energy of an oscillator by the closed form of a scheme."""
    half = 0.5 * STEP_S * rad_s
    return (1 + half) / (1 - half) if integrator == "semi_implicit_euler" else 1 / (1 - half**2)


@every_physics
def test_free_joint_keeps_its_speed(engine, integrator, one_joint):
    with one_joint(engine, integrator) as free:
        free.place(np.zeros(1))
        free.push(np.array([2.0]), 400)
        before = free.velocity[0]
        free.push(np.zeros(1), round(DURATION_S / STEP_S))
        assert before == pytest.approx(2.0 * 400 * STEP_S / LINK_KG_M2)
        assert free.velocity[0] == pytest.approx(before, rel=ROUNDING)


@every_physics
def test_pendulum_keeps_its_energy(engine, integrator, one_joint):
    lever_m, weight = 0.5, 9.81  # N: a mass of 1 kg
    with one_joint(engine, integrator, axis="0 1 0", lever_m=lever_m) as free:
        q, rate, *_ = motion_of(free, 0.3).T
    energy_j = 0.5 * LINK_KG_M2 * rate**2 - weight * lever_m * np.sin(q)
    power_w = np.abs(weight * lever_m * np.cos(q) * rate).max()
    held_j = power_w * 0.5 * STEP_S if integrator == "semi_implicit_euler" else ROUNDING
    assert np.ptp(q) > 2.0
    assert np.abs(energy_j + weight * lever_m * math.sin(0.3)).max() < 1.01 * held_j


@pytest.mark.parametrize("resonance_hz", [15.0, 40.0, 120.0])
@every_integrator
def test_elastic_joint_keeps_its_amplitude_and_frequency(integrator, resonance_hz, one_joint):
    rad_s = 2.0 * math.pi * resonance_hz
    stiffness = rad_s**2 / (1 / LINK_KG_M2 + 1 / ROTOR_KG_M2)
    gear = {"rotor_inertia_kg_m2": ROTOR_KG_M2, "gear_stiffness_nm_rad": stiffness}
    with one_joint("mujoco", integrator, **gear) as free:
        q, rate, rotor, rotor_rate = motion_of(free, 0.0, 0.01).T
    kinetic_j = 0.5 * (LINK_KG_M2 * rate**2 + ROTOR_KG_M2 * rotor_rate**2)
    energy_j = kinetic_j + 0.5 * stiffness * (rotor - q) ** 2
    assert energy_j.max() / energy_j.min() <= allowed_ratio(integrator, rad_s) + ROUNDING
    assert np.abs(LINK_KG_M2 * rate + ROTOR_KG_M2 * rotor_rate).max() < ROUNDING  # momentum
    twist = rotor - q
    rising = np.flatnonzero((twist[:-1] < 0.0) & (twist[1:] >= 0.0))
    crossings = rising - twist[rising] / (twist[rising + 1] - twist[rising])
    found_rad_s = 2.0 * math.pi * (len(crossings) - 1) / np.ptp(crossings) / STEP_S
    assert found_rad_s == pytest.approx(2.0 / STEP_S * math.asin(0.5 * STEP_S * rad_s), rel=1e-6)


@every_integrator
def test_damped_gear_decays_as_two_masses_do(integrator, one_joint):
    """The twist decays at half its damping over the reduced inertia."""
    rad_s, ratio = 2.0 * math.pi * 40.0, 0.01
    reduced_kg_m2 = 1.0 / (1 / LINK_KG_M2 + 1 / ROTOR_KG_M2)
    gear = {
        "rotor_inertia_kg_m2": ROTOR_KG_M2,
        "gear_stiffness_nm_rad": rad_s**2 * reduced_kg_m2,
        "gear_damping_nm_s": 2.0 * ratio * rad_s * reduced_kg_m2,
    }
    with one_joint("mujoco", integrator, **gear) as free:
        q, _, rotor, _ = motion_of(free, 0.0, 0.01).T
    twists, times_s = np.abs(rotor - q)[:8000], STEP_S * np.arange(1, 8001)
    peaks = np.flatnonzero((twists[1:-1] > twists[:-2]) & (twists[1:-1] > twists[2:])) + 1
    decay, _ = np.polyfit(times_s[peaks], np.log(twists[peaks]), 1)
    assert decay == pytest.approx(-ratio * rad_s, rel=STEP_S * rad_s)


@every_integrator
def test_joint_in_a_cogging_well_keeps_its_energy(integrator, one_joint):
    depth_nm, periods, inertia = 20.0, 50.0, LINK_KG_M2 + ROTOR_KG_M2
    cogging = {"cogging_nm": depth_nm, "cogging_periods": periods}
    with one_joint("mujoco", integrator, rotor_inertia_kg_m2=ROTOR_KG_M2, **cogging) as free:
        q, rate, *_ = motion_of(free, 0.01).T
    well_j = depth_nm / periods * (1.0 - np.cos(periods * q))
    energy_j = 0.5 * inertia * rate**2 + well_j
    steepest_rad_s = math.sqrt(depth_nm * periods / inertia)
    assert energy_j.max() / energy_j.min() <= allowed_ratio(integrator, steepest_rad_s) + ROUNDING


def test_falling_elastic_arm_keeps_its_energy_to_second_order_by_runge_kutta():
    """Its mass matrix varies, and the largest change of energy is a quarter at half the step."""
    rotors, stiffness, model = (
        np.array([3.0, 5.0, 1.0]), np.array([2e4, 2e4, 1e4]), ManipulatorModel(PAPER_ARM),
    )  # fmt: skip

    def largest_change_j(step_s):
        plant = PlantConfiguration.model_validate(
            {"actuator": {"rotor_inertia_kg_m2": rotors.tolist(),
                          "gear_stiffness_nm_rad": stiffness.tolist()},
             "physics": {"integrator": "runge_kutta_4"}}
        )  # fmt: skip
        arm = FreeArm(PAPER_ARM, "mujoco", step_s, plant, integrator="runge_kutta_4")
        with closing(arm) as free:
            free.place(np.array([0.3, -0.9, 1.2]))
            motors = free.arm._torques.tables.trains.rotors
            motors[1, 0] = 1.0
            energies_j = []
            for _ in range(round(3.0 / step_s)):
                twists = motors[0] - free.position
                of_gears_j = 0.5 * (rotors * motors[1] ** 2 + stiffness * twists**2).sum()
                energies_j.append(model.energy(free.position, free.velocity) + of_gears_j)
                free.push(np.zeros(3))
        return float(np.ptp(energies_j))

    changes_j = [largest_change_j(step_s) for step_s in (1e-3, 5e-4, 2.5e-4)]
    assert changes_j[0] / changes_j[1] == pytest.approx(4.0, rel=0.2)
    assert changes_j[1] / changes_j[2] == pytest.approx(4.0, rel=0.2)
