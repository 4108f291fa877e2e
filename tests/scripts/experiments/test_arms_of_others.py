"""Random arms, and the table of arms without tuned gains."""

import numpy as np
import pytest

from bus_schema.robot_description import load_robot
from scripts.experiments.arms_of_others import Case, result, setup_of, table
from scripts.experiments.random_arms import write_random_arm

LAW = "fixed_time_adaptive"


def test_an_arm_made_at_random_can_hold_itself_up(tmp_path):
    robot = load_robot(write_random_arm(tmp_path, 3))
    assert 3 <= robot.joints <= 7
    assert np.isfinite(robot.effort_limits_nm).all()
    again = write_random_arm(tmp_path, 3).read_text()
    assert again == robot.text


def test_a_joint_much_weaker_than_its_neighbours_keeps_its_bounds_from_the_start():
    case = Case("no delay", LAW, "random17", 1.0, True)
    found = result(case, ("duration_s=1",))
    assert found["verdict"] == "kept"
    assert [*table({case: found})][-1].startswith(
        f"| no delay | `{LAW}` | yes | at random | 1 of 1 | 1 of 1 | – |"
    )


@pytest.mark.parametrize(
    ("side", "is_kept"), [("15 Hz gears", True), ("15 Hz gears by the link", False)]
)
def test_elastic_gears_are_held_through_the_encoders_of_motors(side, is_kept):
    case = Case(side, LAW, "random1", 1.0, True)
    setup = setup_of(case, ("duration_s=1",))
    assert setup.scenario.plant.actuator.gear_stiffness_nm_rad is not None
    assert (result(case, ("duration_s=1",))["verdict"] == "kept") == is_kept
