"""What a recorded message costs, beside the bare MCAP writer with the same settings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from mcap.writer import CompressionType, Writer

from bus_schema.messages.topics import Topic
from bus_schema.recording.mcap_log import McapLog
from deploy.benchmarks.measure import Section, cost_us, interleave, ratio
from deploy.runs.simulate import simulate
from deploy.scenario.scenario import load_setup

RECORDING, BARE = "recorded message", "message of the bare MCAP writer"
_BYTES_PER_S = 4e6
_CHUNK_BYTES = 256 * 1024


def measure_recorder(scenario: str, seconds: float, repetitions: int) -> Section:
    """Measure the messages of a scenario.

    Args:
        scenario: name or path.
        seconds: length on the run's clock of the run whose messages are written.
        repetitions: how often everything is measured.
    """
    run = simulate(load_setup(scenario, [f"duration_s={seconds}"]))
    messages = list(zip(run.topics, run.payloads, strict=True))
    with TemporaryDirectory() as folder:
        file = Path(folder) / "run.mcap"
        costs = interleave(
            {
                RECORDING: lambda: recorded_us(messages, file),
                BARE: lambda: bare_us(messages, file),
            },
            repetitions,
        )
    per_second = 1e6 / costs[RECORDING].median
    return Section(
        "Recorder", costs, [ratio(costs, RECORDING, BARE)],
        [f"{per_second:,.0f} messages a second in this run, files closed included."],
    )  # fmt: skip


def recorded_us(messages: Sequence[tuple[Topic, bytes]], file: Path) -> float:
    """Cost of a message written through our log."""

    def write() -> None:
        log = McapLog(file, _BYTES_PER_S)
        for sequence, (topic, payload) in enumerate(messages):
            log.write(topic, sequence, sequence, sequence, payload)
        log.close()

    return cost_us(write, 1) / len(messages)


def bare_us(messages: Sequence[tuple[Topic, bytes]], file: Path) -> float:
    """Cost of a message written through the library's writer alone."""
    names = {topic.name for topic, _ in messages}

    def write() -> None:
        with file.open("wb") as stream:
            writer = Writer(stream, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD)
            writer.start()
            channels = {name: writer.register_channel(name, "cdr", 0) for name in names}
            for sequence, (topic, payload) in enumerate(messages):
                writer.add_message(channels[topic.name], sequence, payload, sequence, sequence)
            writer.finish()  # type: ignore[no-untyped-call]

    return cost_us(write, 1) / len(messages)
