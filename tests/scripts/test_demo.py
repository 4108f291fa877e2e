"""scripts/demo: what it adds to the command that it runs, which is nothing."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

DEMO = Path(__file__).resolve().parents[2] / "scripts" / "demo"
COMMAND = """#!/bin/sh
mkdir -p "$4" && touch "$4/report.html"
echo "$1 $2 $3 report: $4/report.html $5"
exit 3
"""


def test_report_is_printed_once_and_the_exit_code_passed_on(tmp_path: Path) -> None:
    library = tmp_path / "scripts" / "lib" / "venv.sh"
    library.parent.mkdir(parents=True)
    library.write_text("ensure_venv() { :; }\nwhile_it_lasts() { :; }\n")
    demo = shutil.copy(DEMO, tmp_path / "scripts")
    command = tmp_path / ".venv" / "bin" / "funnel-hil"
    command.parent.mkdir(parents=True)
    command.write_text(COMMAND)
    command.chmod(0o755)
    ran = subprocess.run([demo, "--live"], capture_output=True, text=True, check=False)
    assert ran.returncode == 3, ran.stderr
    (report,) = (tmp_path / "runs").glob("demo-*/report.html")
    assert ran.stdout == f"run paper_arm --out report: {report} --live\n"
