"""Hostile files of every kind, given to every command that reads them.

    python tests/fuzz/hostile.py [SEED]

Each has to end within 10 s and 1 GiB, without a traceback or a signal, with exit code 2 and one
sentence where it is refused. Prints a line for each that does not, and a table by kind.
"""

from __future__ import annotations

import gc
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NoReturn

from bus_schema.link.can_configuration import CIA402_EDS
from deploy import cli
from deploy.cli.commands import COMMANDS, LazyCommand
from deploy.scenario.scenario import SHIPPED

_SECONDS, _BYTES = 10.0, 1 << 30
_SHORT = "extends: paper_arm\nduration_s: 0.02\n"
_ARM = Path("deploy/robots/paper_arm.urdf").resolve()
_SHAPE = '<visual><geometry><mesh filename="{}"/></geometry></visual></link>'
_VALID = {
    ".yaml": _SHORT.encode(),
    ".urdf": _ARM.read_bytes(),
    ".xacro": _ARM.read_bytes(),
    ".xml": b"<mujoco><worldbody><body><joint/><geom size='1'/></body></worldbody></mujoco>",
    ".csv": b"time_s,base_yaw.position_rad,shoulder.position_rad,elbow.position_rad\n"
    b"0,0,0,0\n9,0,0,0\n",
    ".obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    ".stl": b"x" * 80 + b"\x01\0\0\0" + bytes(50),
    ".dae": b"<COLLADA><library_geometries/></COLLADA>",
    ".txt": b"1.0\n2.0\n",
    ".eds": CIA402_EDS.read_bytes(),
    ".json": b'{"kind": "run", "completed": true, "faults": [], "bounds": {"kept": true}}',
}
_RUN = "simulate", "given.yaml", "--no-report", "--out", "out"
COMMAND_OF = {
    "scenario.yaml": ["simulate", "{}", "--no-report", "--out", "out"],
    "reference of.yaml": ["reference", "{}", "--csv", "reference.csv"],
    "sweep.yaml": ["sweep", "{}", "--workers", "1", "--out", "out"],
    "compare.yaml": ["compare", "{}", "--laws", "pid", "--out", "out"],
    "arm.urdf": ["robot", "{}"],
    "arm.xacro": ["robot", "{}"],
    "arm.xml": ["robot", "{}"],
    "arm of a scenario.urdf": [*_RUN, "--set", "robot.urdf={}"],
    "mesh.obj": ["robot", "shaped.urdf", "--picture", "p.png"],
    "mesh.stl": ["robot", "shaped.urdf", "--picture", "p.png"],
    "mesh.dae": ["robot", "shaped.urdf", "--picture", "p.png"],
    "motion.csv": [*_RUN, "--set", "reference={{kind: csv, file: '{}'}}"],
    "delays.txt": [*_RUN, "--set",
                   "link.uplink={{distribution: empirical, distribution_file: '{}'}}"],
    "drive.eds": [*_RUN, "--set", "link.kind=can", "--set", "link.can.interface=virtual",
                  "--set", "link.can.eds={}"],
    "authority.crt": ["record", "given.yaml", "--set", "link.security.enabled=true",
                      "--set", "link.security.folder={0.parent}"],
    "run/run.mcap": ["report", "run"],
    "exported/run.mcap": ["export", "exported", "--out", "tables"],
    "run/summary.json": ["report", "run"],
    "runs/r/summary.json": ["runs", "list", "runs"],
    "runs/r/manifest.json": ["runs", "list", "runs"],
    "runs/r/tags.json": ["runs", "list", "runs"],
    "study/study.yaml": ["report", "study"],
    "compared/summary.json": ["report", "compared"],
}  # fmt: skip


def _damaged(valid: bytes, random_: random.Random) -> bytes:
    content = bytearray(valid)
    for _ in range(3):
        place = random_.randrange(len(content))
        content[place : place + random_.randrange(4)] = random_.randbytes(random_.randrange(6))
    return bytes(content)


def hostile(path: Path, seed: int) -> Iterator[tuple[str, Callable[[], object]]]:
    """What may lie at a path: a name, and what puts it there."""
    valid = _VALID.get(path.suffix, b"[1]\nDataType=-7\n")
    texts = {
        "empty": b"", "NUL": bytes(1000), "no UTF-8": b"\xff\xfe" * 500, "long": b"a" * 25_000_000,
        "deep JSON": b"[" * 100_000, "deep object": b'{"a":' * 90_000 + b"1" + b"}" * 90_000,
        "deep XML": b"<robot>" + b"<a>" * 200_000, "half": valid[: len(valid) // 2],
        "long number": b"a: " + b"9" * 100_000,
        "wrong types": b'{"laws": 5, "kind": [], "tags": {}}',
        "wrong laws": b'{"kind": "comparison", "laws": {"../..": 1}, "settling": [1]}',
    }  # fmt: skip
    for name, text in texts.items():
        yield name, lambda text=text: path.write_bytes(text)
    for number in range(4):
        content = _damaged(valid, random.Random(f"{seed} {path} {number}"))
        yield f"damaged {number}", lambda content=content: path.write_bytes(content)
    yield "FIFO", lambda: os.mkfifo(path)
    yield "device", lambda: path.symlink_to("/dev/zero")
    yield "circle", lambda: path.symlink_to(path)
    yield "folder", path.mkdir
    yield "3 GiB", lambda: (path.touch(), os.truncate(path, 3 << 30))


def _be(words: list[str], said: Path) -> NoReturn:
    """Be the command."""
    code = 99
    try:
        os.setsid()
        output = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o644)
        for number in (1, 2):
            os.dup2(output, number)
        sys.stdout = sys.stderr = open(1, "w", buffering=1)  # noqa: SIM115
        sys.argv = ["funnel-hil", *words]
        cli.main()
    except SystemExit as left:
        code = int(left.code or 0)
    except BaseException:  # noqa: BLE001
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        os._exit(code)


def _end_of(words: list[str], said: Path) -> tuple[str, float, int]:
    """How a command ends in a process of its own, after how long, with how much memory."""
    began_s, child = time.monotonic(), os.fork()
    if not child:
        _be(words, said)
    while True:
        done, status, usage = os.wait4(child, os.WNOHANG)
        late = time.monotonic() - began_s > 3 * _SECONDS
        if done or late:
            break
        time.sleep(0.01)
    if not done:
        os.killpg(child, signal.SIGKILL)
        _, status, usage = os.wait4(child, 0)
    taken_s = time.monotonic() - began_s
    text = said.read_text(errors="replace")
    if late:
        how = "no end"
    elif os.WIFSIGNALED(status):
        how = f"signal {os.WTERMSIG(status)}"
    elif "Traceback" in text or os.WEXITSTATUS(status) == 99:
        how = "traceback"
    elif usage.ru_maxrss * 1024 > _BYTES:
        how = "memory"
    elif usage.ru_utime + usage.ru_stime > _SECONDS:
        how = "time"
    else:
        how = f"exit {os.WEXITSTATUS(status)}"
    return how, taken_s, usage.ru_maxrss


def _results(folder: Path) -> dict[str, Path]:
    """Folders with results, by the name of those to damage."""
    run, compared, given = folder / "a run", folder / "a comparison", folder / "given.yaml"
    given.write_text(_SHORT)
    for words in (
        ["simulate", str(given), "--no-report", "--out", str(run)],
        ["compare", str(given), "--laws", "pid", "--out", str(compared)],
    ):
        assert _end_of(words, folder / "said")[0] == "exit 0"
    _VALID[".mcap"] = (run / "run.mcap").read_bytes()
    return {"run": run, "exported": run, "compared": compared}


def campaign(seed: int) -> dict[str, Counter[str]]:
    """Try all; how they ended, by kind."""
    for name in COMMANDS:
        LazyCommand(name, *COMMANDS[name]).load()  # no child has to import it
    gc.freeze()
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    found: dict[str, Counter[str]] = {}
    with tempfile.TemporaryDirectory() as temporary:
        made = _results(Path(temporary))
        for kind, words in COMMAND_OF.items():
            for index, (name, _) in enumerate(hostile(Path(kind), seed)):
                folder = Path(temporary) / f"{kind.replace('/', '_')} {index}"
                path = folder / kind
                if (part := kind.partition("/")[0]) in made:
                    shutil.copytree(made[part], folder / part)
                path.parent.mkdir(parents=True, exist_ok=True)
                path.unlink(missing_ok=True)
                os.chdir(folder)
                (folder / "given.yaml").write_text(_SHORT)
                if kind.startswith("mesh"):
                    arm = _ARM.read_text().replace("</link>", _SHAPE.format(kind), 1)
                    (folder / "shaped.urdf").write_text(arm)
                list(hostile(path, seed))[index][1]()
                how, taken_s, kib = _end_of([word.format(path) for word in words], folder / "said")
                found.setdefault(kind, Counter())[how] += 1
                if not how.startswith("exit"):
                    last = (folder / "said").read_text(errors="replace").splitlines()[-1:]
                    print(
                        f"{kind}: {name}: {how}, {taken_s:.1f} s, {kib // 1024} MiB: {last}"[:300]
                    )
                    sys.stdout.flush()
    return found


if __name__ == "__main__":
    assert SHIPPED.is_dir()
    for kind, ends in campaign(int(sys.argv[1]) if len(sys.argv) > 1 else 0).items():
        print(f"{kind:26}", ", ".join(f"{how}: {count}" for how, count in sorted(ends.items())))
