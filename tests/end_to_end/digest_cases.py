"""Digests of short simulations as JSON, from a process of its own in an environment to try.

OpenBLAS, NumPy and the C library choose their kernels when they are loaded.
"""

from __future__ import annotations

import hashlib
import json

import numpy as np

from bus_schema.urdf.resolved import pybullet_data
from deploy.judge.metrics import summarise
from deploy.run.simulate import simulate
from deploy.scenario.scenario import SHIPPED, load_setup
from deploy.scenario.uncertainty import Draw

SHORT = ("duration_s=0.15", "metrics.from_s=0")
LAWS = ("fixed_time_neural", "fixed_time_model_based", "smc")
COMPENSATED = "controller.delay_compensation.enabled=true"
DELAYED = tuple(
    f"link.{way}={{delay_ms: 3, jitter_ms: 1, distribution: pareto, correlation: 0.6}}"
    for way in ("uplink", "downlink")
)
MIMIC = (
    "robot.urdf=pybullet_data:xarm/xarm6_with_gripper.urdf", "robot.initial_offset_rad=0.02",
    "reference.centre_rad=[0, -0.3, -0.5, 0, 0, 0, 0.4]",
    "reference.terms=[{amplitude_rad: 0.1, frequency_rad_s: 1}]", "plant.disturbance.terms=[]",
)  # fmt: skip
"""Turns the panda into an arm with five mimic joints, and two inertias that are mended."""
_JUDGED = ("bounds", "tracking", "torque", "transport")


def cases() -> dict[str, tuple[str, ...]]:
    """Scenario and overrides by the name of the case, which begins with the scenario's."""
    found: dict[str, tuple[str, ...]] = {}
    for path in sorted(SHIPPED.glob("*.yaml")):
        # CAN has delays of its own, and takes no others. Drives are awaited by the wall's clock.
        is_can = load_setup(path.stem).scenario.link.kind == "can"
        patience = ("link.can.answer_timeout_s=60",) if is_can else ()
        delays = () if is_can else DELAYED
        # Every law runs on every arm, and each arm both with and without compensation.
        for number, law in enumerate(LAWS, len(found)):
            own = (f"controller.law={law}", *patience)
            is_compensated = number % 2
            name = "compensated" if is_compensated else "plain"
            found[f"{path.stem} {law} {name}"] = (
                (*own, COMPENSATED, *delays) if is_compensated else own
            )
    for law in ("fixed_time_model_based", "smc"):
        found[f"iiwa {law} on MuJoCo"] = (f"controller.law={law}", "plant.physics.engine=mujoco")
        if pybullet_data():
            found[f"panda {law} mimic"] = (f"controller.law={law}", *MIMIC)
    return found


def digests(scenario: str, overrides: tuple[str, ...]) -> tuple[str, str]:
    """Of a simulation's messages, and of the gains and what is judged."""
    setup = load_setup(scenario, [*SHORT, *overrides])
    run = simulate(setup).data()
    summary = summarise(run)
    judged = json.dumps([str(setup.gains), *(summary[key] for key in _JUDGED)])
    return run.digest, hashlib.sha256(judged.encode()).hexdigest()


def drawn() -> str:
    """Hash of what an uncertain plant may be given."""
    draw = Draw.model_validate(
        {"distribution": "log_uniform", "from": 0.1, "to": 9, "per": "joint"}
    )
    sample = draw.sample(np.random.default_rng(1), 1000)
    return hashlib.sha256(np.asarray(sample).tobytes()).hexdigest()


if __name__ == "__main__":
    found = {name: digests(name.split()[0], overrides) for name, overrides in cases().items()}
    print(json.dumps({**found, "log-uniform draws": drawn()}))
