"""Command-line options of `benchmark`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from controller.laws import torque_laws
from deploy.cli.parts.common import parse_laws
from deploy.cli.parts.options import GateOptions, taking
from deploy.cli.parts.study_command import run_study
from deploy.cli.parts.study_options import StudyOptions, listed
from deploy.scenario.referenced_files import TRACES
from deploy.studies.benchmark.benchmark import Benchmark
from deploy.studies.benchmark.cells import (
    BENCHMARK_ARMS,
    BENCHMARK_DELAYS_MS,
    BENCHMARK_PREDICTORS,
    tuned_gains,
)


@dataclass(kw_only=True)
class BenchmarkOptions(GateOptions, StudyOptions):
    """The options of `benchmark`."""

    scenarios: Annotated[
        list[str] | None,
        typer.Argument(metavar="[ARM]…", help="Scenarios; by default four shipped ones."),
    ] = None
    laws: Annotated[
        str | None,
        typer.Option(
            metavar="A,B,…", help="Laws to run, all for the shipped ones; all by default."
        ),
    ] = None
    predictors: Annotated[
        str | None,
        typer.Option(
            metavar="A,B,…",
            help=r"none and predictors.  \[default: none, adaptive, smith,"
            " communication_disturbance_observer]",
        ),
    ] = None
    tuned: Annotated[
        list[Path] | None,
        typer.Option(metavar="DIR", help="A result of tune; give it once for each arm."),
    ] = None
    delays: Annotated[
        str | None,
        typer.Option(metavar="A,B,…", help="Rising round trips in ms, tried until the first loss."),
    ] = None
    networks: Annotated[
        str | None,
        typer.Option(metavar="A,B,…", help="Networks, or none; all shipped ones by default."),
    ] = None
    windows: Annotated[int | None, typer.Option(help="Windows of each network; default 4.")] = None
    duration: Annotated[float | None, typer.Option(help="Of each run in s; default 6.")] = None
    quick: Annotated[bool, typer.Option("--quick", help="One arm, shorter and fewer runs.")] = False

    def definition(self) -> dict[str, Any]:
        networks = sorted(file.stem for file in TRACES.glob("*.parquet"))
        chosen = _names(self.networks)
        given = {
            "scenarios": self.scenarios, "laws": parse_laws(_with_all(self.laws)),
            "predictors": _names(self.predictors), "networks": chosen,
            "delays_ms": listed("delays", self.delays), "windows": self.windows,
            "duration_s": self.duration,
        }  # fmt: skip
        usual: dict[str, Any] = {
            "scenarios": list(BENCHMARK_ARMS), "laws": list(torque_laws()),
            "predictors": list(BENCHMARK_PREDICTORS), "networks": networks,
            "delays_ms": list(BENCHMARK_DELAYS_MS),
        }  # fmt: skip
        if self.quick:
            usual |= {
                "scenarios": list(BENCHMARK_ARMS[:1]), "networks": ["wifi_crowded"], "windows": 2,
                "duration_s": 3.0, "delays_ms": [1.0, 8.0, 32.0, 64.0],
            }  # fmt: skip
        if chosen == ["none"]:
            given["networks"] = []
        found = usual | {key: value for key, value in given.items() if value is not None}
        own = {"set": self.fixed(), "gains": tuned_gains(self.tuned or [])}
        return super().definition() | found | own


def _names(text: str | None) -> list[str] | None:
    return None if text is None else [name.strip() for name in text.split(",")]


def _with_all(laws: str | None) -> str | None:
    """Return a list of laws in which the word all stands for the shipped ones of torques."""
    if laws is None:
        return None
    every = ",".join(torque_laws())
    return ",".join(every if name.strip() == "all" else name for name in laws.split(","))


@taking(BenchmarkOptions)
def benchmark(options: BenchmarkOptions) -> None:
    """Run laws and predictors alike: rising delays, patterns, networks and uncertain plants.

    With --tuned, each law also runs with the gains that `tune` found. After an interruption or a
    kill, the same command continues; with more laws (also your own), arms, predictors or plants, it
    adds their rows to those of the others.
    """
    run_study(Benchmark(options.definition(), Path("benchmark")), options)
