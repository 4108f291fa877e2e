"""Conditional integration: what a law remembers does not grow while the actuator cannot follow.

A memory that answers a signal (an integral the error, a network the sliding variable) pushes the
torque against that signal. While the torque asked for last was beyond the joint's limit, a push
further out changes nothing but the memory, which has to be unlearned later: it is left out. A push
back inwards is always taken. After Åström and Hägglund, PID Controllers (1995), section 3.5.
"""

from __future__ import annotations

from bus_schema.runtime.compiled import compiled


@compiled
def may_accumulate(torque_nm: float, signal: float, limit_nm: float) -> bool:
    """Whether a joint's memory may take in a signal, after it asked for a torque."""
    return abs(torque_nm) <= limit_nm or torque_nm * signal > 0.0
