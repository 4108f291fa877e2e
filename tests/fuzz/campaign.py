"""The long form of the fuzzing in the tests:

``scripts/fuzz [MUTATIONS] [FILES] [FRAMES] [RECORDINGS]``.
"""

from __future__ import annotations

import resource
import sys
import tempfile
from collections import Counter
from pathlib import Path

from can_frames import CanTarget
from decoding import Target
from recordings import try_recordings
from scenarios import try_files

from tests.plant_emulator.drives.dialects import DIALECTS

_WARM_UP = 20_000
_PROGRESS = 50_000
_CHUNK = 2_000


def main(mutations=200000, files=100000, frames=20000, recordings=1000):
    """Fuzz; an assertion or any other exception ends it with a traceback, a file with code 1."""
    found = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        target = Target(seed=1, folder=folder)
        before_kib = 0
        for number in range(1, mutations + 1):
            target.attack()
            if number == _WARM_UP:
                before_kib = _peak_kib()
            if number % _PROGRESS == 0:
                print(f"{number} mutations: {dict(target.kinds)}", flush=True)
        target.close()
        print(f"accepted, and right: {target.accepted}; rejected: {dict(target.rejected)}")
        print(f"memory after the first {_WARM_UP}: {_peak_kib() - before_kib:+d} KiB")
        for protocol in DIALECTS:
            drives = CanTarget(protocol, 1, folder)
            for _ in range(frames):
                drives.attack()
            print(f"{protocol}: {frames} mutated frames, {drives.commanded} of them torques that")
            print(f"  acted as their torque; rejected: {dict(drives.reasons)}")
        print(f"damaged recordings: {dict(try_recordings(recordings, 3, folder))}")
        for kind in ("scenario", "urdf"):
            found += try_and_tell(kind, files // 2, folder)
    sys.exit(found > 0)


def try_and_tell(kind: str, files: int, folder: Path) -> int:
    """Try mutated files in chunks, and tell of those that found something; how many did."""
    counts: Counter[str] = Counter()
    for first in range(0, files, _CHUNK):
        outcomes = try_files(kind, range(first, min(first + _CHUNK, files)), 2, folder)
        counts += outcomes.counts
        print(f"{kind} files: {dict(counts)}", flush=True)
        for number, text in outcomes.findings.items():
            print(f"{kind} {number}: {text}", flush=True)
    return counts["finding"]


def _peak_kib() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
