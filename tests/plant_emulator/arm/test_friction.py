import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus_schema.configuration import ConfigurationError
from plant_emulator.arm.drive_train import friction_table, friction_torque
from plant_emulator.configuration import FrictionConfiguration

CONFIGURATION = FrictionConfiguration(
    coulomb_nm=[8.0, 6.0, 4.0],
    viscous_nm_s=[10.0, 8.0, 5.0],
    stribeck_nm=[2.0, 0.0, 1.0],
    stribeck_velocity_rad_s=0.1,
    smoothing_velocity_rad_s=0.01,
)
RATED_NM = np.array([400.0, 700.0, 300.0])
TABLE = friction_table(CONFIGURATION, RATED_NM)
VELOCITY = st.floats(-20.0, 20.0)


@given(velocity=VELOCITY, joint=st.integers(0, 2))
def test_friction_follows_its_formula(velocity, joint):
    coulomb, viscous, stribeck = ((8, 6, 4)[joint], (10, 8, 5)[joint], (2, 0, 1)[joint])
    dry = coulomb + stribeck * math.exp(-((velocity / 0.1) ** 2))
    expected = dry * math.tanh(velocity / 0.01) + viscous * velocity
    assert friction_torque(velocity, TABLE, joint) == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_disabled_friction_is_none_at_all():
    table = friction_table(CONFIGURATION.model_copy(update={"enabled": False}), RATED_NM)
    for joint in range(3):
        assert friction_torque(3.0, table, joint) == 0.0


def test_default_is_frictionless_and_single_values_serve_all_joints():
    assert (
        friction_torque(3.0, friction_table(FrictionConfiguration(), np.full(7, np.inf)), 6) == 0.0
    )
    table = friction_table(FrictionConfiguration(viscous_nm_s=2.0), np.full(7, np.inf))
    assert [friction_torque(3.0, table, joint) for joint in range(7)] == [6.0] * 7


def test_shares_are_of_rated_torque_and_of_the_load():
    given = FrictionConfiguration(coulomb_share=0.03, viscous_share_s=0.01, load_share=0.1)
    table = friction_table(given, RATED_NM)
    # 3 % of 700 N m, 1 % of it per rad/s at 2 rad/s, and a tenth of 50 N m of load
    assert friction_torque(2.0, table, 1, 50.0) == pytest.approx(21.0 + 14.0 + 5.0, rel=1e-12)


def test_a_share_of_an_unknown_torque_is_refused():
    with pytest.raises(ConfigurationError, match=r"plant\.friction\.coulomb_share"):
        friction_table(FrictionConfiguration(coulomb_share=0.03), np.array([1.0, np.inf]))
