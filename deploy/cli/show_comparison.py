"""What people see of a comparison in the terminal."""

from __future__ import annotations

from rich.console import Console

from deploy.comparison.comparison import Comparison
from deploy.comparison.settling import SettlingTest
from deploy.reports.compare_tables import joint_table, verdict_table
from deploy.reports.quantities import RMS_ERROR
from deploy.reports.tables import number
from deploy.reports.terminal import print_table


def settling_sentence(test: SettlingTest) -> str:
    """How a law settled from near and far."""
    times = [row.settling_time_s for row in test.rows]
    known = [time for time in times if time is not None]
    farthest = number(max((row.distance_rad for row in test.rows), default=None))
    bound = "" if test.bound_s is None else f", bound {number(test.bound_s)} s"
    slowest = f", at most {number(max(known))} s" if known else ""
    return (
        f"{test.law}: settled from {len(known)} of {len(times)} starts of up to {farthest} rad"
        f"{slowest}{bound}"
    )


def show_comparison(console: Console, comparison: Comparison) -> None:
    """The result as two tables: what decides, and the RMS errors joint by joint."""
    if not comparison.runs:
        console.print("no law was run")
        return
    print_table(console, verdict_table(comparison))
    print_table(console, joint_table(comparison, RMS_ERROR))
