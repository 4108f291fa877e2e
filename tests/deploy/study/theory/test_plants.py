"""What the linear plant has of a scenario's arm: gravity, payload, rotors, loops of drives."""

from __future__ import annotations

import pytest
import yaml

from deploy.scenario.scenario import load_setup
from deploy.study.theory.theory import theory_of
from tests.deploy.own_laws import own_law
from tests.deploy.study.linear_loops import rigid
from tests.deploy.study.theory.linear_arms import ARMS, constant, is_kept

MASS_KG, LENGTH_M, INERTIA, GRAVITY = 4.0, 0.5, 0.3, 9.81
TIP_M = 0.8
PENDULUM = f"""<robot name="pendulum"><link name="base"/><joint name="hinge" type="continuous">
<parent link="base"/><child link="rod"/><axis xyz="0 1 0"/><limit effort="1e6" velocity="1e3"/>
</joint><link name="rod"><inertial><origin xyz="0 0 {LENGTH_M}"/><mass value="{MASS_KG}"/>
<inertia ixx="{INERTIA}" iyy="{INERTIA}" izz="{INERTIA}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="end" type="fixed"><parent link="rod"/><child link="tip"/><origin xyz="0 0 {TIP_M}"/>
</joint><link name="tip"/></robot>"""
UPRIGHT, HANGING = 0.0, 3.141592653589793
P, D = 900.0, 60.0


def pendulum(folder, position, overrides=()):
    """What theory says about a pendulum at rest, under PD with the law of a scenario."""
    (folder / "pendulum.urdf").write_text(PENDULUM)
    gains = {"proportional": [P], "integral": [0.0], "derivative": [D]}
    values = {
        "name": "pendulum", "duration_s": 1.0, "rate_hz": 500.0,
        "robot": {"urdf": "pendulum.urdf", "initial_offset_rad": 0.0},
        "reference": {"kind": "minimum_jerk", "waypoints": [
            {"time_s": at_s, "position_rad": [position]} for at_s in (0.0, 1.0)]},
        "controller": {"law": "pid", "gains": {"pid": gains, "pid_gravity": gains}},
    }  # fmt: skip
    file = folder / "pendulum.yaml"
    file.write_text(yaml.safe_dump(values))
    return theory_of(load_setup(str(file), list(overrides)))["constant_ms"]


def exact_ms(proportional=P, added=0.0, weight=0.0, sign=1.0):
    """Of a pendulum with a spring of its weight; with more inertia and weight."""
    inertia = INERTIA + MASS_KG * LENGTH_M**2 + added
    weight = sign * (MASS_KG * GRAVITY * LENGTH_M + weight)
    loop = rigid([[inertia]], [proportional], [D], [0.0], 2e-3, stiffness=weight)
    return 1e3 * loop.exact_margin_s()


@pytest.mark.parametrize(("position", "sign"), [(UPRIGHT, -1.0), (HANGING, 1.0)])
def test_gravity_is_a_spring(position, sign, tmp_path):
    assert pendulum(tmp_path, position) == pytest.approx(exact_ms(sign=sign), abs=0.02)


def test_a_law_that_compensates_gravity_does_so_after_the_delay(tmp_path):
    weight = MASS_KG * GRAVITY * LENGTH_M  # upright, G(q) = −weight · q
    exact = exact_ms(P + weight, sign=-1.0)
    found = pendulum(tmp_path, UPRIGHT, ["controller.law=pid_gravity"])
    assert found == pytest.approx(exact, abs=0.02)


def test_rotors_count_and_the_nominal_model_does_not(tmp_path):
    overrides = ["plant.actuator.rotor_inertia_kg_m2=0.7"]
    exact = exact_ms(added=0.7, sign=-1.0)
    for more in ([], ["controller.model_scale=0.5", "controller.rotor_scale=2"]):
        assert pendulum(tmp_path, UPRIGHT, overrides + more) == pytest.approx(exact, abs=0.02)


def test_a_payload_at_the_tip_counts(tmp_path):
    found = pendulum(tmp_path, UPRIGHT, ["plant.payload_kg=2"])
    exact = exact_ms(added=2.0 * TIP_M**2, weight=2.0 * TIP_M * GRAVITY, sign=-1.0)
    assert found == pytest.approx(exact, abs=0.02)


DRIVES = "controller.drive_feedback.enabled=true"


def test_loops_of_drives_count(tmp_path):
    file = ARMS["PD"].write(tmp_path)
    stiffness, damping = 2000.0, 150.0
    gains = f"plant.drive_feedback={{stiffness_nm_rad: {stiffness}, damping_nm_s: {damping}}}"
    loop = rigid([[2.5]], [16000.0], [400.0], [0.0], 1e-3, viscous=damping, stiffness=stiffness)
    exact = 1e3 * loop.exact_margin_s()
    found = theory_of(load_setup(str(file), [DRIVES, gains]))
    assert found["constant_ms"] == pytest.approx(exact, abs=0.02)
    largest = 0.5 * (exact // 0.5)
    assert is_kept(file, [DRIVES, gains, *constant(largest)])
    assert not is_kept(file, [DRIVES, gains, *constant(largest + 0.5)])
    # Drives that could close a loop, but get no targets, follow torques alone.
    alone = theory_of(load_setup(str(file), ["plant.drive_feedback.enabled=true", gains]))
    assert alone == theory_of(load_setup(str(file)))


NO_COMPENSATION = ["controller.delay_compensation.enabled=false"]
POSTURE = [0.1, -0.5, 0.3, 1.2, 0.2, -0.6, 0.0]
WITHOUT_FRICTION = [
    f"reference={{kind: minimum_jerk, waypoints: [{{time_s: 0, position_rad: {POSTURE}}},"
    f" {{time_s: 1, position_rad: {POSTURE}}}]}}",
    "robot.initial_offset_rad=0.005", "duration_s=6", "controller.model_scale=1",
    "funnel={final_rad: 0.3, convergence_margin_rad: 0.4, overshoot_margin_rad: 0.4}",
    *NO_COMPENSATION,
    "plant={friction: {enabled: false}, physics: {engine: mujoco, integrator: runge_kutta_4}}",
]  # fmt: skip


def test_computed_torque_on_a_real_arm_agrees_with_its_theory(import_folder):
    wanted = "tracking.reference_acceleration - 4000 * tracking.error - 130 * tracking.error_rate"
    does = f"return self.model.inverse_dynamics(tracking.position, tracking.velocity, {wanted})"
    overrides = [*WITHOUT_FRICTION, f"controller.law={own_law(import_folder, does, 'torques')}"]
    exact = 1e3 * rigid([[1.0]], [4000.0], [130.0], [0.0], 1e-3).exact_margin_s()  # of each joint
    # But for gravity, which the law compensates a delay later.
    assert theory_of(load_setup("iiwa", overrides))["constant_ms"] == pytest.approx(exact, abs=0.1)
    assert 9.5 < exact < 10.0
    assert is_kept("iiwa", [*overrides, *constant(9.5)])
    assert not is_kept("iiwa", [*overrides, *constant(10.0)])


def test_coupling_of_joints_counts():
    overrides = [*WITHOUT_FRICTION, "controller.law=pid"]
    # With the diagonal of the mass matrix alone, the figure would be 32 ms.
    assert 15.0 < theory_of(load_setup("iiwa", overrides))["constant_ms"] < 17.0
    assert is_kept("iiwa", [*overrides, *constant(15.0)])
    assert not is_kept("iiwa", [*overrides, *constant(17.0)])
