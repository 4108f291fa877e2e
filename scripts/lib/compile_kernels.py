"""Has the numerical kernels compiled into their cache, unless these sources have one already."""

from __future__ import annotations

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from bus_schema.runtime import compiled  # noqa: F401 (chooses where the cache is)
from bus_schema.runtime.kernel_cache import FOLDER
from controller.laws import LAWS

SHORT = "duration_s=0.01"
USUAL = "fixed_time_adaptive"
COMPENSATED = ["controller.delay_compensation.enabled=true"]
OVER_CAN = ["link.kind=can", "link.can.interface=virtual", "rate_hz=500"]


def main() -> None:
    """Simulate a few ticks with every law, with delay compensation, and over CAN.

    With ``--usual``, of the default law alone, and not over CAN.
    """
    folder = os.environ.get(FOLDER)
    is_usual = "--usual" in sys.argv
    done = [Path(folder or "") / f"{name}.done" for name in ("all", "usual")[: 1 + is_usual]]
    if folder is None or any(each.exists() for each in done):
        return
    if is_usual:
        print("Compiling the numerical kernels, once (up to a minute)", flush=True)
    from deploy.run.simulate import simulate
    from deploy.scenario.scenario import load_setup

    for law in [USUAL] if is_usual else LAWS:
        simulate(load_setup("paper_arm", [SHORT, f"controller.law={law}"]))
    for overrides in (COMPENSATED,) if is_usual else (COMPENSATED, OVER_CAN):
        simulate(load_setup("paper_arm", [SHORT, *overrides]))
    done[-1].touch()


if __name__ == "__main__":
    main()
