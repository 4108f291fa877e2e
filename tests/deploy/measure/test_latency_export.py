"""What `latency` exports is read by the programs that it is for, and means the same there."""

from __future__ import annotations

import math
import os
import re
import subprocess
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from deploy.measure.latency import Latency
from deploy.measure.latency_export import Export, exported
from deploy.scenario.scenario import load_setup
from tests.joint_states import joint_state, write_bag

FOUND = Latency(
    (0.0203, 0.0004), (0.0301, 0.0007), (0.0504, 0.0005), (1.0, 0.01), explained=0.99, misfit=None
)
MODEL = """<mujoco><option timestep="{step_s}" gravity="0 0 0"/><include file="latency.xml"/>
<worldbody><body><joint name="slide" type="slide"/><geom size="0.1" mass="1e6"/></body></worldbody>
<actuator><{actuator} class="measured_latency" joint="slide"/></actuator></mujoco>"""


@pytest.mark.parametrize("step_s", [0.0005, 0.001, 0.005])
@pytest.mark.parametrize("actuator", ["position", "general"])
def test_mujoco_has_the_dead_time_and_the_lag(tmp_path: Path, step_s: float, actuator: str) -> None:
    (tmp_path / "latency.xml").write_text(exported(FOUND, Export.MUJOCO, "log.csv"))
    (tmp_path / "model.xml").write_text(MODEL.format(step_s=step_s, actuator=actuator))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    data = mujoco.MjData(model)
    data.ctrl[:] = 1.0
    forces = []
    for _ in range(round(0.3 / step_s)):
        mujoco.mj_step(model, data)
        forces.append(float(data.actuator_force[0]))
    forces_n = np.array(forces) / forces[-1]
    starts_s = step_s * np.argmax(forces_n > 1e-9)
    assert starts_s == pytest.approx(0.0203, abs=2.1 * step_s)
    reaches_s = step_s * np.argmax(forces_n > 1.0 - math.exp(-1.0))
    assert reaches_s == pytest.approx(0.0203 + 0.0301, abs=2.1 * step_s)
    for name, ends in (("delay", (0.0199, 0.0207)), ("timeconst", (0.0294, 0.0308))):
        assert model.numeric(f"measured_{name}_s").data == pytest.approx(ends)


def test_mujoco_without_lag_has_no_filter(tmp_path: Path) -> None:
    found = Latency(
        (0.02, 0.001), (0.0, 0.0005), (0.02, 0.001), (1.0, 0.1), explained=0.9, misfit=None
    )
    (tmp_path / "latency.xml").write_text(exported(found, Export.MUJOCO, "--> x.csv"))
    (tmp_path / "model.xml").write_text(MODEL.format(step_s=0.001, actuator="position"))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    assert model.actuator_dyntype[0] == mujoco.mjtDyn.mjDYN_NONE


def test_scenario_has_the_dead_time_and_the_lag(tmp_path: Path, funnel_hil) -> None:
    """An exported scenario runs, and `latency` finds the same in its recording."""
    text = exported(FOUND, Export.SCENARIO, "log.csv")
    file = tmp_path / "arm.yaml"
    file.write_text(f"extends: paper_arm\nduration_s: 3\n{text}")
    setup = load_setup(str(file))
    assert setup.scenario.link.downlink.delay_ms == 20.3
    assert setup.scenario.plant.actuator.lag_ms == 30.1
    draws = setup.scenario.uncertainty
    assert (draws["link.downlink.delay_ms"].least, draws["link.downlink.delay_ms"].most) == (
        19.9,
        20.7,
    )
    assert (draws["plant.actuator.lag_ms"].least, draws["plant.actuator.lag_ms"].most) == (
        29.4,
        30.8,
    )
    funnel_hil.output("simulate", file, "--out", tmp_path / "run")
    output = funnel_hil.output(
        "latency", tmp_path / "run" / "run.mcap", "--command", "/joint_commands.effort[0]",
        "--response", "/plant_truth.torque[0]", "--longest", "100",
    )  # fmt: skip
    values = dict(line.split(": ", 1) for line in output.splitlines() if ": " in line)
    assert float(values["dead time"].split()[0]) == pytest.approx(20.3, abs=1.0)
    assert float(values["lag"].split()[0]) == pytest.approx(30.1, rel=0.05)


def test_scenario_has_the_response_of_a_robot_that_takes_positions(
    tmp_path: Path, funnel_hil
) -> None:
    """A log of 4 + 30 ms, from steps in an exact cascade of two lags of 15 ms."""
    random, rows, cycle_s, share = np.random.default_rng(3), 2000, 2e-3, -np.expm1(-1.0 / 150.0)
    wanted = np.repeat(0.008 * random.standard_normal(rows // 20), 20)
    held = np.repeat(np.concatenate([np.full(2, wanted[0]), wanted]), 20)  # in steps of 0.1 ms
    first = second = wanted[0]
    found = []
    for step in range(rows * 20):
        if step % 20 == 0:
            found.append(second)
        # Of the first lag's line e^(−t/T), the second takes t/T e^(−t/T).
        away = first - held[step]
        second += share * (held[step] - second) + away * (1.0 - share) / 150.0
        first += share * (held[step] - first)
    log = tmp_path / "log.csv"
    lines = (
        f"{cycle_s * k:.3f},{u:.9f},{q:.9f}"
        for k, (u, q) in enumerate(zip(wanted, found, strict=True))
    )
    log.write_text("\n".join(["time_s,target,position", *lines]))
    out = tmp_path / "robot.yaml"
    words = ("latency", log, "--command", "target", "--response", "position", "--longest", "100")
    assert "of second order" in funnel_hil.output(*words, "--export", "scenario", "--out", out)
    file = tmp_path / "arm.yaml"
    file.write_text(f"extends: paper_arm\ncontroller: {{law: streaming}}\n{out.read_text()}")
    interface = load_setup(str(file)).scenario.plant.interface
    assert interface.kind == "servoj"
    assert interface.servoj.dead_time_ms == pytest.approx(4.0, abs=0.2)
    assert interface.servoj.lag_ms == pytest.approx(30.0, abs=0.3)
    robot = interface.servoj.build(cycle_s)
    robot.start(wanted[:1])
    moved = [robot.step(np.array([[each], [0.0]]), np.zeros((2, 1)))[0][0] for each in wanted]
    assert np.abs(np.array(moved) - found).max() < 1e-3


@pytest.mark.parametrize(
    ("step_s", "with_lag", "steps"),
    [(0.005, False, (3, 5)), (0.001, False, (19, 21)), (0.0001, False, (199, 207)),
     (0.005, True, (9, 11)), (0.0001, True, (493, 515))],
)  # fmt: skip
@pytest.mark.parametrize("export", [Export.ISAACLAB, Export.MJLAB])
def test_steps_of_a_delay_hold_its_interval(export, step_s, with_lag, steps) -> None:
    module: dict[str, object] = {}
    exec(exported(FOUND, export, '"""log.csv'), module)
    found = list(module["delay"](step_s, with_lag=with_lag).values())
    assert tuple(found[:2]) == steps


LOADERS = {
    Export.ISAACLAB: (
        "ISAACLAB_PYTHON",
        "cfg = actuator(0.005, joint_names_expr=['.*'], stiffness=10.0, damping=1.0)\n"
        "print(type(cfg).__name__, cfg.min_delay, cfg.max_delay)",
        "DelayedPDActuatorCfg 3 5",
    ),
    Export.MJLAB: (
        "MJLAB_PYTHON",
        "cfg = actuator(0.005, target_names_expr=('.*',), stiffness=10.0, damping=1.0)\n"
        "from mjlab.utils.buffers import DelayBuffer\n"
        "import torch\n"
        "buffer = DelayBuffer(cfg.delay_min_lag, cfg.delay_max_lag, 200,"
        " hold_prob=cfg.delay_hold_prob, update_period=cfg.delay_update_period,"
        " per_env_phase=cfg.delay_per_env_phase)\n"
        "lags = []\n"
        "for tick in range(50):\n"
        "    buffer.append(torch.full((200, 1), float(tick)))\n"
        "    lags.append(tick - buffer.compute()[:, 0])\n"
        "late = torch.stack(lags)[10:]\n"
        "print(type(cfg).__name__, sorted(set(late.flatten().int().tolist())),"
        " bool((late == late[0]).all()))",
        "IdealPdActuatorCfg [3, 4, 5] True",
    ),
}


@pytest.mark.parametrize("export", LOADERS)
def test_simulator_reads_its_own_file(export: Export, tmp_path: Path) -> None:
    """It needs a Python with that simulator, whose versions of NumPy and MuJoCo are not ours.

    Isaac Lab also needs Isaac Sim, which PyPI does not have.
    """
    variable, code, expected = LOADERS[export]
    if variable not in os.environ:
        pytest.skip(f"{variable} names no Python that has {export}")
    file = tmp_path / "latency.py"
    file.write_text(exported(FOUND, export, "log.csv") + code)
    done = subprocess.run(
        [os.environ[variable], file], capture_output=True, text=True, check=False, timeout=300
    )
    assert done.stdout.strip().endswith(expected), done.stderr


def test_command_writes_what_it_finds(tmp_path: Path, funnel_hil) -> None:
    write_robot(tmp_path / "bag.mcap")
    words = ("latency", tmp_path / "bag.mcap", "--command", "/wanted.position[elbow]",
             "--response", "/found.position[elbow]")  # fmt: skip
    out = tmp_path / "found.yaml"
    output = funnel_hil.output(*words, "--export", "scenario", "--out", out)
    assert f"scenario: {out}" in output
    assert "plant:\n  interface: {kind: servoj, servoj: {dead_time_ms: 29." in out.read_text()
    output = funnel_hil.output(*words, "--export", "gazebo", code=2)
    assert "'isaaclab', 'mjlab'" in output
    write_robot(tmp_path / "bag.mcap", intruder=True)
    output = funnel_hil.output(*words, "--export", "mujoco", "--out", tmp_path / "no.xml", code=2)
    assert "--export mujoco: the model does not fit" in output
    assert not (tmp_path / "no.xml").exists()


def robot(seed: int = 4) -> SimpleNamespace:
    """Commands at 100 Hz, and an elbow that follows 29.5 ms later with a lag of 50 ms."""
    random = np.random.default_rng(seed)
    ticks = 2000
    wanted = np.repeat(random.standard_normal(ticks // 10), 10)
    found, state = [], 0.0
    per_tick = 100  # steps of 0.1 ms
    held = np.concatenate([np.zeros(295), np.repeat(wanted, per_tick)])
    for k in range(ticks * per_tick):
        if k % per_tick == 0:
            found.append(state + 1e-4 * random.standard_normal())
        state += (held[k] - state) * (1.0 - math.exp(-1e-4 / 0.05))
    return SimpleNamespace(wanted=wanted.tolist(), found=found)


def write_robot(
    file: Path, *, gripper: bool = False, intruder: bool = False, order=("shoulder", "elbow")
) -> None:
    """A recording of `robot`, with messages of a gripper or of a second publisher between."""
    rows, messages = robot(), []
    for i, (wanted, found) in enumerate(zip(rows.wanted, rows.found, strict=True)):
        ns = 1_700_000_000_000_000_000 + i * 10_000_000
        messages.append(("/wanted", ns, joint_state(["elbow"], [wanted])))
        values = {"shoulder": 7.0, "elbow": found}
        state = joint_state(list(order), [values[name] for name in order])
        messages.append(("/found", ns + 1, state))
        if gripper and i % 4 == 0:
            messages.append(("/found", ns + 2, joint_state(["finger"], [0.02])))
        if intruder and i % 5 == 0:
            messages.append(("/found", ns + 2, joint_state(["elbow", "finger"], [0.0, 0.0])))
    write_bag(file, messages)


@pytest.mark.parametrize("name", ["elbow", "1"])
def test_messages_of_a_gripper_are_skipped_and_counted(tmp_path: Path, funnel_hil, name) -> None:
    words = ("latency", tmp_path / "bag.mcap", "--command", "/wanted.position[elbow]",
             "--response", f"/found.position[{name}]")  # fmt: skip
    write_robot(tmp_path / "bag.mcap")
    alone = funnel_hil.output(*words)
    write_robot(tmp_path / "bag.mcap", gripper=True)
    lines = funnel_hil.output(*words).splitlines()
    assert "skipped 500 of 2,500 messages on /found: no elbow" in lines
    assert [line for line in lines if not line.startswith("skipped")] == alone.splitlines()


def test_zeros_of_a_second_publisher_are_no_fit(tmp_path: Path, funnel_hil) -> None:
    words = ("latency", tmp_path / "bag.mcap", "--command", "/wanted.position[elbow]",
             "--response", "/found.position[elbow]")  # fmt: skip
    write_robot(tmp_path / "bag.mcap", intruder=True)
    output = funnel_hil.output(*words)
    assert "the model does not fit" in output
    assert re.search(r"1[4-7] % of the responses, singly, are far from all others", output)
    assert "most of them at" in output
    assert "as of 2 publishers: shoulder, elbow (2,000); elbow, finger (400)" in output
    assert "±" not in output
