"""Arms whose loops are linear, as scenarios and for exact calculations."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import yaml

from deploy.judge.metrics import summarise
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.study.theory.theory import theory_of
from tests.deploy.study.linear_loops import LinearLoop, geared, lagging, rigid

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
    viscous: float = 0.0
    """Friction of each joint, N m s."""
    lag_ms: float = 0.0
    """Of the actuators."""
    is_seen_at_link: bool = False

    @property
    def loop(self) -> LinearLoop:
        """The loop for exact calculations."""
        loop = self._without_lag
        return lagging(loop, 1e-3 * self.lag_ms) if self.lag_ms else loop

    @property
    def _without_lag(self) -> LinearLoop:
        pid, period_s = (self.proportional, self.derivative, self.integral), 1e-3 * self.period_ms
        if self.gear is not None:
            rotor, stiffness, damping = self.gear
            one = (gains[0] for gains in pid)
            return geared(
                rotor, self.links[0], stiffness, damping, *one, period_s,
                viscous=self.viscous, is_seen_at_link=self.is_seen_at_link,
            )  # fmt: skip
        moved = np.cumsum(self.links[::-1])[::-1]
        order = np.arange(len(moved))
        coupled = moved[np.maximum.outer(order, order)]
        inertia = coupled if self.is_coupled else np.diag(moved)
        return rigid(inertia, *pid, period_s, viscous=self.viscous)

    def write(self, folder: Path, **more) -> Path:
        """Write a scenario that starts 20 mrad off, with a funnel of at least 50 mrad."""
        folder.mkdir(exist_ok=True)
        (folder / "arm.urdf").write_text(self.urdf)
        actuator = {"lag_ms": self.lag_ms}
        if self.gear is not None:
            rotor, stiffness, damping = self.gear
            actuator |= {
                "rotor_inertia_kg_m2": rotor, "gear_stiffness_nm_rad": stiffness,
                "gear_damping_nm_s": damping,
                "encoder_side": "link" if self.is_seen_at_link else "motor",
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
                "friction": {"viscous_nm_s": self.viscous},
                # Exact for a constant torque on an inertia, unlike the default; but not with gears.
                "physics": {"engine": "mujoco", "integrator": "semi_implicit_euler" if self.gear
                            else "runge_kutta_4"},
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
RESONANT = "PD, gear that resonates at 160 Hz, damping ratio 4 %"
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
    "PD, viscous friction": Arm([1.0], [1600.0], [8.0], [0.0], viscous=7.5),
    "PID, actuators lag by 3.5 ms": Arm([1.0], [3200.0], [160.0], [20000.0], lag_ms=3.5),
    "PD, elastic gear": Arm([1.0], [400.0], [40.0], [0.0], gear=(0.5, 3000.0, 5.0)),
    RESONANT: Arm([0.5], [60.0], [10.8], [0.0], gear=(0.1, 84220.6, 6.702)),
    "PD, elastic gear, measured at the link": Arm(
        [1.0], [900.0], [60.0], [0.0], gear=(0.2, 10000.0, 60.0), is_seen_at_link=True
    ),
}


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
