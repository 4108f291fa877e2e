"""The kind of study `benchmark`."""

from __future__ import annotations

from deploy.reports.kinds import ResultKind
from deploy.studies.benchmark.benchmark import Benchmark
from deploy.studies.benchmark.page import benchmark_page
from deploy.studies.benchmark.result import BenchmarkResult

KIND = ResultKind(Benchmark.kind, BenchmarkResult, Benchmark, benchmark_page)
