"""What a process says to `run`, a JSON line each, whichever of its threads says it."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
THREADS, SENTENCES = 4, 2000
SPEAKER = f"""
import sys, threading
from bus_schema.messages.topics import Role
from deploy.processes.status import StatusReporter

reporter = StatusReporter(Role.PLANT, to_parent=sys.stdout)

def speak(thread):
    for number in range({SENTENCES}):
        reporter.report("note", text=f"{{thread}} {{number}}")

sys.setswitchinterval(1e-6)
threads = [threading.Thread(target=speak, args=(thread,)) for thread in range({THREADS})]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
"""


def test_threads_that_speak_at_once_do_not_break_into_each_others_lines() -> None:
    said = subprocess.run(
        [sys.executable, "-c", SPEAKER], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout
    heard = Counter(json.loads(line)["text"].split()[0] for line in said.splitlines())
    # With print, whose end of line is a write of its own, one line in ten broke.
    assert heard == {str(thread): SENTENCES for thread in range(THREADS)}
