"""Traces are replayed in time order, and what the channel did is compared with them."""

from pathlib import Path

import numpy as np
import pytest

from bus_schema.link.channel_configuration import ChannelConfiguration, TraceConfiguration
from bus_schema.link.configuration import LinkConfiguration
from plant_emulator.channel.channel import NEVER_NS, Channel, TracedChannel
from plant_emulator.channel.impairment import ImpairedChannel
from plant_emulator.channel.opening import open_downlink, open_uplink
from plant_emulator.channel.trace import TraceReplay, curves
from plant_emulator.channel.trace_file import LOST_NS
from plant_emulator.command_gate import Command

MS = 1_000_000
ROWS = [(0, "1"), (10, "3"), (20, ""), (30, "5"), (40, "2")]


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Five messages, 10 ms apart, of which the third is lost."""
    path = tmp_path / "trace.csv"
    lines = [f"{time_ms / 1e3},{delay}" for time_ms, delay in ROWS]
    path.write_text("\n".join(["time_s,delay_ms", *lines, ""]))
    return path


def uplink(file: Path, seed: int = 1, *, channel: dict | None = None, **trace: object) -> Channel:
    given = {"file": str(file), **trace}
    return open_uplink(LinkConfiguration(uplink={**(channel or {}), "trace": given}), seed)


def delays_ms(channel: Channel, count: int, period_ms: int = 5) -> list[float | None]:
    """Delay of each message, None for losses."""
    for number in range(count):
        channel.send(number, number * period_ms * MS, 100)
    out = {
        number: due_ns / MS - number * period_ms
        for due_ns, number in channel.take_due(NEVER_NS - 1)
    }
    return [out.get(number) for number in range(count)]


def test_delays_are_held_from_one_message_to_the_next(file: Path) -> None:
    found = delays_ms(uplink(file, start_s=0), 10)
    assert found == [1, 1, 3, 3, None, None, 5, 5, 2, 2]


def test_delays_lie_on_a_line_between_messages_that_arrived(file: Path) -> None:
    found = delays_ms(uplink(file, start_s=0, interpolation="linear"), 10)
    assert found == [1, 2, 3, 3, None, None, 5, 3.5, 2, 2]


def test_scale_and_offset_come_on_top_of_the_delay_of_the_channel(file: Path) -> None:
    found = delays_ms(uplink(file, channel={"delay_ms": 1}, start_s=0, scale=2, offset_ms=-3.5), 10)
    assert found == [0, 0, 3.5, 3.5, None, None, 7.5, 7.5, 2.5, 1.5]


def test_trace_repeats_from_its_end_and_starts_where_it_is_set(file: Path) -> None:
    assert delays_ms(uplink(file, start_s=0.03), 8, 10) == [5, 2, 1, 3, None, 5, 2, 1]


def test_start_is_drawn_from_the_seed(file: Path) -> None:
    drawn = [delays_ms(uplink(file, seed), 8) for seed in range(12)]
    assert drawn[3] == delays_ms(uplink(file, 3), 8)
    assert len({tuple(each) for each in drawn}) > 3


def test_directions_draw_different_starts(file: Path) -> None:
    link = LinkConfiguration(
        uplink={"trace": {"file": str(file)}}, downlink={"trace": {"file": str(file)}}
    )
    pairs = [(open_uplink(link, seed), open_downlink(link, seed)) for seed in range(12)]
    assert any(delays_ms(up, 8) != delays_ms(down, 8) for up, down in pairs)


def test_messages_overtake_only_where_they_may(tmp_path: Path) -> None:
    file = tmp_path / "trace.csv"
    file.write_text("time_s,delay_ms\n0,30\n0.01,1\n0.02,1\n")
    waiting = delays_ms(uplink(file, start_s=0), 3, 10)
    assert waiting == [30, 20, 10]
    overtaking = uplink(file, start_s=0, channel={"reorder": True})
    assert delays_ms(overtaking, 3, 10) == [30, 1, 1]
    assert overtaking.statistics().summary()["reordered"] == 1


def test_both_channels_with_a_trace_do_the_same(file: Path) -> None:
    alone = uplink(file, 5)
    beside = uplink(file, 5, channel={"loss": 1e-12})
    assert type(alone) is TracedChannel
    assert type(beside) is ImpairedChannel
    assert delays_ms(alone, 500, 3) == delays_ms(beside, 500, 3)
    assert alone.mean_delay_ns == beside.mean_delay_ns == 2_750_000
    assert alone.statistics().summary() == beside.statistics().summary()


def test_trace_leaves_what_others_draw_as_it_was(file: Path) -> None:
    noisy = {"jitter_ms": 0.5, "delay_ms": 3, "reorder": True}
    with_trace = delays_ms(uplink(file, channel=noisy, start_s=0, scale=0, offset_ms=1), 200)
    without = delays_ms(open_uplink(LinkConfiguration(uplink=noisy), 1), 200)
    pairs = zip(with_trace, without, strict=True)
    assert {round(a - b, 6) for a, b in pairs if a is not None} == {1.0}


def test_curves_say_what_the_channel_did_beside_the_trace(tmp_path: Path) -> None:
    file = tmp_path / "trace.csv"
    wave = 5 + 4 * np.sin(np.arange(2000) * 2 * np.pi / 400)
    rows = [f"{number / 100},{delay:.3f}" for number, delay in enumerate(wave)]
    file.write_text("\n".join(["time_s,delay_ms", *rows, ""]))
    channel = uplink(file, start_s=0)
    delays_ms(channel, 2000, 10)
    both = channel.statistics().summary()["curves"]
    assert both["did"]["percentiles_ms"] == both["trace"]["percentiles_ms"]
    np.testing.assert_allclose(
        both["did"]["autocorrelation"], both["trace"]["autocorrelation"], atol=0.02
    )
    assert max(both["did"]["lags_s"]) == 1.0
    at_one_s = both["trace"]["autocorrelation"][-1]
    assert at_one_s == pytest.approx(np.cos(2 * np.pi * 100 / 400), abs=0.05)


@pytest.mark.parametrize("interpolation", ["hold", "linear"])
def test_sampled_trace_is_the_replay_from_its_begin(tmp_path: Path, interpolation: str) -> None:
    random = np.random.default_rng(3)
    times_s = np.sort(random.integers(0, 400, 200)) / 100  # some at one time
    cells = [f"{each:.3f}" if each < 7.0 else "" for each in random.uniform(0.0, 8.0, 200)]
    file = tmp_path / "trace.csv"
    rows = [f"{time_s},{cell}" for time_s, cell in zip(times_s, cells, strict=True)]
    file.write_text("\n".join(["time_s,delay_ms", *rows, ""]))
    given = {"file": str(file), "scale": 1.3, "offset_ms": -2.0, "interpolation": interpolation}
    begin = TraceConfiguration(**given, start_s=0.0, loop=False)
    replay = TraceReplay(begin, np.random.default_rng(0))
    found = TraceReplay(TraceConfiguration(**given), np.random.default_rng(0)).sampled(3 * MS)
    one_by_one = [replay.delay_ns(number * 3 * MS) for number in range(len(found))]
    assert len(found) > 1000
    assert found.tolist() == [LOST_NS if each is None else max(0, each) for each in one_by_one]


def test_curves_of_equal_delays_or_of_none_are_empty() -> None:
    equal = curves(np.full(100, 5 * MS), 0.01)
    assert set(equal["percentiles_ms"]) == {5.0}
    assert equal["autocorrelation"] == []
    assert curves(np.full(100, -1), 0.01)["percentiles_ms"] == []


def test_trace_without_repetition_needs_a_start(file: Path) -> None:
    with pytest.raises(ValueError, match="true unless start_s is given"):
        ChannelConfiguration(trace={"file": str(file), "loop": False})


def round_trips_ms(file: Path, seed: int, period_ms: int, count: int) -> list[float | None]:
    """From state to torque, of a controller that answers each state at once; None for losses."""
    way = {"trace": {"file": str(file)}}
    link = LinkConfiguration(uplink=way, downlink=way)
    up, down = open_uplink(link, seed), open_downlink(link, seed)
    found: list[float | None] = [None] * count
    for number in range(count):
        up.send(number, number * period_ms * MS, 100)
    for arrived_ns, number in up.take_due(NEVER_NS - 1):
        command = Command(np.zeros(1), number, number * period_ms * MS)
        down.send(command, arrived_ns, 100)
    for arrived_ns, command in down.take_due(NEVER_NS - 1):
        found[command.sequence] = (arrived_ns - command.stamp_ns) / MS
    return found


@pytest.fixture
def pings(tmp_path: Path) -> tuple[Path, np.ndarray]:
    """A trace of round trips at 100 Hz with queues that drain and with losses, and its delays."""
    random = np.random.default_rng(5)
    delays_ms, queue_ms = [], 0.0
    for _ in range(6000):
        queue_ms = max(0.0, queue_ms - 10.0)
        queue_ms += random.uniform(60.0, 120.0) if random.random() < 0.003 else 0.0
        is_lost = random.random() < 0.02
        delays_ms.append(np.nan if is_lost else 4.0 + random.exponential() + queue_ms)
    file = tmp_path / "pings.csv"
    rows = [f"{0.01 * n},{'' if np.isnan(d) else d}" for n, d in enumerate(delays_ms)]
    file.write_text("\n".join(["time_s,round_trip_ms", *rows]))
    return file, np.array(delays_ms)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_replayed_round_trips_are_those_measured(pings: tuple[Path, np.ndarray], seed: int) -> None:
    file, measured_ms = pings
    found = round_trips_ms(file, seed, 10, 6000)
    lost = sum(each is None for each in found)
    assert lost == pytest.approx(np.isnan(measured_ms).sum(), rel=0.1)
    replayed_ms = [each for each in found if each is not None]
    for percent in (50, 99, 99.9):
        wanted_ms = np.nanpercentile(measured_ms, percent)
        assert np.percentile(replayed_ms, percent) == pytest.approx(wanted_ms, rel=0.08)


def test_halves_of_a_round_trip_stay_together_where_the_channel_does_more(pings):
    file, _ = pings
    found = []
    for more in ({}, {"delay_ms": 1.0}):
        way = {"trace": {"file": str(file)}, "reorder": True, **more}
        link = LinkConfiguration(uplink=way, downlink={**way, "loss": 1e-9})
        up, down = open_uplink(link, 7), open_downlink(link, 7)
        up.send(0, 0, 1)
        down.send(Command(np.zeros(1), 0, 0), 50 * MS, 1)
        found.append((up.take_due(NEVER_NS - 1)[0][0], down.take_due(NEVER_NS - 1)[0][0]))
    assert found[0][1] == found[0][0] + 50 * MS
    assert found[1] == (found[0][0] + MS, found[0][1] + MS)
