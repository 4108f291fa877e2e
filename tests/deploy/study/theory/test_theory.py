"""Margins and stability of linear loops agree with theory, which knows them exactly."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml

from deploy.judge.metrics import summarise
from deploy.reports.studies.study_texts import margin_sentences
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.study.margin import Margin
from deploy.study.theory.theory import SampledLoop, theory_of
from tests.deploy.own_laws import own_law
from tests.deploy.study.linear_loops import LinearLoop, geared, rigid
from tests.deploy.study.studies import Here, conduct, made_up
from tests.warm_process import ROOT

PAGE = ROOT / "deploy" / "docs" / "explanation" / "theory.md"
RESOLUTION_MS, STEP_MS = 0.5, 0.25


@dataclass(frozen=True)
class Arm:
    """Links with their centres of mass on the axes of all joints, so that nothing but inertia acts.

    Inertias in kg m², PID gains in N m per rad, rad s and rad/s.
    """

    links: list[float]
    """Inertia of each link, about any axis."""
    proportional: list[float]
    derivative: list[float]
    integral: list[float]
    period_ms: float = 1.0
    gear: tuple[float, float, float] | None = None
    """Inertia of the rotor, stiffness and damping of an elastic gear."""
    is_coupled: bool = False
    """The axes are parallel; otherwise each is perpendicular to the one before."""

    @property
    def loop(self) -> LinearLoop:
        """The loop for exact calculations."""
        pid, period_s = (self.proportional, self.derivative, self.integral), 1e-3 * self.period_ms
        if self.gear is not None:
            rotor, stiffness, damping = self.gear
            one = (gains[0] for gains in pid)
            return geared(rotor, self.links[0], stiffness, damping, *one, period_s)
        moved = np.cumsum(self.links[::-1])[::-1]
        order = np.arange(len(moved))
        coupled = moved[np.maximum.outer(order, order)]
        return rigid(coupled if self.is_coupled else np.diag(moved), *pid, period_s)

    def write(self, folder: Path, **more) -> Path:
        """Write a scenario that starts 20 mrad off, with a funnel of at least 50 mrad."""
        folder.mkdir(exist_ok=True)
        (folder / "arm.urdf").write_text(self.urdf)
        actuator = {}
        if self.gear is not None:
            rotor, stiffness, damping = self.gear
            actuator = {
                "rotor_inertia_kg_m2": rotor, "gear_stiffness_nm_rad": stiffness,
                "gear_damping_nm_s": damping,
            }  # fmt: skip
        still = [0.0] * len(self.links)
        gains = {name: getattr(self, name) for name in ("proportional", "integral", "derivative")}
        values = {
            "name": "linear", "duration_s": 6.0, "rate_hz": 1e3 / self.period_ms,
            "robot": {"urdf": "arm.urdf", "initial_offset_rad": 0.02},
            "reference": {"kind": "minimum_jerk", "waypoints": [
                {"time_s": at_s, "position_rad": still} for at_s in (0.0, 1.0)]},
            "funnel": {"final_rad": 0.05, "overshoot_margin_rad": 0.05},
            "controller": {"law": "pid", "gains": {"pid": gains}},
            "link": {"kind": "in_process"},
            "plant": {
                "substeps": round(self.period_ms / STEP_MS), "actuator": actuator,
                # Exact for a constant torque on an inertia, unlike the default.
                "physics": {"engine": "mujoco", "integrator": "runge_kutta_4"},
            },
        }  # fmt: skip
        file = folder / "linear.yaml"
        file.write_text(yaml.safe_dump(values | more))
        return file

    @property
    def urdf(self) -> str:
        ends = [*self.links, 0.0]
        return '<robot name="linear"><link name="l0"/>' + "".join(
            f'<joint name="j{i}" type="continuous"><parent link="l{i}"/><child link="l{i + 1}"/>'
            f'<axis xyz="{"1 0 0" if i % 2 and not self.is_coupled else "0 0 1"}"/>'
            '<limit effort="1e6" velocity="1e3"/></joint>'
            f'<link name="l{i + 1}"><inertial><mass value="1"/><inertia ixx="{inertia}"'
            f' iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            for i, inertia in enumerate(ends[:-1])
        ) + "</robot>"  # fmt: skip


UR10E = "PD on the inertia of a UR10e's last joint, 500 Hz"
ARMS = {
    "PD": Arm([2.5], [16000.0], [400.0], [0.0]),
    "PD, overdamped, 500 Hz": Arm([0.1], [250.0], [15.0], [0.0], 2.0),
    "PID": Arm([1.0], [3200.0], [160.0], [20000.0]),
    "PID, 250 Hz": Arm([1.0], [1600.0], [80.0], [6000.0], 4.0),
    "PID, two joints with perpendicular axes": Arm(
        [1.0, 0.2], [6000.0, 500.0], [200.0, 30.0], [9000.0, 900.0]
    ),
    "PD, two joints with parallel axes": Arm(
        [1.0, 0.2], [3000.0, 500.0], [150.0, 20.0], [0.0, 0.0], is_coupled=True
    ),
    UR10E: Arm([0.00034], [0.378], [0.034], [0.0], 2.0),
    "PD, elastic gear": Arm([1.0], [400.0], [40.0], [0.0], 1.0, (0.5, 3000.0, 5.0)),
}
RIGID = [name for name, arm in ARMS.items() if arm.gear is None]


PATTERNS = {
    "square wave": lambda ticks: [1.0] * (ticks // 2) + [0.0] * (ticks - ticks // 2),
    "long square wave": lambda ticks: [1.0] * (2 * ticks // 3) + [0.0] * (ticks - 2 * ticks // 3),
    "sawtooth": lambda ticks: [k / (ticks - 1) for k in range(ticks)],
    "falling sawtooth": lambda ticks: [1.0 - k / (ticks - 1) for k in range(ticks)],
}
"""Delays of a period of so many ticks, as shares of the largest one."""


def pattern_ms(name, ticks, largest_ms, arm):
    """Delays of a pattern up to the largest one, in whole physics steps."""
    steps = int(largest_ms / STEP_MS)
    return in_order([STEP_MS * round(share * steps) for share in PATTERNS[name](ticks)], arm)


def in_order(delays_ms, arm):
    """Delays of each message in a period; one that would overtake another waits for it."""
    ticks = len(delays_ms)
    sent_ms = arm.period_ms * np.arange(3 * ticks)
    arrivals = np.maximum.accumulate(sent_ms + np.tile(delays_ms, 3))
    return (arrivals - sent_ms)[-ticks:].tolist()


def constant(delay_ms):
    """Overrides for a round trip, half of it each way."""
    return [f"link.{way}.delay_ms={0.5 * delay_ms}" for way in ("uplink", "downlink")]


def varying(delays_ms, arm, folder):
    """Overrides for an uplink with delays that repeat, one for each message."""
    ticks = round(20_000 / arm.period_ms)
    rows = (f"{1e-3 * k * arm.period_ms:.6f},{delays_ms[k % len(delays_ms)]}" for k in range(ticks))
    (folder / "trace.csv").write_text("\n".join(["time_s,delay_ms", *rows]))
    return [f"link.uplink.trace={{file: {folder / 'trace.csv'}, start_s: 0, loop: false}}"]


def is_kept(file, overrides):
    """Whether an arm stays in its funnel."""
    return summarise(simulate(load_setup(str(file), overrides)).data())["bounds"]["kept"]


@cache
def exact_ms(name):
    return 1e3 * ARMS[name].loop.exact_margin_s()


def theory_ms(name, folder):
    return theory_of(load_setup(str(ARMS[name].write(folder))))


@pytest.mark.parametrize("name", ARMS)
def test_arm_is_kept_up_to_the_exact_margin_and_lost_one_step_beyond(name, tmp_path):
    file, largest = ARMS[name].write(tmp_path), RESOLUTION_MS * (exact_ms(name) // RESOLUTION_MS)
    assert is_kept(file, constant(largest))
    assert not is_kept(file, constant(largest + RESOLUTION_MS))


@pytest.mark.parametrize("name", RIGID)
def test_theory_of_a_scenario_is_that_of_the_exact_loop(name, tmp_path):
    assert theory_ms(name, tmp_path)["constant_ms"] == pytest.approx(exact_ms(name), abs=0.02)


@pytest.mark.parametrize("period_s", [0.002, 0.007, 0.02])
def test_theory_of_a_slowly_sampled_loop_is_exact(period_s):
    gains = 400.0, 30.0, 700.0
    loop = rigid([[1.0]], *([gain] for gain in gains), period_s)
    proportional, derivative, integral = gains
    summed = integral * period_s
    direct, memory = [[proportional + summed, derivative]], [[summed, 0.0]]
    found_s = SampledLoop(-np.array(direct), -np.array(memory), period_s).largest_delay_s()
    assert found_s == pytest.approx(loop.exact_margin_s(), abs=2e-5)


def test_margin_prints_theory_beside_what_it_found(tmp_path):
    file = ARMS[UR10E].write(tmp_path)
    search = {"scenarios": [str(file)], "laws": ["pid", "smc"], "offsets": [1.0], "limit": 14}
    study = Margin(search, tmp_path)
    _, folder = conduct(study, tmp_path / "out", Here())
    summary = study.summary(folder.rows)
    pid, smc = summary["cases"]
    assert pid["margin"] == 13.5
    assert pid["theory"] == {"constant_ms": 13.54, "any_pattern_ms": 8.94, "joint": "j0"}
    assert set(smc["theory"]) == {"reason"}
    text = margin_sentences(summary)
    assert any("up to a constant 13.54 ms, and below 8.94 ms for every pattern" in s for s in text)
    assert any("No theoretical margin, because it has no slope at zero error" in s for s in text)


@pytest.mark.parametrize("name", RIGID)
def test_no_pattern_below_the_bound_is_unstable(name, tmp_path):
    arm, bound_ms = ARMS[name], theory_ms(name, tmp_path)["any_pattern_ms"]
    for pattern in PATTERNS:
        for ticks in (2, 3, 5, 8, 13, 21, 34):
            delays = pattern_ms(pattern, ticks, bound_ms, arm)
            assert max(delays) <= bound_ms
            assert arm.loop.is_stable([1e-3 * delay for delay in delays]), (pattern, ticks)


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("name", ["PD", "PID, 250 Hz"])
def test_arm_is_kept_under_patterns_below_the_bound(name, pattern, tmp_path):
    arm, bound_ms = ARMS[name], theory_ms(name, tmp_path)["any_pattern_ms"]
    for ticks in (3, 8, 20):
        delays = pattern_ms(pattern, ticks, bound_ms, arm)
        assert is_kept(tmp_path / "linear.yaml", varying(delays, arm, tmp_path)), ticks


@pytest.mark.parametrize(
    ("name", "largest_ms", "ticks", "late"), [("PID", 8.5, 17, 9), (UR10E, 13.5, 14, 8)]
)
def test_a_pattern_between_bound_and_margin_is_unstable(name, largest_ms, ticks, late, tmp_path):
    arm = ARMS[name]
    delays = in_order([largest_ms] * late + [0.0] * (ticks - late), arm)
    assert theory_ms(name, tmp_path)["any_pattern_ms"] < largest_ms < exact_ms(name)
    assert arm.loop.growth_per_s([1e-3 * delay for delay in delays]) > 1.0
    file = tmp_path / "linear.yaml"
    assert is_kept(file, constant(largest_ms))
    assert not is_kept(file, varying(delays, arm, tmp_path))


def test_bound_of_a_fast_loop_is_that_of_continuous_time():
    proportional, derivative, omega = 1600.0, 60.0, np.logspace(0.0, 4.0, 20_000)
    open_loop = (derivative * 1j * omega + proportional) / (1j * omega) ** 2
    continuous_s = 1.0 / (omega * abs(open_loop / (1.0 + open_loop))).max()
    direct = -np.array([[proportional, derivative]])
    sampled_s = SampledLoop(direct, np.zeros((1, 2)), 1e-5).bound_s()
    assert sampled_s == pytest.approx(continuous_s, rel=1e-3)


FILTER = """self.past = (0.9 * self.past if self.calls > 1 else 0.0) + tracking.error
return -self.past"""
OTHER_LAWS = {
    "return 1.0 * tracking.error": "unstable without a delay",
    "return np.zeros(2)": "does not depend on errors",
    "return -np.sign(tracking.error)": "no slope",
    "return -np.abs(tracking.error) - tracking.error_rate": "no slope",
    "return -np.sqrt(np.abs(tracking.error)) * np.sign(tracking.error)": "no slope",
    FILTER: "filters",
    "raise ValueError('broken')": "it raised ValueError: broken",
}


@pytest.mark.parametrize("does", OTHER_LAWS)
def test_a_law_without_linear_loop_has_a_reason(does, tmp_path, import_folder):
    law = own_law(import_folder, does, f"law_{list(OTHER_LAWS).index(does)}")
    file = ARMS["PD, two joints with parallel axes"].write(tmp_path)
    setup = load_setup(str(file), [f"controller.law={law}"])
    assert OTHER_LAWS[does] in theory_of(setup)["reason"]


def test_own_law_that_is_linear_has_theoretical_margins(tmp_path, import_folder):
    arm = ARMS["PD, two joints with parallel axes"]
    does = (
        f"return -np.array({arm.proportional}) * tracking.error"
        f" - np.array({arm.derivative}) * tracking.error_rate"
    )
    law = own_law(import_folder, does, "linear_law")
    file = arm.write(tmp_path)
    own, shipped = (theory_of(load_setup(str(file), o)) for o in ([f"controller.law={law}"], []))
    assert own == shipped
    assert "joint" in own


POSTURE = [0.1, -0.5, 0.3, 1.2, 0.2, -0.6, 0.0]
WITHOUT_FRICTION = [
    f"reference={{kind: minimum_jerk, waypoints: [{{time_s: 0, position_rad: {POSTURE}}},"
    f" {{time_s: 1, position_rad: {POSTURE}}}]}}",
    "robot.initial_offset_rad=0.005", "duration_s=6", "controller.model_scale=1",
    "funnel={final_rad: 0.3, convergence_margin_rad: 0.4, overshoot_margin_rad: 0.4}",
    "controller.delay_compensation.enabled=false",
    "plant={friction: {enabled: false}, physics: {engine: mujoco, integrator: runge_kutta_4}}",
]  # fmt: skip


def test_computed_torque_on_a_real_arm_agrees_with_its_theory(import_folder):
    wanted = "tracking.reference_acceleration - 4000 * tracking.error - 130 * tracking.error_rate"
    does = f"return self.model.inverse_dynamics(tracking.position, tracking.velocity, {wanted})"
    overrides = [*WITHOUT_FRICTION, f"controller.law={own_law(import_folder, does, 'torques')}"]
    exact = 1e3 * rigid([[1.0]], [4000.0], [130.0], [0.0], 1e-3).exact_margin_s()  # of each joint
    assert theory_of(load_setup("iiwa", overrides))["constant_ms"] == pytest.approx(exact, abs=0.02)
    assert 9.5 < exact < 10.0
    assert is_kept("iiwa", [*overrides, *constant(9.5)])
    assert not is_kept("iiwa", [*overrides, *constant(10.0)])


def test_coupling_of_joints_counts():
    overrides = [*WITHOUT_FRICTION, "controller.law=pid"]
    # With the diagonal of the mass matrix alone, the figure would be 32 ms.
    assert 15.0 < theory_of(load_setup("iiwa", overrides))["constant_ms"] < 17.0
    assert is_kept("iiwa", [*overrides, *constant(15.0)])
    assert not is_kept("iiwa", [*overrides, *constant(17.0)])


@pytest.mark.parametrize(
    ("overrides", "reason"),
    [
        (["controller.delay_compensation.enabled=true"], "compensation"),
        (["controller.drive_feedback.enabled=true"], "drives"),
        (["controller.every=2"], "slower"),
        (["plant.actuator.lag_ms=1"], "lag"),
    ],
)
def test_a_scenario_beyond_the_linear_loop_has_a_reason(overrides, reason, tmp_path):
    file = ARMS["PD"].write(tmp_path)
    assert reason in theory_of(load_setup(str(file), overrides))["reason"]


def test_other_quantities_than_delay_have_no_theory(tmp_path):
    study = Margin({"laws": ["pid"], "quantity": "jitter", "limit": 2}, tmp_path)
    _, folder = conduct(study, tmp_path / "out", Here(made_up))
    assert study.summary(folder.rows)["cases"][0]["theory"] is None


def test_the_page_has_the_figures(tmp_path):
    table = ["| loop | exact | held | every pattern |", "|---|---|---|---|"]
    for name, arm in ARMS.items():
        held_ms = RESOLUTION_MS * (exact_ms(name) // RESOLUTION_MS)  # as tested above
        bound_ms = theory_ms(name, tmp_path).get("any_pattern_ms")
        shown = "–" if arm.gear else f"{bound_ms:.1f} ms"
        table.append(f"| {name} | {exact_ms(name):.2f} ms | {held_ms:g} ms | {shown} |")
    assert "\n".join(table) in PAGE.read_text()
