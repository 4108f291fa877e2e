"""Datagrams of the research interface: states of the robot, and targets for it.

After libfranka's public headers: little-endian, without padding; states have single precision.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

JOINTS = 7
_POSES = ("O_T_EE", "O_T_EE_d", "F_T_EE", "EE_T_K", "F_T_NE", "NE_T_EE")
_SIZES = {
    **dict.fromkeys(_POSES, 16),
    "m_ee": 1, "I_ee": 9, "F_x_Cee": 3, "m_load": 1, "I_load": 9, "F_x_Cload": 3,
    "elbow": 2, "elbow_d": 2,
    **dict.fromkeys(("tau_J", "tau_J_d", "dtau_J", "q", "q_d", "dq", "dq_d", "ddq_d",
                     "joint_contact"), JOINTS),
    "cartesian_contact": 6, "joint_collision": JOINTS, "cartesian_collision": 6,
    "tau_ext_hat_filtered": JOINTS, "O_F_ext_hat_K": 6, "K_F_ext_hat_K": 6, "O_dP_EE_d": 6,
    "O_ddP_O": 3, "elbow_c": 2, "delbow_c": 2, "ddelbow_c": 2, "O_T_EE_c": 16, "O_dP_EE_c": 6,
    "O_ddP_EE_c": 6, "theta": JOINTS, "dtheta": JOINTS,
    "accelerometer_top": 18, "accelerometer_bottom": 18,
}  # fmt: skip
"""Number of values of each field, in order."""
_ERRORS = 41
STATE = np.dtype(
    [("message_id", "<u8")]
    + [(name, "<f4", (size,)) for name, size in _SIZES.items()]
    + [
        ("motion_generator_mode", "u1"), ("controller_mode", "u1"),
        ("errors", "u1", (_ERRORS,)), ("reflex_reason", "u1", (_ERRORS,)),
        ("robot_mode", "u1"), ("control_command_success_rate", "<f4"),
    ]
)  # fmt: skip
TARGET = np.dtype(
    [
        ("message_id", "<u8"), ("q_c", "<f8", (JOINTS,)), ("dq_c", "<f8", (JOINTS,)),
        ("O_T_EE_c", "<f8", (16,)), ("O_dP_EE_c", "<f8", (6,)), ("elbow_c", "<f8", (2,)),
        ("valid_elbow", "u1"), ("motion_generation_finished", "u1"),
        ("tau_J_d", "<f8", (JOINTS,)), ("torque_command_finished", "u1"),
    ]
)  # fmt: skip
GENERATOR_IDLE, JOINT_POSITION, JOINT_VELOCITY, GENERATOR_NONE = 0, 1, 2, 5
"""Modes of the motion generator; a request for a move has one less."""
EXTERNAL_CONTROLLER, CONTROLLER_OTHER = 2, 3
ROBOT_IDLE, ROBOT_MOVES, ROBOT_REFLEX = 1, 2, 4
ERRORS: Mapping[str, int] = {
    "joint_motion_generator_velocity_limits_violation": 13,
    "joint_motion_generator_velocity_discontinuity": 14,
    "joint_motion_generator_acceleration_discontinuity": 15,
    "communication_constraints_violation": 25,
    "controller_torque_discontinuity": 32,
}
"""Places in ``errors`` and ``reflex_reason``, by name."""


def new_state() -> NDArray[Any]:
    """Return a state at rest, shape (1,): poses are the identity, as no kinematics are known."""
    state = np.zeros(1, STATE)
    for name in (*_POSES, "O_T_EE_c"):
        state[name] = np.eye(4).ravel()
    state["robot_mode"], state["controller_mode"] = ROBOT_IDLE, CONTROLLER_OTHER
    return state


def read_target(data: bytes) -> Any:
    """Read a target, a record of `TARGET`.

    Raises:
        ValueError: it has another size, or values that are not finite; the message says which.
    """
    if len(data) != TARGET.itemsize:
        raise ValueError(f"a target of {len(data)} bytes: must have {TARGET.itemsize}")
    target = np.frombuffer(data, TARGET)[0]
    for name in ("q_c", "dq_c", "tau_J_d"):
        if not np.isfinite(target[name]).all():
            raise ValueError(f"a target with {name} = {target[name].tolist()}: must be finite")
    return target
