"""What has no entry point is added in one file, a scenario key in two: here to a copy."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[3]
REASONS = "deploy/judge/findings/loss_reason.py"
TIP = "deploy/judge/motion/tip_error.py"
DRIVE = "plant_emulator/drives/drive.py"
ADDED = {
    "key of the plant": [
        ("plant_emulator/configuration.py", "    payload_kg: Annotated",
         "    tool_kg: float = 0.0\n"),
        ("plant_emulator/arm_plant.py", "                configuration.payload_kg,",
         "                configuration.tool_kg +\n"),
    ],
    "reason of a loss": [
        (REASONS, "    START = (", "    TIRED = 'tired', 'as one that is tired', 'made up'\n"),
        (REASONS, "            self._of_chunks() or",
         "            self._because(Reason.TIRED) or\n"),
    ],
    "figure of a run": [
        (TIP, "    rms: Annotated", "    ticks: Annotated[int | None, Column()] = None\n"),
        (TIP, "        rms: RMS of the tip", "        ticks: those that count\n"),
        (TIP, "    return TipError(rms=_MM",
         "    return TipError(ticks=len(distances_m), rms=_MM * rms_m, largest=None)\n"),
    ],
    "fault of a drive": [
        (DRIVE, '    SILENT = "silent"', '    MIRRORED = "mirrored"\n'),
        (DRIVE, "        return position_rad, velocity_rad_s",
         "        if DriveFault.MIRRORED in self._causes:\n"
         "            return -position_rad, -velocity_rad_s\n"),
    ],
}  # fmt: skip
"""Lines that add a thing: each with its file, and the line that it stands before."""
FILES = {"key of the plant": 2, "reason of a loss": 1, "figure of a run": 1, "fault of a drive": 1}
PROGRAM = """
import sys
import numpy as np
from deploy.judge.run_rows import row
from deploy.reports.verdict_texts import verdict_on_run
from deploy.run.execute import JudgedRun
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from plant_emulator.drives.fault_plan import parse_fault

def run(*overrides):
    weak = "controller.gains.pid={proportional: 1.0, integral: 0, derivative: 0.1}"
    short = ["controller.law=pid", weak, "duration_s=0.5", "metrics.from_s=0"]
    return JudgedRun("pid", simulate(load_setup("paper_arm", [*short, *overrides])).data())

light, heavy = run(), run("plant.tool_kg=1.5")
assert (light.data.true_errors_rad[1:] != heavy.data.true_errors_rad[1:]).any()
assert light.summary["tip_error_mm"]["ticks"] == 501  # both ends of 0.5 s at 1 kHz
values = row(light.result, 0)
assert values["tip_ticks_mm"] == 501, [name for name in values if "tip" in name]
assert values["loss_reason"] == "tired"  # 1 N m per rad carries nothing
assert "as one that is tired" in " ".join(verdict_on_run(light).reasons)
sys.path.append("tests/plant_emulator/drives")
from drive_bench import Bank
bench = Bank("mit", watchdog_ms=50)
bench.enable()
planned = parse_fault("mirrored:1@3s", bench.bank.node_ids)
bench.bank.inject(planned.joint, planned.fault, 0)
bench.bank.measure(np.array([0.5, 0.5, 0.5]), np.ones(3), np.zeros(3))
shown = [bench.dialect.motion(answer) for answer in bench.sample()]
assert np.allclose(shown, [[-0.5, -1.0], [0.5, 1.0], [0.5, 1.0]], atol=bench.dialect.motion_step)
"""


def test_what_is_added_in_so_many_files_works(tmp_path: Path) -> None:
    assert {what: len({file for file, *_ in lines}) for what, lines in ADDED.items()} == FILES
    for room in ("bus_schema", "controller", "plant_emulator", "deploy", "tests"):
        shutil.copytree(ROOT / room, tmp_path / room, ignore=shutil.ignore_patterns("docs"))
    for file, before, added in (line for lines in ADDED.values() for line in lines):
        text = (tmp_path / file).read_text()
        assert text.count(before) == 1, before
        (tmp_path / file).write_text(text.replace(before, added + before))
    found = subprocess.run(
        [sys.executable, "-c", PROGRAM], cwd=tmp_path, capture_output=True, text=True,
        check=False, env=os.environ | {"PYTHONPATH": str(tmp_path)},
    )  # fmt: skip
    assert found.returncode == 0, found.stderr
