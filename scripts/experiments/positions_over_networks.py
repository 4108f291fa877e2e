"""The table of positions over networks: a UR5e with `servoj` on each shipped trace, as simulated.

`python -m scripts.experiments.positions_over_networks` makes all runs and writes the table into its
page. Runs are in virtual time, so it is the same on every machine.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

from deploy.judge.metrics import summarise
from deploy.run.simulate import simulate
from deploy.scenario.referenced_files import TRACES
from deploy.scenario.robot_interface import preview_s
from deploy.scenario.scenario import load_setup

BEGIN = "<!-- networks: python -m scripts.experiments.positions_over_networks -->\n"
END = "<!-- end of networks -->\n"
_HEADER = """\
| network | preview | verdicts | tip error, RMS | largest | largest `lag_ms` |
|---|---|---|---|---|---|
"""
PAGE = Path(__file__).resolve().parents[2] / "deploy" / "docs" / "how-to" / "robot-interfaces.md"
_STARTS_S = (0, 60)
_GIVEN = (
    "controller.law=position_correction", "plant.interface.kind=servoj", "duration_s=6",
    "robot.initial_offset_rad=0",
)  # fmt: skip


def table() -> str:
    """Return the table, a row per network."""
    networks = sorted(file.stem for file in TRACES.glob("*.parquet"))
    return _HEADER + "".join(map(_row, networks))


def _row(network: str) -> str:
    """Return the row of a network: the worst of its windows."""
    runs = [_run(network, start_s) for start_s in _STARTS_S]
    verdicts = ", ".join(each["verdict"] for each in runs)
    rms_mm, largest_mm = (
        max(each["tip_error_mm"][key] for each in runs) for key in ("rms", "largest")
    )
    lag_ms = max(lag for each in runs for lag in each["lag_ms"] if lag is not None)
    preview_ms = runs[0]["preview_ms"]
    return (
        f"| `{network}` | {preview_ms:.0f} ms | {verdicts} | {rms_mm:.1f} mm | {largest_mm:.1f} mm"
        f" | {lag_ms:.0f} |\n"
    )


def _run(network: str, start_s: float) -> dict[str, Any]:
    """Return the summary of a run whose messages take the delays of a trace, both ways."""
    links = (
        f"link.{way}.trace={{file: {network}, start_s: {start_s}}}"
        for way in ("uplink", "downlink")
    )
    setup = load_setup("ur5e_motors", [*_GIVEN, *links])
    summary = summarise(simulate(setup).data())
    print(network, start_s, summary["verdict"], summary["tip_error_mm"], flush=True)
    return {**summary, "preview_ms": 1e3 * preview_s(setup)}


def main() -> None:
    """Write the table into its page."""
    logging.disable()
    text = PAGE.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    _, after = rest.split(END)
    PAGE.write_text(f"{before}{BEGIN}{table()}{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
