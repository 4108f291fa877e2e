"""The command line on another host, which is a network namespace of this machine."""

from __future__ import annotations

import os

from scripts.experiments.two_hosts import enter
from tests.warm_process import without_report


def main() -> None:
    """A command in the namespace that the environment names."""
    enter(os.environ["HOST"])
    without_report()
