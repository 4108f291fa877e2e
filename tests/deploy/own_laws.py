"""Laws of a user's own, in modules of a folder."""

from __future__ import annotations

from pathlib import Path

LAW = '''\
import numpy as np
from funnel_hil import Diagnostics


class Own:
    """Holds the arm up; after some ticks it does what is to be tested."""

    def __init__(self, model, at_tick=0):
        self.diagnostics, self.model = Diagnostics(model.joints), model
        self.calls, self.at_tick = 0, at_tick

    def reset(self):
        self.calls = 0

    def torque(self, tracking):
        self.calls += 1
        if self.calls > self.at_tick:
            DOES
        return self.model.gravity(tracking.position)
'''


def own_law(folder: Path, does: str, name: str = "own_law") -> str:
    """Write a law that does something in the end; what a scenario calls it."""
    (folder / f"{name}.py").write_text(LAW.replace("DOES", does.replace("\n", "\n" + 12 * " ")))
    return f"{name}:Own"
