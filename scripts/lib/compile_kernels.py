"""Has the numerical kernels compiled into their cache, unless these sources have one already."""

from __future__ import annotations

import os
import sys
from importlib import metadata
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from bus_schema.runtime.compiled import HAS_SAID  # its import chooses where the cache is
from bus_schema.runtime.kernel_cache import FOLDER
from controller.laws import TORQUE_LAWS

SHORT = "duration_s=0.01"
DEFAULT = "fixed_time_adaptive"
COMPENSATED = ["controller.delay_compensation.enabled=true"]
OVER_CAN = ["link.kind=can", "link.can.interface=virtual", "rate_hz=500"]


def main() -> None:
    """Simulate a few ticks with every law of torques, with delay compensation, and over CAN.

    With ``--usual``, of the law of new scenarios and that of `paper_arm`, and not over CAN.
    """
    folder = os.environ.get(FOLDER)
    is_usual = "--usual" in sys.argv
    if folder is None:
        return
    # Beside the kernels, which serve all copies of these sources, but one version of Python.
    made_by = f"{sys.implementation.cache_tag}-numba-{metadata.version('numba')}"
    kinds = ("all", "usual")[: 1 + is_usual]
    stamps = [Path(folder, f"compiled-{kind}-{made_by}") for kind in kinds]
    if any(each.is_file() for each in stamps):
        return
    if is_usual:
        print("Compiling the numerical kernels, once (up to a minute)", flush=True)
        os.environ[HAS_SAID] = "1"
    from deploy.run.simulate import simulate
    from deploy.scenario.scenario import load_setup

    laws = [[f"controller.law={law}"] for law in ([DEFAULT] if is_usual else TORQUE_LAWS)]
    others = [[], COMPENSATED] if is_usual else [COMPENSATED, OVER_CAN]
    for overrides in laws + others:
        simulate(load_setup("paper_arm", [SHORT, *overrides]))
    stamps[-1].touch()


if __name__ == "__main__":
    main()
