"""Many short runs in a row: of each, nothing may be left but its folder.

`python -m scripts.benchmarks.leftovers [--runs 200]`: runs in lockstep, each at the ports of the
one before. Looked for are files in TMPDIR and in /dev/shm, ports in use, and processes they
started.
"""

from __future__ import annotations

import argparse
import os
import socket
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

from deploy.run.network.links import free_ports

_MARK = "FUNNEL_HIL_LEFTOVERS"
_SHORT = ("clock=lockstep", "duration_s=0.05", "metrics.from_s=0")
_SHARED = Path("/dev/shm")


def run_and_look(runs: int, folder: Path) -> list[str]:
    """Do so many runs below `folder`; a line for all that is left behind but run folders."""
    temporary, results = folder / "tmp", folder / "runs"
    temporary.mkdir()
    mark = f"{_MARK}={folder}"
    environment = {**os.environ, "TMPDIR": str(temporary), _MARK: str(folder)}
    shared, ports = _entries(_SHARED), free_ports(2)
    values = [*_SHORT]
    for role, port in zip(("plant", "controller"), ports, strict=True):
        values.append(f"link.{role}_endpoint=tcp/127.0.0.1:{port}")
    found = []
    for number in range(runs):
        words = ["run", "paper_arm", "--no-report", "--out", str(results / str(number))]
        words += [word for value in values for word in ("--set", value)]
        command = [sys.executable, "-m", "deploy.cli", *words]
        ended = subprocess.run(command, env=environment, capture_output=True, text=True)
        if ended.returncode:
            found.append(f"run {number} ended with {ended.returncode}: {ended.stderr[-500:]}")
    found += [f"file {name}" for name in sorted(_entries(temporary))]
    found += [f"shared memory {name}" for name in sorted(_entries(_SHARED) - shared)]
    found += [f"process {line}" for line in processes_with(mark)]
    found += [f"port {port}" for port in ports if not _is_free(port)]
    expected = {str(number) for number in range(runs)}
    found += [f"beside run folders {name}" for name in sorted(_entries(results) - expected)]
    return found


def _entries(folder: Path) -> set[str]:
    return {entry.name for entry in folder.iterdir()} if folder.is_dir() else set()


def processes_with(mark: str) -> list[str]:
    """Ids and command lines of living processes with this in their environment."""
    lines = []
    for entry in Path("/proc").iterdir():
        with suppress(OSError):
            if entry.name.isdigit() and mark.encode() in (entry / "environ").read_bytes():
                words = (entry / "cmdline").read_bytes().decode(errors="replace")
                lines.append(f"{entry.name} {' '.join(words.split(chr(0)))}")
    return lines


def _is_free(port: int) -> bool:
    with socket.socket() as listener:
        # A closed connection may wait for a minute, but the port can be used again.
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True


def main() -> None:
    """Run, and show what is left; exit code 1 if anything is."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--runs", type=int, default=200)
    runs = parser.parse_args().runs
    with tempfile.TemporaryDirectory() as scratch:
        found = run_and_look(runs, Path(scratch))
    for line in found:
        print(f"left behind: {line}")
    print(f"{runs} runs, {len(found)} things left behind but their folders")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
