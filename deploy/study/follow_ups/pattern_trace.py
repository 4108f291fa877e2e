"""The worst pattern of delays as traces, which `link.*.trace.file` reads."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bus_schema.link.channel_configuration import ChannelConfiguration
from bus_schema.recording.atomic_files import write_whole
from deploy.judge.run_rows import Row
from deploy.scenario.playout import EXPECTED
from deploy.scenario.scenario import load_setup
from deploy.scenario.setup import Setup
from deploy.scenario.yaml_files import override, plain
from deploy.study.follow_ups.trials import command_of
from deploy.study.settings import Setting
from plant_emulator.channel.conditions import ConditionsSchedule

_PER_TICK = 8
"""Samples; commands are sent between ticks, when states arrive."""


def write_worst_traces(
    setting: Setting, overrides: Sequence[str], row: Row, folder: Path, name: str
) -> dict[str, Any]:
    """Write the delays of a run over time, a file for each direction that the setting varies.

    Args:
        setting: the setting.
        overrides: all overrides of the run but its seed.
        row: row of the run, for its seed.
        folder: where.
        name: beginning of the files' names.

    Returns:
        ``traces``: the files, and ``trace_command``: the command that replays them; nothing where
        the scenario has traces of its own.
    """
    setup, files, instead = load_setup(setting.scenario, overrides), list[str](), list[str]()
    compensation = setup.scenario.controller.delay_compensation
    if compensation.enabled and compensation.expected_round_trip_ms is None:
        expected_ms = 1e-6 * setup.link.emulated_round_trip_ns
        instead.append(override(EXPECTED, expected_ms))
    for section, _, _ in (key.rpartition(".") for key in setting.quantity.keys):
        direction = section.removeprefix("link.")
        channel: ChannelConfiguration = getattr(setup.scenario.link, direction)
        if channel.trace is not None:
            return {}
        files.append(str(folder / f"{name}-{direction}.csv"))
        write_whole(Path(files[-1]), _delays(channel, setup))
        others = [
            {key: value for key, value in plain(entry).items() if key != "delay_ms"}
            for entry in channel.schedule
        ]
        trace = {"file": files[-1], "start_s": 0.0, "loop": False}
        given = {"delay_ms": 0.0, "pattern": None, "schedule": others, "trace": trace}
        instead += [override(f"{section}.{key}", value) for key, value in given.items()]
    command = command_of(setting, [*overrides, *instead], row)
    return {"traces": files, "trace_command": command}


def _delays(channel: ChannelConfiguration, setup: Setup) -> str:
    """Return the delays of a direction as CSV: a row for each change, and one for the end."""
    schedule, step_ns = ConditionsSchedule(channel), setup.grid.period_ns // _PER_TICK
    times_ns = range(0, (setup.ticks + 1) * setup.grid.period_ns + 1, step_ns)
    delays_ns = [(time_ns, round(schedule.at(time_ns).delay_ns)) for time_ns in times_ns]
    changes = [next(group) for _, group in itertools.groupby(delays_ns, key=lambda row: row[1])]
    rows = dict.fromkeys([*changes, delays_ns[-1]])
    lines = [f"{1e-9 * time_ns:.9f},{1e-6 * delay_ns:.9f}" for time_ns, delay_ns in rows]
    return "\n".join(["time_s,delay_ms", *lines, ""])
