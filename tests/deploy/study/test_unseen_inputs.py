"""A law's gain turns from 400 to −400 by a route that is hard to see: no old verdict is kept."""

from __future__ import annotations

import importlib
import os
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

import controller
import funnel_hil
from deploy.reports.studies.results import judge_rows
from deploy.scenario.yaml_files import ScenarioError
from deploy.study.execution.folder import find_folder, opened, require_same_provenance
from deploy.study.execution.provenance import provenance_of_law
from deploy.study.execution.runner import carry_out
from tests.deploy.study.studies import Here, make_sweep

LAW = """
{imports}
from funnel_hil import Diagnostics

class Law:
    def __init__(self, model):
        self.diagnostics, self.model = Diagnostics(model.joints), model
        self.stiffness = {stiffness}

    def reset(self):
        pass

    def torque(self, tracking):
        acceleration = tracking.reference_acceleration - self.stiffness * tracking.error
        acceleration -= 40.0 * tracking.error_rate
        return self.model.inverse_dynamics(tracking.position, tracking.velocity, acceleration)
"""
OPENED_IN_C = (
    "float(ctypes.string_at((lambda c, b: (c.read(c.open(b'gain.txt', 0), b, 8), b)[1])"
    "(ctypes.CDLL(None), ctypes.create_string_buffer(9))))"
)
UNSEEN = {
    "environment": ("import os", "float(os.environ['GAIN'])"),
    "environment of another name": ("from os import getenv as look", "float(look('GAIN'))"),
    "program": ("import subprocess", "float(subprocess.check_output(['cat', 'gain.txt']))"),
    "library in C": ("import ctypes", OPENED_IN_C),
    "listing": ("from pathlib import Path", "400 - 800 * len(list(Path().glob('turned*')))"),
    "existence": ("from pathlib import Path", "-400 if Path('turned').exists() else 400"),
    "code that is built": ("", "float(eval(\"__im\" \"port__('os').environ['GAIN']\"))"),
    "environment by another module": ("import random", "float(random._os.environ['GAIN'])"),
    "module of another module": (
        "import pathlib",
        "400 - 800 * ('turned' in pathlib.os.listdir('.'))",
    ),
    "name made of text": (
        "import pathlib",
        "float(getattr(getattr(pathlib, 'o' + 's'), 'env' + 'iron')['GAIN'])",
    ),
    "names made of text": (
        "import operator, pathlib",
        "float(operator.attrgetter('o' + 's.envi' + 'ron')(pathlib)['GAIN'])",
    ),
    "names by another name of getattr": (
        "import pathlib\nlook = getattr",
        "float(look(look(pathlib, 'o' + 's'), 'env' + 'iron')['GAIN'])",
    ),
    "names in a text with fields": (
        "import random",
        "float('{0._os.environ[GAIN]}'.format(random))",
    ),
    "names in a text made of texts": (
        "import random",
        "float(('{0._o' + 's.envi' + 'ron[GAIN]}').format(random))",
    ),
    "names in a pattern": (
        "import random\n"
        "def gain():\n"
        "    match random:\n"
        "        case object(_os=object(environ=found)):\n"
        "            return found['GAIN']",
        "float(gain())",
    ),
    "tables of names": (
        "import random",
        "float(vars(vars(random)['_o' + 's'])['env' + 'iron']['GAIN'])",
    ),
    "data that runs code": (
        "import yaml",
        "float(yaml.unsafe_load('!!python/object/apply:os.get' + 'env [GAIN]'))",
    ),
    "end of a link": (
        "from pathlib import Path",
        "400 if Path('link.txt').resolve().parent.name == 'first' else -400",
    ),
    "device": ("", "float(open('/proc/self/fd/' + open('handle.txt').read()).read())"),
}
SEEN = {
    "text with fields": ("", "float('{{0.real:g}}'.format(-400 if _is_there() else 400))"),
    "missing file": ("", "-400 if _is_there() else 400"),
    "link": ("", "float(open('link.txt').read())"),
    "another module of the name": ("import routed_gain", "routed_gain.GAIN"),
    "another module, imported late": ("", "__loader__ and self.late()"),
    "file outside of home": ("", "float(open('/dev/shm/{name}').read())"),
}
IS_THERE = """
def _is_there():
    try:
        return bool(open("turned").read() + " ")
    except FileNotFoundError:
        return False
"""
LATE = """
    def late(self):
        from routed_gain import GAIN
        return GAIN
"""


@pytest.fixture
def place(tmp_path, import_folder, monkeypatch):
    """The current folder, whose inputs say 400; `turned` makes them say −400."""
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.setenv("GAIN", "400")
    Path("gain.txt").write_text("400\n")
    for folder, gain in (("first", 400), ("second", -400)):
        Path(folder).mkdir()
        Path(folder, "routed_gain.py").write_text(f"GAIN = {gain}\n")
        Path(folder, "gain.txt").write_text(f"{gain}")
    Path("link.txt").symlink_to("first/gain.txt")
    monkeypatch.syspath_prepend(str(tmp_path / "first"))
    return tmp_path


def turn(place, monkeypatch):
    monkeypatch.setenv("GAIN", "-400")
    Path("gain.txt").write_text("-400\n")
    Path("turned").touch()
    Path("link.txt").unlink()
    Path("link.txt").symlink_to("second/gain.txt")
    monkeypatch.syspath_prepend(str(place / "second"))
    sys.modules.pop("routed_gain", None)


def verdict_in(path, **changes):
    """The verdict by a new command in a folder, which imports modules again; what is not seen."""
    for name in ("routed_law", "routed_gain"):
        sys.modules.pop(name, None)
    importlib.invalidate_caches()
    grid = {"controller.law": ["external" if changes else "routed_law:Law"]}
    study, workers = make_sweep(path.parent, grid, set={"duration_s": 0.5, **changes}), Here()
    found = find_folder(study, path)
    require_same_provenance(study, found)
    with opened(study, found, path) as folder:
        assert carry_out(study, workers, folder, workers.stop)
        (row,) = folder.rows
        assert folder.unseen == judge_rows(study, folder)["conditions"].get("reuse", "")
        return row["verdict"], folder.unseen


@pytest.mark.parametrize("route", UNSEEN)
def test_runs_are_made_again_if_something_unseen_may_have_changed(route, place, monkeypatch):
    imports, stiffness = UNSEEN[route]
    Path("routed_law.py").write_text(LAW.format(imports=imports, stiffness=stiffness))
    if route == "device":
        handle = os.open("gain.txt", os.O_RDONLY)
        Path("handle.txt").write_text(str(handle))
    verdict, unseen = verdict_in(place / "out")
    assert verdict == "kept"
    assert unseen.startswith("routed_law:Law uses ")
    assert unseen.endswith(": each command makes these runs again")
    turn(place, monkeypatch)
    assert verdict_in(place / "out") == ("lost", unseen)


@pytest.mark.parametrize("route", SEEN)
def test_folder_is_refused_if_something_seen_has_changed(route, place, monkeypatch):
    imports, stiffness = SEEN[route]
    shared = Path("/dev/shm", f"funnel-hil-test-{os.getpid()}")
    text = LAW.format(imports=imports, stiffness=stiffness.format(name=shared.name))
    if "late()" in stiffness:
        text = text.replace("__loader__ and ", "") + LATE
    with ExitStack() as stack:
        stack.callback(shared.unlink, missing_ok=True)
        shared.write_text("400")
        Path("routed_law.py").write_text(text + IS_THERE)
        for _ in range(2):
            assert verdict_in(place / "out") == ("kept", "")
        turn(place, monkeypatch)
        shared.write_text("-400")
        with pytest.raises(ScenarioError, match=r"its rows were made with other code, files"):
            verdict_in(place / "out")


def test_rows_of_an_object_are_made_again(place):
    """Its attributes, and the memory of the process, are in no file."""
    Path("routed_law.py").write_text(LAW.format(imports="", stiffness="self.gain"))
    law = importlib.import_module("routed_law").Law

    def verdict(gain):
        law.gain = gain
        grid = {"controller.law": ["routed_law:Law"]}
        changes = {"duration_s": 0.5}
        return funnel_hil.sweep("paper_arm", grid, changes, law=law, out="out").rows[0]["verdict"]

    assert [verdict(400.0), verdict(-400.0)] == ["kept", "lost"]


def test_rows_of_programs_are_made_again(place, monkeypatch):
    """A program reads files that nobody has named."""
    example = Path(controller.__file__).parent / "external/examples/stiff_pd.py"
    text = example.read_text().replace(
        "(9000, 16000, 2500)",
        '[float(open("gain.txt").read()) / 400 * each for each in (9000, 16000, 2500)]',
    )
    Path("program.py").write_text(text)
    command = {"controller.external.command": [sys.executable, "program.py"]}
    unseen = "external is a program: each command makes these runs again"
    assert verdict_in(place / "out", **command) == ("kept", unseen)
    turn(place, monkeypatch)
    assert verdict_in(place / "out", **command) == ("lost", unseen)


def test_processes_are_programs_too():
    assert provenance_of_law("process: my_robot") == {"not seen": "process: my_robot is a program"}
