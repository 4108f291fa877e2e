"""Variables of RTDE that the emulated controller has, and their values."""

from __future__ import annotations

import re
from collections.abc import Mapping

from bus_schema.arrays import Matrix, Vector
from bus_schema.rtde.packages import FORMATS, Value

_ZEROS: Mapping[str, str] = {
    **dict.fromkeys(
        ("target_qdd", "target_current", "actual_current", "joint_control_output",
         "actual_TCP_pose", "actual_TCP_speed", "actual_TCP_force", "target_TCP_pose",
         "target_TCP_speed", "joint_temperatures", "actual_joint_voltage", "ft_raw_wrench",
         "actual_current_window", "tcp_offset"), "VECTOR6D"),
    **dict.fromkeys(
        ("actual_tool_accelerometer", "payload_cog", "elbow_position", "elbow_velocity"),
        "VECTOR3D"),
    **dict.fromkeys(("actual_digital_input_bits", "actual_digital_output_bits"), "UINT64"),
    **dict.fromkeys(
        ("actual_execution_time", "actual_momentum", "actual_main_voltage", "actual_robot_voltage",
         "actual_robot_current", "standard_analog_input0", "standard_analog_input1",
         "standard_analog_output0", "standard_analog_output1", "payload", "tcp_force_scalar",
         "tool_output_current"), "DOUBLE"),
    "joint_mode": "VECTOR6INT32",
    "payload_inertia": "VECTOR6D",
}  # fmt: skip
"""Types of variables that exist, but are always 0 here."""
_TYPES: Mapping[str, str] = {
    **_ZEROS,
    "timestamp": "DOUBLE", "speed_scaling": "DOUBLE", "target_speed_fraction": "DOUBLE",
    **dict.fromkeys(("target_q", "target_qd", "actual_q", "actual_qd", "target_moment"),
                    "VECTOR6D"),
    "robot_mode": "INT32", "safety_mode": "INT32", "safety_status": "INT32",
    "robot_status_bits": "UINT32", "safety_status_bits": "UINT32", "runtime_state": "UINT32",
    "speed_slider_mask": "UINT32", "speed_slider_fraction": "DOUBLE",
}  # fmt: skip
_REGISTERS = re.compile(r"(?:input|output)_(bit|int|double)_register_(\d{1,3})|.*_bit_registers.*")
_OF_REGISTERS = {"bit": "BOOL", "int": "INT32", "double": "DOUBLE"}
_OUTPUTS_OF_IO = re.compile(r"(?:standard|configurable|tool)_(?:digital|analog)_output.*")
_POWER_ON, _PROGRAM_RUNNING, _NORMAL_MODE = 1, 2, 1
_ROBOT_RUNS, _SAFETY_NORMAL, _PLAYING, _STOPPED = 7, 1, 2, 1


def type_of(name: str) -> str | None:
    """Return the type of a variable; None if the controller has none of this name."""
    if name in _TYPES:
        return _TYPES[name]
    found = _REGISTERS.fullmatch(name)
    if found is not None:
        return _OF_REGISTERS[found[1]] if found[1] else "UINT32"
    if _OUTPUTS_OF_IO.fullmatch(name):
        return "DOUBLE" if re.search(r"output_\d$", name) else "UINT8"
    return None


def values_now(
    now_s: float, measured: Matrix, planned: Matrix, torque_nm: Vector, *, runs: bool,
    outputs: Mapping[str, Value],
) -> dict[str, Value]:  # fmt: skip
    """Return the variables that are not always 0.

    Args:
        now_s: time since the controller began.
        measured: positions and velocities of the joints as rows, shape (2, 6).
        planned: those that its own controller plans, likewise.
        torque_nm: of the actuators, shape (6,).
        runs: whether a program runs.
        outputs: of the program, by name.
    """
    return {
        "timestamp": now_s,
        "actual_q": measured[0].tolist(), "actual_qd": measured[1].tolist(),
        "target_q": planned[0].tolist(), "target_qd": planned[1].tolist(),
        "target_moment": torque_nm.tolist(),
        "speed_scaling": 1.0, "target_speed_fraction": 1.0,
        "robot_mode": _ROBOT_RUNS, "safety_mode": _SAFETY_NORMAL, "safety_status": _SAFETY_NORMAL,
        "robot_status_bits": _POWER_ON + _PROGRAM_RUNNING * runs,
        "safety_status_bits": _NORMAL_MODE,
        "runtime_state": _PLAYING if runs else _STOPPED,
        **outputs,
    }  # fmt: skip


def zero_of(kind: str) -> Value:
    """Return the zero of a type."""
    count = FORMATS[kind][:-1]
    return [0] * int(count) if count else 0
