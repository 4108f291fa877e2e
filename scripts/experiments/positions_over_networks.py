"""The table of positions over networks: how far a robot's joints and tip are behind.

    python -m scripts.experiments.positions_over_networks [--arm ur5e_motors] [--kind servoj]
        [--law position_correction] [--networks A,B] [--starts S,S] [--duration S] [--workers N]

Each link is none, a round trip of 40 ms, or a shipped trace in both directions. It is simulated
without preview and with ``controller.preview_ms: auto``; the worst of the starts on a trace counts.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial
from multiprocessing import get_context
from typing import Any

from deploy.run.execute import InProcess
from deploy.scenario.referenced_files import TRACES
from deploy.scenario.scenario import load_setup

PREVIEWS = ("0", "auto")
HEADING = (
    "| link | preview | verdicts | tip, RMS, mm | tip, largest, mm | largest lag of a joint, ms |"
)


def links(networks: Sequence[str], starts: Sequence[str]) -> dict[str, list[list[str]]]:
    """Return the settings of the runs of each link."""
    sides = "uplink", "downlink"
    found: dict[str, list[list[str]]] = {
        "none": [[]],
        "40 ms": [[f"link.{side}.delay_ms=20" for side in sides]],
    }
    for network in networks:
        found[network] = [
            [f"link.{side}.trace={{file: {network}, start_s: {start}}}" for side in sides]
            for start in starts
        ]
    return found


def outcome(common: Sequence[str], words: Sequence[str]) -> dict[str, Any]:
    """Return the summary of a run; the first word of the common ones is the arm."""
    arm, *settings = common
    return InProcess().run(load_setup(arm, [*settings, *words]), None).summary


def row(link: str, preview: str, summaries: Sequence[dict[str, Any]]) -> str:
    """Return a line of the table: the worst of the runs."""
    verdicts = [each["verdict"] for each in summaries]
    kept = f"{verdicts.count('kept')} of {len(verdicts)} kept"
    tips = [each["tip_error_mm"] for each in summaries]
    rms, largest = (max(each[name] for each in tips) for name in ("rms", "largest"))
    lags = [each for summary in summaries for each in summary["lag_ms"] if each is not None]
    cells = (link, preview, kept, f"{rms:.2f}", f"{largest:.2f}", f"{max(lags, key=abs):.1f}")
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Simulate what is asked for, and print the table as the simulations end."""
    parser = argparse.ArgumentParser(description=__doc__)
    shipped = ",".join(sorted(file.stem for file in TRACES.glob("*.parquet")))
    parser.add_argument("--arm", default="ur5e_motors")
    parser.add_argument("--kind", default="servoj")
    parser.add_argument("--law", default="position_correction")
    parser.add_argument("--networks", default=shipped)
    parser.add_argument("--starts", default="0,15,30")
    parser.add_argument("--duration", type=float, default=6.0)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    common = [
        given.arm, f"plant.interface.kind={given.kind}", f"controller.law={given.law}",
        f"duration_s={given.duration}", "plant.command_timeout_ms=1000",
    ]  # fmt: skip
    print(f"{HEADING}\n|{'---|' * HEADING.count(' | ')}---|")
    with get_context("spawn").Pool(given.workers) as pool:
        for link, runs in links(given.networks.split(","), given.starts.split(",")).items():
            for preview in PREVIEWS:
                words = [[*run, f"controller.preview_ms={preview}"] for run in runs]
                found = pool.map(partial(outcome, common), words)
                print(row(link, preview, found), flush=True)


if __name__ == "__main__":
    main()
