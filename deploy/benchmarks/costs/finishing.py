"""What comes after the loop: reading a recording and drawing its report, beside what was there."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from mcap.stream_reader import StreamReader

from bus_schema.recording.mcap_log import read_log
from deploy.benchmarks.measure import Section, cost_us, interleave, ratio
from deploy.reports.run_report import write_report
from deploy.runs.judging.metrics import summarise
from deploy.runs.simulate import simulate
from deploy.scenario.scenario import load_setup

READ, LIBRARY = "recording read and checked", "read by the MCAP library, chunks checked"
REPORT, SIMULATED = "report", "simulate"


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
    summary = summarise(data)
    with TemporaryDirectory() as folder:
        recording, report = Path(folder) / "run.mcap", Path(folder) / "report.html"
        simulation.write_log(recording)
        costs = interleave(
            {
                READ: lambda: cost_us(lambda: read_log(recording), 1),
                LIBRARY: lambda: cost_us(lambda: _read_by_library(recording), 1),
                REPORT: lambda: cost_us(lambda: write_report(data, summary, report), 1),
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
