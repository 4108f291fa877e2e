"""A reference from a file: the run is the same, and its folder needs the file no more."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from deploy.cli.commands import app
from deploy.run.run_folder import load_run
from deploy.run.simulate import simulate
from deploy.scenario.effective import agreement_of
from deploy.scenario.scenario import load_setup
from deploy.scenario.warnings import scenario_warnings
from deploy.scenario.yaml_files import ScenarioError

SHORT = ["duration_s=0.3", "metrics.from_s=0"]


def exported(folder: Path, name: str = "paper_arm", *changes: str) -> Path:
    path = folder / "ref.csv"
    words = [word for change in (*SHORT, *changes) for word in ("--set", change)]
    result = CliRunner().invoke(app, ["reference", name, *words, "--csv", "--out", str(path)])
    assert result.exit_code == 0, result.output
    return path


def from_file(path: Path | str, **keys: object) -> str:
    more = "".join(f", {key}: {value}" for key, value in keys.items())
    return f"reference={{kind: csv, file: {path}{more}}}"


@pytest.mark.parametrize("name", ["paper_arm", "iiwa"])
def test_what_was_exported_gives_the_same_run_to_the_bit(name: str, tmp_path: Path) -> None:
    path = exported(tmp_path, name)
    own = simulate(load_setup(name, SHORT))
    read = simulate(load_setup(name, [*SHORT, from_file(path)]))
    assert read.data().digest == own.data().digest


def test_a_run_needs_its_file_no_more(tmp_path: Path) -> None:
    path = exported(tmp_path)
    out, again = tmp_path / "run", tmp_path / "again"
    words = [word for change in SHORT for word in ("--set", change)]
    result = CliRunner().invoke(
        app, ["simulate", "paper_arm", *words, "--set", from_file(path), "--out", str(out)]
    )
    assert result.exit_code == 0, result.output
    path.unlink()
    assert "cannot" not in (out / "scenario.yaml").read_text()
    result = CliRunner().invoke(app, ["simulate", str(out / "scenario.yaml"), "--out", str(again)])
    assert result.exit_code == 0, result.output
    data, _ = load_run(out)
    assert data.digest == load_run(again)[0].digest
    for file in out.glob("ref-*.csv"):
        file.unlink()
    assert load_run(out)[0].digest == data.digest  # the recording has it too


def test_a_path_starts_at_the_scenario_or_at_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    exported(tmp_path)
    monkeypatch.chdir(tmp_path)
    load_setup("paper_arm", [*SHORT, from_file("ref.csv")])
    beside = tmp_path / "elsewhere"
    beside.mkdir()
    (beside / "mine.csv").write_bytes((tmp_path / "ref.csv").read_bytes())
    (beside / "mine.yaml").write_text(
        "extends: paper_arm\nduration_s: 0.3\nreference: {kind: csv, file: mine.csv}\n"
    )
    load_setup("elsewhere/mine.yaml")
    with pytest.raises(ScenarioError, match="no such file; must be a path from"):
        load_setup("paper_arm", [*SHORT, from_file("mine.csv")])


def test_a_run_beyond_the_file_is_refused_unless_it_is_held(tmp_path: Path) -> None:
    path = exported(tmp_path)
    longer = ["duration_s=0.4", "metrics.from_s=0"]
    with pytest.raises(ScenarioError) as refused:
        load_setup("paper_arm", [*longer, from_file(path)])
    assert "duration_s = 0.4: must be within the 0 to 0.3 s of reference.file" in str(refused.value)
    held = load_setup("paper_arm", [*longer, from_file(path, beyond="hold")])
    assert any("but the arm rests there" in said for said in scenario_warnings(held))
    late = tmp_path / "late.csv"
    lines = path.read_text().splitlines()
    late.write_text("\n".join([lines[0], *lines[100:]]))
    with pytest.raises(ScenarioError, match=r"within the 0\.099 to 0\.3 s"):
        load_setup("paper_arm", [*SHORT, from_file(late)])


def test_hosts_agree_on_what_the_file_holds(tmp_path: Path) -> None:
    path = exported(tmp_path)
    setup = load_setup("paper_arm", [*SHORT, from_file(path)])
    told = agreement_of(setup).encode()
    copy = tmp_path / "copy.csv"

    def differences(text: str) -> list[str]:
        copy.write_text(text)
        theirs = agreement_of(load_setup("paper_arm", [*SHORT, from_file(copy)]))
        return theirs.differences(told)

    assert differences(path.read_text()) == []
    assert differences(path.read_text().replace("\n0,", "\n-0.001,")) == ["reference.file"]


def test_a_bad_file_ends_a_command_before_anything_starts(tmp_path: Path) -> None:
    path = exported(tmp_path)
    lines = path.read_text().splitlines()
    cells = lines[7].split(",")
    cells[4] = "NaN"
    path.write_text("\n".join([*lines[:7], ",".join(cells), *lines[8:]]))
    words = [word for change in (*SHORT, from_file(path)) for word in ("--set", change)]
    result = CliRunner().invoke(app, ["run", "paper_arm", *words, "--out", str(tmp_path / "o")])
    assert isinstance(result.exception, ScenarioError)
    said = str(result.exception)
    assert "ref.csv" in said
    assert "line 8, column shoulder.position_rad = 'NaN': must be a finite number" in said
    assert not (tmp_path / "o").exists()
