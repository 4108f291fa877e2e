"""Pictures of an arm by Bullet's software renderer."""

from contextlib import closing

import numpy as np
import pytest

from controller.manipulator_model import ManipulatorModel
from deploy.scenario.scenario import load_setup
from tests.arms import needs_bullet

pytestmark = needs_bullet
SIZE = WIDTH, HEIGHT = 120, 90


@pytest.mark.parametrize("name", ["paper_arm", "iiwa"])
def test_picture_shows_the_arm_on_white_inside_its_extent(name):
    from plant_emulator.physics.bullet.camera import ArmCamera

    setup = load_setup(name, [])
    positions = setup.start_position_rad + np.array([[0.0], [0.7], [-1.1]])
    with closing(ArmCamera(setup.robot)) as camera:
        lower, upper = camera.extent(positions)
        pictures = [camera.render(position, *SIZE, (lower, upper)) for position in positions]
        again = camera.render(positions[0], *SIZE, (lower, upper))
    bones = np.concatenate([ManipulatorModel(setup.robot).skeleton(q) for q in positions])
    assert (bones >= lower - 1e-6).all()
    assert (bones <= upper + 1e-6).all()
    assert np.ptp([lower, upper], axis=0).min() > 0.3  # m: an arm, not a point
    for picture in pictures:
        is_arm = (picture != 255).any(axis=2)
        assert 300 < is_arm.sum() < 0.5 * WIDTH * HEIGHT
        assert not is_arm[[0, -1]].any()
    assert (pictures[0] != pictures[1]).any()
    np.testing.assert_array_equal(again, pictures[0])
