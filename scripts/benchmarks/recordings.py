"""Cost of a recording: a message written, all of it read, and its report drawn.

`python -m scripts.benchmarks.recordings`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from rich.console import Console

from bus_schema.messages.topics import Topic
from bus_schema.recording.mcap_log import McapLog, read_log
from deploy.judge.metrics import judge
from deploy.reports.html import write_page
from deploy.reports.runs.run_pages import run_page
from deploy.run.execute import JudgedRun
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.studies.bench.command import show_section
from deploy.studies.bench.measure import Section, cost_us, interleave, ratio

RECORDING, BARE = "recorded message", "message of the bare MCAP writer"
READ, LIBRARY = "recording read and checked", "read by the MCAP library, chunks checked"
REPORT, SIMULATED = "report", "simulate"
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


def measure_finishing(scenario: str, seconds: float, repetitions: int) -> Section:
    """Measure what becomes of one run.

    Args:
        scenario: name or path.
        seconds: length of the run on its clock.
        repetitions: how often everything is measured.
    """
    setup = load_setup(scenario, [f"duration_s={seconds}"])
    simulation = simulate(setup)
    data = simulation.data()
    run = JudgedRun("", data, judge(data))
    with TemporaryDirectory() as folder:
        recording, report = Path(folder) / "run.mcap", Path(folder) / "report.html"
        simulation.write_log(recording)
        costs = interleave(
            {
                READ: lambda: cost_us(lambda: read_log(recording), 1),
                LIBRARY: lambda: cost_us(lambda: _read_by_library(recording), 1),
                REPORT: lambda: cost_us(lambda: write_page(report, run_page(run)), 1),
                SIMULATED: lambda: cost_us(lambda: simulate(setup), 1),
            },
            repetitions,
        )
        size_mb = report.stat().st_size * 1e-6
    ratios = [ratio(costs, READ, LIBRARY), ratio(costs, REPORT, SIMULATED)]
    notes = [f"A run of {seconds:g} s; its report has {size_mb:.1f} MB."]
    return Section(f"After a run of {setup.scenario.name}", costs, ratios, notes)


def _read_by_library(recording: Path) -> None:
    with recording.open("rb") as file:
        for _ in StreamReader(file, validate_crcs=True).records:
            pass


if __name__ == "__main__":
    show_section(Console(), measure_recorder("paper_arm", 1.5, 4))
    show_section(Console(), measure_finishing("paper_arm", 6.0, 4))
