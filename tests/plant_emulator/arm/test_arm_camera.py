"""Pictures by Bullet's C functions are those that pybullet gives."""

from contextlib import closing

import numpy as np
import pybullet
import pytest

from deploy.scenario.scenario import load_setup
from plant_emulator.arm.arm_camera import ArmCamera, look_at
from plant_emulator.arm.pybullet_arm import PybulletArm

SIZE = WIDTH, HEIGHT = 120, 90


@pytest.mark.parametrize("name", ["paper_arm", "iiwa"])
def test_a_picture_is_the_one_that_pybullet_gives(name):
    setup = load_setup(name, [])
    robot, position = setup.robot, setup.start_position_rad
    with closing(ArmCamera(robot)) as camera:
        camera.render(position + 0.5, *SIZE)  # of which nothing stays
        box = camera.extent(position[None, :])
        picture = camera.render(position, *SIZE)
    with closing(PybulletArm(robot, 1e-3)) as arm:
        arm.place(position)
        _, _, colours, _, bodies = pybullet.getCameraImage(
            *SIZE, *map(list, look_at(box, *SIZE)), renderer=pybullet.ER_TINY_RENDERER,
            lightDirection=[1, -2, 3], shadow=0, physicsClientId=arm._client,
        )  # fmt: skip
    expected = np.reshape(colours, (HEIGHT, WIDTH, 4))[..., :3]
    is_arm = np.reshape(bodies, (HEIGHT, WIDTH, 1)) >= 0
    assert is_arm.sum() > 300
    np.testing.assert_array_equal(picture, np.where(is_arm, expected, 255))


@pytest.mark.parametrize("name", ["paper_arm", "iiwa"])
def test_extent_is_the_box_around_all_that_pybullet_says_of_the_links(name):
    setup = load_setup(name, [])
    robot, start = setup.robot, setup.start_position_rad
    positions = np.array([start, start + 0.7, start - 1.1])
    with closing(ArmCamera(robot)) as camera:
        box = camera.extent(positions)
    points = [np.zeros(3)]  # the base
    with closing(PybulletArm(robot, 1e-3)) as arm:
        links = range(pybullet.getNumJoints(arm._body, physicsClientId=arm._client))
        for position in positions:
            arm.place(position)
            for state in pybullet.getLinkStates(
                arm._body, links, computeForwardKinematics=1, physicsClientId=arm._client
            ):
                points += [np.array(state[0]), np.array(state[4])]  # centre of mass, link frame
    corners = np.min(points, axis=0), np.max(points, axis=0)
    np.testing.assert_allclose(box, corners, rtol=0.0, atol=1e-12)
    assert np.ptp(corners, axis=0).min() > 0.3  # m: an arm, not a point
