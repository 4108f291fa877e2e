"""Commands with several rows, tick by tick."""

from __future__ import annotations

import numpy as np

from bus_schema.messages.topics import JOINT_COMMANDS, layout
from bus_schema.messages.types import stamps_ns
from deploy.judge.command_rows import tabulate_by_tick
from tests.joint_states import joint_state

NAMES = ("yaw", "elbow")
MS = 1_000_000
COMMANDS = layout(JOINT_COMMANDS, NAMES)


def command(stamp_ms: float, *torques_nm: float) -> bytes:
    effort = np.repeat(torques_nm, len(NAMES))
    return joint_state(NAMES, effort=effort.tolist(), stamp_ns=round(stamp_ms * MS))


def by_tick(*payloads: bytes, end_ms: int) -> list[tuple[int, float]]:
    table = tabulate_by_tick(COMMANDS, payloads, MS, end_ms * MS)
    return list(zip((stamps_ns(table) // MS).tolist(), table["effort"][:, 1].tolist(), strict=True))


def test_each_row_has_its_tick_and_the_last_one_stays_until_the_next_command() -> None:
    found = by_tick(command(0, 1.0, 2.0), command(3, 5.0, 6.0, 7.0), command(5, 9.0), end_ms=7)
    assert found == [(0, 1.0), (1, 2.0), (2, 2.0), (3, 5.0), (4, 6.0), (5, 9.0), (6, 9.0)]


def test_what_the_plant_refuses_is_left_out() -> None:
    late, beyond = command(1, 8.0), command(2_147_483_647_999.0, 8.0, 8.0, 8.0)
    found = by_tick(command(2, 1.0), late, b"no message", beyond, command(3, 2.0), end_ms=5)
    assert found == [(2, 1.0), (3, 2.0), (4, 2.0)]
    assert by_tick(end_ms=-1) == []
