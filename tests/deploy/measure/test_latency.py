"""Known dead times and lags are recovered, and motions that do not tell them are refused."""

from __future__ import annotations

import json
import math
from functools import cache
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from mcap.writer import Writer
from pyarrow import parquet

from bus_schema.messages.types import JOINT_STATE, TYPESTORE, schema_text
from deploy.measure.latency import find_latency
from deploy.measure.mcap_series import read_fields, rows_of

MOST_ROWS = 4_000


@cache
def recorded(rate_hz, dead_ms, lag_ms, noise, *, feedback=0.0):
    """Times, held commands and noisy responses of a system with gain 0.9, in steps of 0.1 ms."""
    random, step_s = np.random.default_rng(5), 1e-4
    every, dead = round(1.0 / rate_hz / step_s), round(dead_ms * 1e-3 / step_s)
    decay = 1.0 - math.exp(-step_s / (lag_ms * 1e-3))
    rows = min(round(20.0 * rate_hz), MOST_ROWS)
    wanted = np.repeat(random.standard_normal(rows // 8 + 1), 8)[:rows]  # steps of eight rows
    held = np.zeros(dead + rows * every + 1)
    state, commands, responses = 0.0, [], []
    for row in range(rows):
        responses.append(state + 0.1 + noise * random.standard_normal())
        commands.append(wanted[row] - feedback * responses[-1])
        held[dead + row * every : dead + (row + 1) * every] = commands[-1]
        for k in range(row * every, (row + 1) * every):
            state += decay * (0.9 * held[k] - state)
    times_s = np.arange(rows) * every * step_s
    return times_s, np.array(commands), np.array(responses)


@pytest.mark.parametrize("rate_hz", [30.0, 100.0, 1000.0])
@pytest.mark.parametrize(
    ("dead_ms", "lag_ms", "feedback"),
    [(4.0, 20.0, 0.0), (35.0, 60.0, 0.3), (80.0, 15.0, 0.0)],
)
def test_known_system_is_recovered(rate_hz, dead_ms, lag_ms, feedback):
    noise = 0.002
    rows = recorded(rate_hz, dead_ms, lag_ms, noise, feedback=feedback)
    found = find_latency(*rows, 0.3, is_held=True)
    assert 1e3 * found.dead_time_s[0] == pytest.approx(dead_ms, abs=0.5)
    assert 1e3 * found.lag_s[0] == pytest.approx(lag_ms, rel=0.1)
    assert found.gain[0] == pytest.approx(0.9, rel=0.02)
    assert 1e3 * found.dead_time_s[1] < 0.5


def test_intervals_grow_with_noise() -> None:
    halves = [
        find_latency(*recorded(200.0, 20.0, 30.0, noise), 0.3, is_held=True).dead_time_s[1]
        for noise in (0.001, 0.01, 0.1)
    ]
    assert halves == sorted(halves)
    assert halves[2] > 20 * halves[0]


def test_one_sine_does_not_distinguish_dead_time_from_lag() -> None:
    times_s = np.arange(0.0, 20.0, 0.01)
    random = np.random.default_rng(1)
    response = np.sin(3.0 * (times_s - 0.05)) + 0.01 * random.standard_normal(len(times_s))
    with pytest.raises(ValueError, match="separate dead time and lag; together they are"):
        find_latency(times_s, np.sin(3.0 * times_s), response, 0.3, is_held=False)


@pytest.mark.parametrize(
    ("command", "response", "complaint"),
    [
        (np.zeros(2000), np.arange(2000.0), "never changes"),
        (np.random.default_rng(1).random(2000), np.random.default_rng(2).random(2000), "explain"),
    ],
)
def test_what_says_nothing_is_refused(command, response, complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        find_latency(np.arange(2000) * 0.01, command, response, 0.3, is_held=True)


def test_command_reads_lists_and_takes_the_longest_episode(tmp_path: Path, funnel_hil) -> None:
    times_s, command, response = recorded(100.0, 20.0, 30.0, 0.001)
    again = np.concatenate([times_s[:300], times_s])
    table = {
        "timestamp": again,
        "action": np.column_stack([np.zeros(len(again)), [*command[:300], *command]]).tolist(),
        "observation.state": [[each] for each in [*response[:300], *response]],
    }
    file = tmp_path / "episodes.parquet"
    parquet.write_table(pa.table(table), file)
    words = ("latency", file, "--time", "timestamp", "--response", "observation.state[0]")
    output = funnel_hil.output(*words, "--command", "action[1]")
    assert "2,000 rows at 100 Hz (the longest of 2 episodes)" in output
    assert "dead time: 2" in output or "dead time: 19.9" in output
    output = funnel_hil.output(*words, "--command", "actoin[1]", code=2)
    assert "did you mean action" in output
    output = funnel_hil.output(*words, "--command", "action[0]", code=2)
    assert "never changes" in output


def test_options_without_effect_are_refused(tmp_path: Path, funnel_hil) -> None:
    file = tmp_path / "log.csv"
    file.write_text("t_ms,a,b\n" + "".join(f"{n},{n % 7},{n % 5}\n" for n in range(50)))
    words = ("latency", file, "--command", "a", "--response", "b")
    output = funnel_hil.output(*words, "--out", tmp_path / "found.yaml", code=2)
    assert "must be left out without --export" in output
    output = funnel_hil.output(*words, "--time", "t_ms", "--unit", "us", code=2)
    assert "--unit us: must be left out, as by their names t_ms is in ms" in output


def write_mcap(file: Path, topics: dict[str, tuple[np.ndarray, np.ndarray]]) -> None:
    """A recording of joint states, each topic with its own times in s and efforts."""
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        text = schema_text(JOINT_STATE).encode()
        schema = writer.register_schema(JOINT_STATE, "ros2msg", text)
        joint_state = TYPESTORE.types[JOINT_STATE]
        header = TYPESTORE.types["std_msgs/msg/Header"](
            TYPESTORE.types["builtin_interfaces/msg/Time"](0, 0), ""
        )
        for topic, (times_s, efforts) in topics.items():
            channel = writer.register_channel(topic, "cdr", schema)
            for time_s, effort in zip(times_s, efforts, strict=True):
                none, log_time = np.zeros(0), round(time_s * 1e9)
                message = joint_state(
                    header, ["shoulder", "elbow"], none, none, np.array([0.0, effort])
                )
                data = bytes(TYPESTORE.serialize_cdr(message, JOINT_STATE))
                writer.add_message(channel, log_time, data, log_time)
        writer.finish()


def test_topics_with_their_own_rates_are_read_from_mcap(tmp_path: Path, funnel_hil) -> None:
    times_s, command, response = recorded(1000.0, 20.0, 30.0, 0.001)
    file = tmp_path / "robot.mcap"
    sent = times_s[::8], command[::8]  # it changes every eight rows
    write_mcap(file, {"/wanted": sent, "/found": (times_s[3::13], response[3::13])})
    names = "/wanted.effort[1]", "/found.effort[1]"
    rows = rows_of(*read_fields(file, *names), is_held=True)
    found = find_latency(*rows, 0.3, is_held=True)
    assert 1e3 * found.dead_time_s[0] == pytest.approx(20.0, abs=0.5)
    assert 1e3 * found.lag_s[0] == pytest.approx(30.0, rel=0.1)
    words = ("latency", file, "--command", "/wanted.effort[1]", "--response")
    output = funnel_hil.output(*words, "/found.effort[1]")
    assert "307 rows at 76.92 Hz" in output  # responses before the last command, 1000 Hz / 13
    for response_name, complaint in (
        ("/fuond.effort[1]", "did you mean /found"),
        ("/found.effort[2]", "/found.effort[2]: cannot be read as a number"),
        ("/found.effort", "/found.effort: cannot be read as a number"),
    ):
        output = funnel_hil.output(*words, response_name, code=2)
        assert complaint in output
    output = funnel_hil.output(*words, "/found.effort[1]", "--unit", "ms", code=2)
    assert "MCAP files have log times" in output


def test_delay_of_own_recording_is_found(tmp_path: Path, funnel_hil) -> None:
    settings = ("duration_s=2", "link.uplink.delay_ms=2", "link.downlink.delay_ms=6")
    words = [word for each in settings for word in ("--set", each)]
    funnel_hil.output("simulate", "paper_arm", *words, "--out", tmp_path / "run")
    names = "/joint_commands.effort[0]", "/joint_states.effort[0]"
    rows = rows_of(*read_fields(tmp_path / "run" / "run.mcap", *names), is_held=True)
    found = find_latency(*rows, 0.1, is_held=True)
    assert 8.0 <= 1e3 * found.dead_time_s[0] <= 9.0  # states of 1 kHz leave one tick open
    assert found.gain[0] == pytest.approx(1.0)


def delayed_rows(seed: int, dead_s: float, lag_s: float) -> tuple[np.ndarray, ...]:
    """Held commands at 30 Hz, and responses between them, exactly but for 5 % of noise."""
    random, times_s = np.random.default_rng(seed), np.arange(600) / 30.0
    commands = np.repeat(random.standard_normal(75), 8)
    responses, state, reached_s = [], 0.0, -dead_s
    for time_s in times_s:
        when_s = time_s - dead_s
        while reached_s < when_s:
            index = math.floor(reached_s * 30.0 + 1e-9)
            until_s = min((index + 1) / 30.0, when_s)
            held = commands[index] if index >= 0 else 0.0
            decay = math.exp(-(until_s - reached_s) / lag_s) if lag_s else 0.0
            state, reached_s = held + (state - held) * decay, until_s
        responses.append(0.9 * state + 0.05 * random.standard_normal())
    return times_s, commands, np.array(responses)


def test_interval_of_a_response_that_ends_between_two_rows_has_the_true_dead_time() -> None:
    """Rows 33 ms apart do not tell when in between: 95 % of intervals hold it, so 18 of 20 do."""
    inside = []
    for seed, lag_ms in zip(range(20), 10 * [0.0, 2.0], strict=True):
        dead_s = np.random.default_rng(seed).uniform(0.004, 0.080)
        found = find_latency(*delayed_rows(seed, dead_s, 1e-3 * lag_ms), 0.3, is_held=True)
        inside.append(abs(found.dead_time_s[0] - dead_s) <= found.dead_time_s[1])
        assert abs(found.lag_s[0] - 1e-3 * lag_ms) <= found.lag_s[1] + 1e-3
        assert found.dead_time_s[1] < 0.55 / 30
    assert sum(inside) >= 18


@pytest.mark.parametrize("rate_hz", [30.0, 50.0, 1000.0])
@pytest.mark.parametrize("periods", [1, 10])
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_interval_has_a_dead_time_of_whole_periods(rate_hz, periods, noise):
    """All dead times of a period give the same rows; the true one is the end of that interval."""
    random, times_s = np.random.default_rng(3), np.arange(1000) / rate_hz
    commands = np.repeat(random.standard_normal(125), 8)
    responses = np.concatenate([np.zeros(periods), commands[:-periods]])
    responses += noise * random.standard_normal(1000)
    found = find_latency(times_s, commands, responses, 12 / rate_hz, is_held=True)
    middle_s, half_s = found.dead_time_s
    assert middle_s - half_s <= periods / rate_hz <= middle_s + half_s
    assert half_s < 0.55 / rate_hz


def with_stiction(rate_hz: float, width: float) -> tuple[np.ndarray, ...]:
    """Held commands, and a joint of 43 ms and 12 ms that moves only where an error exceeds this."""
    random, step_s = np.random.default_rng(1), 1e-3
    times_s = np.arange(20_000) * step_s
    wanted = sum(
        amplitude * np.sin(frequency * times_s + phase)
        for amplitude, frequency, phase in random.uniform([0.05, 0.6, 0], [0.3, 12, 6], (6, 3))
    )
    every = round(1.0 / rate_hz / step_s)
    held = np.concatenate([np.full(43, wanted[0]), np.repeat(wanted[::every], every)])
    position, found, moves = wanted[0], [], 1.0 - math.exp(-step_s / 0.012)
    for command in held[: len(times_s)]:
        found.append(position)
        error = command - position
        position += moves * math.copysign(max(abs(error) - width, 0.0), error)
    noise = 1e-4 * random.standard_normal(len(times_s))
    return times_s[::every], wanted[::every], (np.array(found) + noise)[::every]


@pytest.mark.parametrize("rate_hz", [40.0, 100.0, 500.0])
def test_stiction_is_no_dead_time_and_lag(rate_hz: float) -> None:
    for width in (0.003, 0.03):
        found = find_latency(*with_stiction(rate_hz, width), 0.3, is_held=True)
        assert found.misfit is not None, (width, found)
    without = find_latency(*with_stiction(rate_hz, 0.0), 0.3, is_held=True)
    assert without.misfit is None
    assert 1e3 * without.dead_time_s[0] == pytest.approx(43.0, abs=1.0)
    assert 1e3 * without.lag_s[0] == pytest.approx(12.0, abs=1.0)


@pytest.mark.parametrize("rate_hz", [30.0, 100.0, 1000.0])
@pytest.mark.parametrize("counts", [0, 100])
def test_noise_and_a_coarse_encoder_are_no_misfit(rate_hz: float, counts: int) -> None:
    times_s, commands, responses = recorded(rate_hz, 35.0, 60.0, 0.002)
    if counts:
        responses = np.round(counts * responses) / counts
    assert find_latency(times_s, commands, responses, 0.3, is_held=True).misfit is None


def write_csv(file: Path, time: str, columns: tuple[np.ndarray, ...]) -> None:
    rows = (",".join(map(repr, row)) for row in zip(*(c.tolist() for c in columns), strict=True))
    file.write_text("\n".join([f"{time},wanted,angle", *rows]))


def test_command_gives_no_intervals_where_the_model_does_not_fit(tmp_path, funnel_hil) -> None:
    file = tmp_path / "sticks.csv"
    write_csv(file, "t", with_stiction(100.0, 0.01))  # the column t is found
    output = funnel_hil.output("latency", file, "--command", "wanted", "--response", "angle")
    assert "the model does not fit, so there are no intervals: what is left depends on" in output
    assert "stiction" in output
    assert "±" not in output


@pytest.mark.parametrize("held", [True, False])
def test_command_names_the_better_interpolation(tmp_path, funnel_hil, held: bool) -> None:
    times_s, commands, responses = recorded(30.0, 35.0, 60.0, 0.002)
    if not held:  # a pure delay of half a period, on lines
        responses = np.interp(times_s - 1 / 60, times_s, commands)
    write_csv(tmp_path / "log.csv", "timestamp", (times_s, commands, responses))
    words = ("latency", tmp_path / "log.csv", "--command", "wanted", "--response", "angle")
    wrong = funnel_hil.output(*words, *(["--linear"] if held else []))
    assert f"{'without' if held else 'with'} --linear the model fits better" in wrong
    right = funnel_hil.output(*words, *([] if held else ["--linear"]))
    assert "±" in right
    assert "fits better" not in right


def test_elements_have_names_of_joints(tmp_path: Path, funnel_hil) -> None:
    times_s, command, response = recorded(100.0, 20.0, 30.0, 0.001)
    file = tmp_path / "robot.mcap"
    write_mcap(file, {"/wanted": (times_s, command), "/found": (times_s, response)})
    words = ("latency", file, "--command", "/wanted.effort[elbow]", "--response")
    by_name = funnel_hil.output(*words, "/found.effort[elbow]")
    by_number = funnel_hil.output(*words, "/found.effort[1]")
    assert by_number == by_name
    output = funnel_hil.output(*words, "/found.effort[elbw]", code=2)
    assert "no element 'elbw'; there are shoulder, elbow" in output
    output = funnel_hil.output(*words, "/found.effort[0]", code=2)
    assert "never changes: the motion does not excite the system; commands are those of elbow" in (
        " ".join(output.split())
    )
    output = funnel_hil.output(*words, "/found.velocity[elbow]", code=2)
    assert "name joints, but have no such values" in " ".join(output.split())


@pytest.mark.parametrize("nested", [False, True])
def test_elements_have_names_of_a_lerobot_data_set(tmp_path: Path, funnel_hil, nested) -> None:
    times_s, command, response = recorded(100.0, 20.0, 30.0, 0.001)
    names = ["shoulder.pos", "elbow.pos"]
    reported = {"motors": names} if nested else names
    (tmp_path / "meta").mkdir()
    info = {"features": {"action": {"names": reported}, "observation.state": {"names": reported}}}
    (tmp_path / "meta" / "info.json").write_text(json.dumps(info))
    (folder := tmp_path / "data" / "chunk-000").mkdir(parents=True)
    columns = {
        name: np.column_stack([np.zeros(len(times_s)), values]).tolist()
        for name, values in (("action", command), ("observation.state", response))
    }
    parquet.write_table(pa.table({"timestamp": times_s, **columns}), folder / "file.parquet")
    words = ("latency", folder / "file.parquet", "--command", "action[elbow.pos]", "--response")
    output = funnel_hil.output(*words, "observation.state[elbow.pos]")
    assert "dead time: 2" in output or "dead time: 19.9" in output
    output = funnel_hil.output(*words, "observation.state[wrist.pos]", code=2)
    assert "no element 'wrist.pos'; there are shoulder.pos, elbow.pos" in output
