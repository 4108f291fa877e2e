"""The long form of the fuzzing in the tests:

``scripts/fuzz [MUTATIONS] [FILES] [FRAMES] [RECORDINGS]``.
"""

from __future__ import annotations

import resource
import sys
import tempfile
from pathlib import Path

from can_frames import PROTOCOLS, CanTarget
from decoding import Target
from recordings import try_recordings
from scenarios import try_scenarios

_WARM_UP = 20_000
_PROGRESS = 50_000


def main(
    mutations: int = 200_000, files: int = 300, frames: int = 20_000, recordings: int = 1_000
) -> None:
    """Fuzz; an assertion or any other exception ends it with a traceback."""
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
        for protocol in PROTOCOLS:
            drives = CanTarget(protocol, 1, folder)
            for _ in range(frames):
                drives.attack()
            print(f"{protocol}: {frames} mutated frames, {drives.commanded} of them torques that")
            print(f"  acted as what they said; rejected: {dict(drives.reasons)}")
        print(f"damaged recordings: {dict(try_recordings(recordings, 3, folder))}")
        print(f"scenario files: {dict(try_scenarios(files, 2, folder))}")


def _peak_kib() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
