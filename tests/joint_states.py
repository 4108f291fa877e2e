"""Joint states as others encode them, with rosbags' own types."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bus_schema.messages.types import JOINT_STATE, TYPESTORE


def joint_state(
    names: Sequence[str], position: Sequence[float] = (), velocity: Sequence[float] = (),
    effort: Sequence[float] = (), *, stamp_ns: int = 0, frame: str = "world", **options: bool,
) -> bytes:  # fmt: skip
    """A message in CDR; the options are those of rosbags' encoder."""
    types = TYPESTORE.types
    time = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 1_000_000_000))
    header = types["std_msgs/msg/Header"](time, frame)
    rows = (np.array(row, dtype=np.float64) for row in (position, velocity, effort))
    message = types[JOINT_STATE](header, list(names), *rows)
    return bytes(TYPESTORE.serialize_cdr(message, JOINT_STATE, **options))
