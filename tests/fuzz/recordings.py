"""Damaged recordings: none is taken for whole, and each ends in a reported error."""

from __future__ import annotations

import random
from collections import Counter
from pathlib import Path

from deploy.judge.metrics import summarise
from deploy.run.run_folder import RunFolderError, load_run
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup

_DURATION_S = 0.3
_KINDS = ("bit", "bit", "bits", "bytes", "zeros", "cut", "hole", "insertion", "tail")


def record(path: Path) -> None:
    """A real, small recording, of several chunks."""
    simulate(load_setup("paper_arm", [f"duration_s={_DURATION_S}"])).write_log(path)


def damage(whole: bytes, chance: random.Random) -> tuple[str, bytes]:
    """A recording after what disks, copies and people do to files; and what that was."""
    data = bytearray(whole)
    place = chance.randrange(len(data))
    some = chance.randint(1, 400)
    kind = chance.choice(_KINDS)
    match kind:
        case "bit":
            data[place] ^= 1 << chance.randrange(8)
        case "bits":
            for _ in range(chance.randint(2, 8)):
                data[chance.randrange(len(data))] ^= 1 << chance.randrange(8)
        case "bytes":
            data[place : place + 8] = chance.randbytes(len(data[place : place + 8]))
        case "zeros":
            data[place : place + some] = bytes(len(data[place : place + some]))
        case "cut":
            del data[place:]
        case "hole":
            del data[place : place + some]
        case "insertion":
            data[place:place] = chance.randbytes(some)
        case "tail":
            data += chance.randbytes(some)
    return kind, bytes(data)


def try_recordings(count: int, seed: int, folder: Path) -> Counter[str]:
    """Damage a recording in so many ways; how often it was refused, or judged as damaged."""
    chance, outcomes = random.Random(seed), Counter[str]()
    path = folder / "run.mcap"
    record(path)
    whole = path.read_bytes()
    data, contents = load_run(path)
    assert data.complete
    assert not data.damage
    for _ in range(count):
        kind, changed = damage(whole, chance)
        if changed == whole:
            outcomes["unchanged"] += 1
            continue
        path.write_bytes(changed)
        try:
            judged, read = load_run(path)
        except RunFolderError as error:
            assert "damaged" in str(error), (kind, str(error))
            outcomes["refused"] += 1
            continue
        summary = summarise(judged)
        assert not judged.complete, kind
        assert judged.damage, kind
        assert not summary["completed"], kind
        assert summary["recording"]["damage"][: len(judged.damage)] == judged.damage
        intact = all(read.payloads[name] == each for name, each in contents.payloads.items())
        outcomes["judged, all messages there" if intact else "judged as far as can be read"] += 1
    return outcomes
