"""References from CSV files: motion between rows, and messages about unusable files."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bus_schema.configuration import ConfigurationError
from controller.reference_configuration import CsvConfiguration
from tests.arms import PAPER_ARM

ARM = PAPER_ARM
JOINTS = ARM.joint_names
POSITIONS = "time_s," + ",".join(f"{joint}.position_rad" for joint in JOINTS)


def wave(times):
    """Position, velocity and acceleration of the joints, shape (times, 3, joints)."""
    rates = np.array([1.0, 2.0, 3.0])
    phase = np.multiply.outer(np.asarray(times), rates) + 0.1 * rates
    return np.stack([np.sin(phase), rates * np.cos(phase), -(rates**2) * np.sin(phase)], axis=1)


def build(path, text, **keys):
    path.write_text(text)
    return CsvConfiguration(kind="csv", file=str(path), **keys).build(ARM)


def table(times, kinds, positions=None):
    names = ("position_rad", "velocity_rad_s", "acceleration_rad_s2")[:kinds]
    motion = wave(times) if positions is None else positions
    header = ["time_s", *(f"{joint}.{name}" for joint in JOINTS for name in names)]
    rows = [
        [float(time), *(float(motion[i, k, j]) for j in range(3) for k in range(kinds))]
        for i, time in enumerate(times)
    ]
    return "\n".join(",".join(map(str, row)) for row in [header, *rows]) + "\n"


def motion_at(reference, time_s):
    rows = np.empty((3, 3))
    reference.evaluate(time_s, *rows)
    return rows


# Of waves of at most 3 rad/s with a row every h = 40 ms: quintics err by parts of (3 h)^6, splines
# by parts of (3 h)^4, (3 h)^3 and (3 h)^2; a derivative that is left out, by 1 to 9.
@pytest.mark.parametrize(
    ("kinds", "errors"), [(3, (1e-9, 1e-7, 1e-5)), (2, (1e-6, 1e-5, 2e-2)), (1, (2e-5, 2e-3, 0.2))]
)
def test_between_rows_it_is_the_motion_that_was_sampled(kinds, errors, tmp_path):
    reference = build(tmp_path / "wave.csv", table(np.arange(0, 2.01, 0.04), kinds))
    for time_s in np.linspace(0.0, 1.999, 173):
        difference = np.abs(motion_at(reference, time_s) - wave([time_s])[0]).max(axis=1)
        assert (difference <= errors).all(), (time_s, difference)


def test_a_row_with_all_derivatives_is_met_to_the_bit(tmp_path):
    times = [0.0, 0.013, 0.4, 0.41, 1.7]
    reference = build(tmp_path / "wave.csv", table(times, 3))
    for time_s, row in zip(times, wave(times), strict=True):
        assert motion_at(reference, time_s).tolist() == row.tolist()


@pytest.mark.parametrize("kinds", [1, 3])
def test_before_and_after_its_rows_it_rests(kinds, tmp_path):
    reference = build(tmp_path / "wave.csv", table([0.5, 0.6, 0.7], kinds), beyond="hold")
    for time_s, row in ((0.49, 0.5), (-3.0, 0.5), (0.71, 0.7), (99.0, 0.7)):
        held = motion_at(reference, time_s)
        assert held[0].tolist() == wave([row])[0, 0].tolist()
        assert not held[1:].any()


def test_one_row_is_a_place_to_stay(tmp_path):
    reference = build(tmp_path / "one.csv", POSITIONS + "\n0,0.1,0.2,0.3\n", beyond="hold")
    for time_s in (0.0, 1.0):
        assert motion_at(reference, time_s).tolist() == [[0.1, 0.2, 0.3], [0.0] * 3, [0.0] * 3]


def test_twice_the_speed_is_half_the_time(tmp_path):
    text = table(np.arange(0, 2.01, 0.1), 3)
    slow = build(tmp_path / "wave.csv", text)
    fast = build(tmp_path / "wave.csv", text, speed=2.0)
    assert fast.known_s == (0.0, pytest.approx(1.0))
    for time_s in (0.0, 0.33, 0.9):
        doubled = motion_at(slow, 2.0 * time_s) * [[1.0], [2.0], [4.0]]
        np.testing.assert_allclose(motion_at(fast, time_s), doubled, rtol=1e-9, atol=1e-9)


def test_order_of_columns_spaces_empty_lines_and_other_columns_do_not_matter(tmp_path):
    yaw, shoulder, elbow = (f"{joint}.position_rad" for joint in JOINTS)
    text = (
        f"\ufeffnote, {elbow}, time_s ,{yaw},gripper,{shoulder}\n\nx,0.3,0,0.1,,0.2\n\ny,3,1,1,,2\n"
    )
    reference = build(tmp_path / "mixed.csv", text)
    assert motion_at(reference, 0.0)[0].tolist() == [0.1, 0.2, 0.3]
    assert motion_at(reference, 1.0)[0].tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (POSITIONS + "\n0,0,0,0\n1,0,nan,0\n", "line 3, column shoulder.position_rad = nan"),
        (POSITIONS + "\n0,0,0,1e13\n", "line 2, column elbow.position_rad = 1e13"),
        (POSITIONS + "\n0,0,0\n", "line 2 has 3 cells, the first line names 4 columns"),
        (POSITIONS + "\n0,0,0,0\n\n0,0,0,0\n", "line 4, column time_s = 0: must be later"),
        (
            POSITIONS + "\n0,0,0,0\n1e-9,1,1,1\n2e-9,0,0,0\n1,0,0,0\n",
            "line 3, column time_s = 1e-9",
        ),
        (POSITIONS + "\n0,0,0,0\n1,0,0,0\n2,0,0,0,5\n", "line 4 has 5 cells, the first line"),
        (POSITIONS + "\n", "must have a row after its first line"),
        ("", "line 1: column time_s is missing"),
        ("time_s,base_yaw.position_rad\n0,0\n", "column shoulder.position_rad is missing"),
        (POSITIONS + ",elbow.speed\n0,0,0,0,0\n", "column 'elbow.speed': the columns of a joint"),
        (POSITIONS + ",time_s\n0,0,0,0,0\n", "'time_s' occurs twice"),
        (
            POSITIONS + ",elbow.acceleration_rad_s2\n0,0,0,0,0\n",
            "column elbow.velocity_rad_s is missing",
        ),
    ],
)
def test_what_is_no_reference_is_refused_by_line_and_column(text, message, tmp_path):
    with pytest.raises(ConfigurationError) as refused:
        build(tmp_path / "bad.csv", text)
    assert message in str(refused.value)
    assert "bad.csv" in str(refused.value)


def test_bytes_that_are_no_text_are_refused(tmp_path):
    path = tmp_path / "bytes.csv"
    path.write_bytes(b"\xff\xfe\x00time_s")
    with pytest.raises(ConfigurationError, match="cannot be read as CSV"):
        CsvConfiguration(kind="csv", file=str(path)).build(ARM)


def test_jumps_that_no_joint_can_follow_are_a_warning(tmp_path):
    limit = float(ARM.velocity_limits_rad_s[1])
    assert math.isfinite(limit)
    text = f"{POSITIONS}\n0,0,0,0\n1,0,{0.9 * limit},0\n2,0,{-0.2 * limit},0\n"
    (message,) = build(tmp_path / "jump.csv", text).warnings
    assert "jump.csv, line 4: shoulder needs" in message
    assert len(build(tmp_path / "jump.csv", text, speed=1.2).warnings) == 1
    assert build(tmp_path / "jump.csv", text, speed=0.5).warnings == ()
