import pytest

from bus_schema.units import split_unit


@pytest.mark.parametrize(
    ("name", "stem", "unit"),
    [
        ("plant.payload_kg", "plant.payload", "kg"), ("lag_ms", "lag", "ms"),
        ("share_above_50_hz", "share_above_50_hz", ""),
        ("jerk_rms_rad_s3", "jerk_rms", "rad/s³"),
        ("jump_mm", "jump", "mm"),
        ("reference.speed", "reference.speed", ""), ("funnel.rate_per_s", "funnel.rate", "1/s"),
        ("gear_stiffness_nm_rad", "gear_stiffness", "N m/rad"), ("rate_kbit_s", "rate", "kbit/s"),
        ("gear_damping_nm_s", "gear_damping", "N m s/rad"), ("error_mrad", "error", "mrad"),
        ("torque_rate_limit_nm_s", "torque_rate_limit", "N m/s"), ("wall_s", "wall", "s"),
        ("rotor_inertia_kg_m2", "rotor_inertia", "kg m²"), ("wakeup_us", "wakeup", "µs"),
    ],
)  # fmt: skip
def test_unit_is_the_longest_known_end_of_a_name(name, stem, unit):
    assert split_unit(name) == (stem, unit)
