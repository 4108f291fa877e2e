"""The table of positions over networks: a UR5e with `servoj` on each shipped trace, as simulated.

`python -m scripts.experiments.positions_over_networks` makes all runs and writes the table into its
page. Runs are in virtual time, so it is the same on every machine.
"""

from __future__ import annotations

import logging
from pathlib import Path

from deploy.judge.metrics import summarise
from deploy.run.simulate import simulate
from deploy.scenario.referenced_files import TRACES
from deploy.scenario.scenario import load_setup

BEGIN = "<!-- networks: python -m scripts.experiments.positions_over_networks -->\n"
END = "<!-- end of networks -->\n"
_HEADER = """\
| network | verdict | tip error, RMS | largest |
|---|---|---|---|
"""
PAGE = Path(__file__).resolve().parents[2] / "deploy" / "docs" / "how-to" / "robot-interfaces.md"
_GIVEN = (
    "controller.law=position_correction", "plant.interface.kind=servoj", "duration_s=6",
    "robot.initial_offset_rad=0",
)  # fmt: skip


def table() -> str:
    """Return the table, a row per network."""
    networks = sorted(file.stem for file in TRACES.glob("*.parquet"))
    return _HEADER + "".join(map(_row, networks))


def _row(network: str) -> str:
    """Return the row of a network: a run whose messages take the delays of its trace, both ways."""
    trace = f"trace={{file: {network}, start_s: 0}}"
    links = (f"link.{way}.{trace}" for way in ("uplink", "downlink"))
    summary = summarise(simulate(load_setup("ur5e_motors", [*_GIVEN, *links])).data())
    tip_mm = summary["tip_error_mm"]
    verdict, rms_mm, largest_mm = summary["verdict"], tip_mm["rms"], tip_mm["largest"]
    return f"| `{network}` | {verdict} | {rms_mm:.2f} mm | {largest_mm:.1f} mm |\n"


def main() -> None:
    """Write the table into its page."""
    logging.disable()
    text = PAGE.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    _, after = rest.split(END)
    PAGE.write_text(f"{before}{BEGIN}{table()}{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
