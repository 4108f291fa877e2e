"""A row belongs to everything that made it: where that has changed, a study refuses its folder."""

from __future__ import annotations

import os
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from deploy.scenario.yaml_files import ScenarioError
from deploy.study.execution.folder import StudyFolder, find_folder, opened, require_same_provenance
from deploy.study.execution.runner import carry_out
from tests.deploy.study.studies import TIED, Here, made_up, make_sweep
from tests.warm_process import WarmProcess

LAW = """
from pathlib import Path
from funnel_hil import Diagnostics

NETWORK = Path(__file__).with_name("network.bin")  # as a library opens it in C

class Law:
    def __init__(self, model, gains_file="gains.txt"):
        from law_parts.inner import stiffness
        self.diagnostics, self.model = Diagnostics(model.joints), model
        self.stiffness, self.damping = stiffness(), None

    def reset(self):
        pass

    def torque(self, tracking):
        if self.damping is None:
            self.damping = float(Path("damping.txt").read_text())
        acceleration = tracking.reference_acceleration - self.stiffness * tracking.error
        acceleration -= self.damping * tracking.error_rate
        return self.model.inverse_dynamics(tracking.position, tracking.velocity, acceleration)
"""
FILES = {
    "edited_law.py": LAW,
    "law_parts/__init__.py": "",
    "law_parts/inner.py": "from law_parts import table\ndef stiffness():\n    return table.VALUE\n",
    "law_parts/table.py": "from pathlib import Path\n"
    "VALUE = float(Path(__file__).with_suffix('.csv').read_text())\n",
    "law_parts/table.csv": "400",
    "network.bin": "weights",
    "gains.txt": "1",
    "damping.txt": "40",
    "unrelated.py": "",
}
WAIT_S = 300.0
SHORT = ("--set", "duration_s=0.1", "--set", "metrics.from_s=0", "--workers", "1")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with a law of several files."""
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def command(*words, codes=(0,)):
    """Return the output of a command in a process of its own, which imports laws again."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "COLUMNS": "200"}
    process = WarmProcess(*words, cwd=Path.cwd(), environment=environment)
    output = process.communicate(timeout=WAIT_S)[0]
    assert process.returncode in codes, output
    return output


def margin(*more):
    funnel = "funnel={rate_per_s: 100, final_rad: 0.3, convergence_margin_rad: 1,"
    return ("margin", "paper_arm", "--laws", "edited_law:Law", "--duration", "0.1", "--limit", "8",
            "--set", f"{funnel} overshoot_margin_rad: 1}}",  # a run lasts ten time constants
            "--resolution", "8", "--workers", "1", "--out", "out", *more)  # fmt: skip


def test_study_refuses_its_folder_after_any_change_of_its_law(folder):
    gate = ("--at-least", "0ms", "--junit", "gate.xml")
    output = command(*margin(*gate))
    assert "from before" not in output
    used = [name for name in FILES if name != "unrelated.py"]
    for name in [*used, "unrelated.py"]:
        before = (folder / name).read_text()
        (folder / name).write_text(f"{before}\n")
        output = command(*margin(*gate), codes=[2 if name in used else 0])
        if name in used:
            assert f"{folder / name}: " in output
            assert " before, " in output
            assert output.count(" before, ") == 1
            (folder / name).write_text(before)
    output = command(*margin(*gate))
    count = "4 of 4 runs are from before, with the same inputs"
    assert f"gate: passed; {count}; with 8 ms" in output
    assert count in [each.text for each in ET.parse("gate.xml").getroot().iter("system-out")]
    (folder / "edited_law.py").write_text(LAW.replace("- self.stiffness", "+ self.stiffness"))
    output = command(*margin(*gate, "--overwrite"), codes=(0, 3))
    assert "from before" not in output
    output = command(*margin("--at-least", "8ms", "--limit", "8"), codes=[3])
    assert "gate: failed; " in output


@pytest.mark.parametrize("reads", ["", "import os\nos.environ.get('GAIN')\n"])
def test_report_keeps_the_summary_of_a_law_that_was_edited(folder, reads):
    """No theory of the new law stands beside rows of the old one, also of one that reads more."""
    law, summary = folder / "edited_law.py", folder / "out" / "summary.json"
    law.write_text(reads + LAW)
    command(*margin())
    before = summary.read_text()
    assert "constant_ms" in before
    assert "summary of before" not in command("report", "out")
    assert summary.read_text() == before
    law.write_text(reads + LAW.replace("= stiffness()", "= 4 * stiffness()"))
    output = command("report", "out")
    assert f"{law}: " in output
    assert "this is the summary of before" in output
    assert summary.read_text() == before


def test_comparison_reuses_a_custom_law_until_it_changes(folder):
    words = ("compare", "--laws", "edited_law:Law,smc", *SHORT, "--out", "out")
    command(*words)
    output = command(*words)
    assert "2 runs were there from before" in output
    (folder / "edited_law.py").write_text(f"{LAW}\n")
    output = command(*words, codes=[2])
    assert f"{folder / 'edited_law.py'}: " in output


def carried_out(tmp_path, path, workers, **more):
    study = make_sweep(tmp_path, {TIED: [0, 1, 2]}, **more)
    require_same_provenance(study, path)
    with opened(study, find_folder(study, path), path) as folder:
        carry_out(study, workers, folder, workers.stop)
        return folder


def with_provenance(**parts):
    return Here(lambda run: made_up(run, provenance=parts), at_most=2)


@pytest.mark.parametrize("seeds", [1, 2], ids=["interrupted", "grows"])
def test_other_versions_are_refused_and_named(seeds, tmp_path):
    carried_out(tmp_path, tmp_path / "s", with_provenance(mujoco="0.0.1", numba="0.0.2"))
    with pytest.raises(ScenarioError, match=r"mujoco: 0\.0\.1 before, .* now; numba: 0\.0\.2 bef"):
        carried_out(tmp_path, tmp_path / "s", Here(made_up), seeds=seeds)


def test_study_that_is_continued_by_its_name_is_checked_too(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    study = make_sweep(tmp_path, {TIED: [0, 1, 2]})
    team = with_provenance(mujoco="0.0.1")
    with opened(study, find_folder(study, None), None) as folder:
        carry_out(study, team, folder, team.stop)
    found = find_folder(study, None)
    assert found == folder.path
    with pytest.raises(ScenarioError, match=rf"mujoco: .*: --out {found} --overwrite"):
        require_same_provenance(study, found)


def test_rows_without_provenance_are_refused(tmp_path):
    folder = carried_out(tmp_path, tmp_path / "s", Here(made_up))
    (folder.path / "provenance.json").unlink()
    with pytest.raises(ScenarioError, match="an older version of funnel-hil made them"):
        carried_out(tmp_path, folder.path, Here(made_up))


def test_rows_of_one_worker_stay_valid_beside_other_workers(tmp_path):
    study = make_sweep(tmp_path, {TIED: [0, 1, 2]})
    folder = carried_out(
        tmp_path, tmp_path / "s", Here(lambda r: made_up(r, provenance={"a": "1"}))
    )
    again = StudyFolder(folder.path, study)
    hosts = [{"a": "2"}, {"a": "1"}]
    assert again.changes(lambda _parts: hosts) == []
    assert again.changes(lambda _parts: hosts[:1]) == ["a: 1 before, 2 now"]


def test_input_that_changes_between_the_runs_of_one_command_is_noted(tmp_path):
    numbers = iter("12345")
    folder = carried_out(
        tmp_path, tmp_path / "s", Here(lambda run: made_up(run, provenance={"a": next(numbers)}))
    )
    assert folder.note == "a changed between its runs"
