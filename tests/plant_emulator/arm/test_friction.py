import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus_schema.configuration import ConfigurationError
from plant_emulator.arm.friction import friction_table, friction_torque
from plant_emulator.configuration import FrictionConfiguration

CONFIGURATION = FrictionConfiguration(
    coulomb_nm=[8.0, 6.0, 4.0],
    viscous_nm_s=[10.0, 8.0, 5.0],
    stribeck_nm=[2.0, 0.0, 1.0],
    stribeck_velocity_rad_s=0.1,
    smoothing_velocity_rad_s=0.01,
)
TABLE = friction_table(CONFIGURATION, 3)
VELOCITY = st.floats(-20.0, 20.0)


@given(velocity=VELOCITY, joint=st.integers(0, 2))
def test_friction_follows_its_formula(velocity, joint):
    coulomb, viscous, stribeck = ((8, 6, 4)[joint], (10, 8, 5)[joint], (2, 0, 1)[joint])
    dry = coulomb + stribeck * math.exp(-((velocity / 0.1) ** 2))
    expected = dry * math.tanh(velocity / 0.01) + viscous * velocity
    assert friction_torque(velocity, TABLE, joint) == pytest.approx(expected, rel=1e-12, abs=1e-12)


@given(velocity=VELOCITY, joint=st.integers(0, 2))
def test_friction_is_odd_and_never_drives(velocity, joint):
    torque = friction_torque(velocity, TABLE, joint)
    assert friction_torque(-velocity, TABLE, joint) == -torque
    assert torque * velocity >= 0.0


def test_well_known_values():
    # At speed Coulomb plus viscous; near standstill the Stribeck excess on top; at rest nothing.
    assert friction_torque(1.0, TABLE, 0) == pytest.approx(8.0 + 10.0, abs=1e-12)
    assert friction_torque(0.05, TABLE, 0) == pytest.approx(
        (8.0 + 2.0 * math.exp(-0.25)) * math.tanh(5.0) + 0.5, abs=1e-12
    )
    assert friction_torque(0.0, TABLE, 0) == 0.0


@given(velocity=st.floats(-1e300, 1e300))
def test_friction_is_finite_at_any_speed(velocity):
    assert math.isfinite(friction_torque(velocity, TABLE, 0))


def test_disabled_friction_is_none_at_all():
    table = friction_table(CONFIGURATION.model_copy(update={"enabled": False}), 3)
    for joint in range(3):
        assert friction_torque(3.0, table, joint) == 0.0


def test_default_is_frictionless_and_single_values_serve_all_joints():
    assert friction_torque(3.0, friction_table(FrictionConfiguration(), 7), 6) == 0.0
    table = friction_table(FrictionConfiguration(viscous_nm_s=2.0), 7)
    assert [friction_torque(3.0, table, joint) for joint in range(7)] == [6.0] * 7


def test_wrong_number_of_values_is_refused():
    with pytest.raises(ConfigurationError, match=r"plant\.friction\.coulomb_nm"):
        friction_table(FrictionConfiguration(coulomb_nm=np.ones(2)), 3)
