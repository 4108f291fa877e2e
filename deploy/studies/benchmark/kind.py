"""The kind of study `benchmark`."""

from __future__ import annotations

from deploy.reports.kinds import ResultKind
from deploy.studies.benchmark.benchmark import Benchmark
from deploy.studies.benchmark.numbers import GaugedBenchmark
from deploy.studies.benchmark.page import benchmark_page

KIND = ResultKind(Benchmark.kind, GaugedBenchmark, Benchmark, benchmark_page)
