"""A payload that comes and goes: the arm moves on as one that has carried it from the start."""

import numpy as np
import pytest

from deploy.scenario.scenario import load_setup
from plant_emulator.configuration import PlantConfiguration
from plant_emulator.faults.arm_faults import payload_steps
from plant_emulator.physics.engines import engine_name
from tests.arms import INSTALLED

PICK_UP, DROP = "kind: payload_picked_up, payload_kg: 1.5", "kind: payload_dropped"


DEFAULT = engine_name(PlantConfiguration())


def fallen(payload_kg, *faults, engine=DEFAULT):
    """Motion after 10 ticks without torque."""
    written = ", ".join(f"{{{fault}}}" for fault in faults)
    overrides = [
        f"plant.payload_kg={payload_kg}", f"faults=[{written}]", f"plant.physics.engine={engine}"
    ]  # fmt: skip
    arm = load_setup("paper_arm", overrides).arm()
    arm.begin()
    arm.command(np.zeros(3))
    arm.advance(0, 40)
    motion = arm.motion.copy()
    arm.close()
    return motion


@pytest.mark.parametrize("engine", INSTALLED)
def test_arm_falls_like_one_that_always_carried_as_much(engine):
    loaded = fallen(2.0, engine=engine)
    assert np.abs(loaded - fallen(0.5, engine=engine)).max() > 1e-3
    for payload_kg, faults in (
        (0.5, [f"{PICK_UP}, at_s: 0"]),
        (0.0, ["kind: payload_picked_up, payload_kg: 2, at_s: 0"]),
        (0.7, [f"{DROP}, at_s: 0", "kind: payload_picked_up, payload_kg: 2, at_s: 0"]),
        (0.0, [f"{PICK_UP}, at_s: 0", f"{DROP}, at_s: 0",
               "kind: payload_picked_up, payload_kg: 2, at_s: 0"]),
    ):  # fmt: skip
        alike = fallen(payload_kg, *faults, engine=engine)
        np.testing.assert_allclose(alike, loaded, rtol=1e-9, atol=1e-12)


def test_nothing_changes_before_and_no_joint_leaps():
    late = fallen(0.0, f"{PICK_UP}, at_s: 0.009")
    never, heavy = fallen(0.0), fallen(1.5)
    assert fallen(0.0, f"{PICK_UP}, at_s: 0.01").tobytes() == never.tobytes()
    assert np.abs(late[1] - never[1]).max() < 0.2 * np.abs(heavy[1] - never[1]).max()
    assert late.tobytes() != never.tobytes()


def test_what_is_carried_over_a_run():
    faults = load_setup(
        "paper_arm",
        [f"faults=[{{{DROP}, at_s: 3}}, {{{PICK_UP}, at_s: 1}}, {{{PICK_UP}, at_s: 2}}]"],
    ).scenario.faults
    assert payload_steps(0.5, faults) == [(0.0, 0.5), (1.0, 2.0), (2.0, 3.5), (3.0, 0.0)]
