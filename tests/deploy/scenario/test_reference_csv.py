"""References in files: as exported, and as read by a run, whose folder then needs no such file."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from pyarrow import csv, parquet

from controller.reference import sample_motion
from deploy.run.run_folder import load_run
from deploy.run.simulate import simulate
from deploy.scenario.checking.warnings import scenario_warnings
from deploy.scenario.effective import agreement_of
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError
from tests.warm_process import output_of

SHORT = ["duration_s=0.3", "metrics.from_s=0"]
SINUSOIDS = (
    "reference={kind: joint_sinusoids, centre_rad: 0.2,"
    " terms: [{amplitude_rad: 0.1, frequency_rad_s: 2}]}"
)


def words_of(*changes: str) -> list[str]:
    return [word for change in (*SHORT, *changes) for word in ("--set", change)]


def exported(folder: Path, name: str = "paper_arm", kind: str = "csv", *changes: str) -> Path:
    path = folder / f"ref.{kind}"
    output_of("reference", name, *words_of(*changes), f"--{kind}", "--out", path)
    return path


def from_file(path: Path | str, **keys: object) -> str:
    more = "".join(f", {key}: {value}" for key, value in keys.items())
    return f"reference={{kind: csv, file: {path}{more}}}"


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_file_has_a_row_per_tick_with_all_derivatives(kind: str, tmp_path: Path) -> None:
    path = exported(tmp_path, "paper_arm", kind, SINUSOIDS)
    table = csv.read_csv(path) if kind == "csv" else parquet.read_table(path)
    rows = table.to_pylist()
    assert len(rows) == 301
    for row in (rows[0], rows[150], rows[-1]):
        angle = 2.0 * row["time_s"]
        assert row["shoulder.position_rad"] == pytest.approx(0.2 + 0.1 * math.sin(angle))
        assert row["shoulder.velocity_rad_s"] == pytest.approx(0.2 * math.cos(angle))
        assert row["elbow.acceleration_rad_s2"] == pytest.approx(-0.4 * math.sin(angle))
    assert [row["time_s"] for row in rows] == pytest.approx([0.001 * k for k in range(301)])


@pytest.mark.parametrize("name", ["paper_arm", "iiwa"])
def test_what_was_exported_gives_the_same_run_to_the_bit(name: str, tmp_path: Path) -> None:
    path = exported(tmp_path, name)
    own = simulate(load_setup(name, SHORT))
    read = simulate(load_setup(name, [*SHORT, from_file(path)]))
    assert read.data().digest == own.data().digest


@pytest.mark.parametrize("is_first", [True, False])
def test_another_kind_of_reference_replaces_that_of_the_scenario(is_first, tmp_path) -> None:
    """Whose keys it does not know; those that are set beside it stay, in any order."""
    path = exported(tmp_path)
    words = ["reference.kind=csv", f"reference.file={path}"]
    setup = load_setup("paper_arm", [*SHORT, *(words if is_first else words[::-1])])
    assert setup.scenario.reference.file == str(path)


def test_a_run_needs_its_file_no_more(tmp_path: Path) -> None:
    path = exported(tmp_path)
    out, again = tmp_path / "run", tmp_path / "again"
    output_of("simulate", "paper_arm", *words_of(from_file(path)), "--out", out)
    path.unlink()
    assert "cannot" not in (out / "scenario.yaml").read_text()
    output_of("simulate", out / "scenario.yaml", "--out", again)
    data, _ = load_run(out)
    assert data.digest == load_run(again)[0].digest
    for file in out.glob("ref-*.csv"):
        file.unlink()
    assert load_run(out)[0].digest == data.digest  # the recording has it too


def test_a_path_starts_at_the_scenario_or_at_the_current_folder(tmp_path, monkeypatch):
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
    assert any("but the arm rests there" in text for text in scenario_warnings(held))
    late = tmp_path / "late.csv"
    lines = path.read_text().splitlines()
    late.write_text("\n".join([lines[0], *lines[100:]]))
    with pytest.raises(ScenarioError, match=r"within the 0\.099 to 0\.3 s"):
        load_setup("paper_arm", [*SHORT, from_file(late)])


def test_hosts_agree_on_what_the_file_holds(tmp_path: Path) -> None:
    path = exported(tmp_path)
    setup = load_setup("paper_arm", [*SHORT, from_file(path)])
    reported = agreement_of(setup).encode()
    copy = tmp_path / "copy.csv"

    def differences(text: str) -> list[str]:
        copy.write_text(text)
        theirs = agreement_of(load_setup("paper_arm", [*SHORT, from_file(copy)]))
        return theirs.differences(reported)

    assert differences(path.read_text()) == []
    assert differences(path.read_text().replace("\n0,", "\n-0.001,")) == ["reference.file"]


def test_a_bad_file_ends_a_command_before_anything_starts(tmp_path: Path) -> None:
    path = exported(tmp_path)
    lines = path.read_text().splitlines()
    cells = lines[7].split(",")
    cells[4] = "NaN"
    path.write_text("\n".join([*lines[:7], ",".join(cells), *lines[8:]]))
    words = ["run", "paper_arm", *words_of(from_file(path)), "--out", tmp_path / "o"]
    output = output_of(*words, code=2)
    assert "ref.csv" in output
    assert "line 8, column shoulder.position_rad = NaN: must be a finite number" in output
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize(("hz", "is_taken"), [(100.0, True), (1000.0, False)])
def test_motion_that_no_tick_shows_is_refused(hz: float, is_taken: bool, tmp_path: Path) -> None:
    """At 1 kHz, ticks see the zeros of a sine of 1 kHz; of 0.2 mrad at 100 Hz, they see enough."""
    amplitude_rad = 2e-4 if is_taken else 0.05
    times_s = [0.00025 * row for row in range(1300)]
    angles = (amplitude_rad * math.sin(2.0 * math.pi * hz * time_s) for time_s in times_s)
    names = [f"{joint}.position_rad" for joint in ("base_yaw", "shoulder", "elbow")]
    rows = [f"{time_s:.6f},{q:.9f},0.2,0.3" for time_s, q in zip(times_s, angles, strict=True)]
    (path := tmp_path / "fast.csv").write_text("\n".join([",".join(["time_s", *names]), *rows, ""]))
    overrides = [*SHORT, from_file(path), "robot.initial_offset_rad=0"]
    if is_taken:
        load_setup("paper_arm", overrides)
    else:
        with pytest.raises(ScenarioError, match="must move less between two ticks"):
            load_setup("paper_arm", overrides)


SLIDE = """<robot name="gantry"><link name="base"/>
<joint name="x" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" effort="100" velocity="2"/></joint>
<link name="cart"><inertial><mass value="2"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""


@pytest.fixture
def gantry(tmp_path: Path) -> Path:
    """A scenario of a joint that slides, with a reference and nothing about its motor."""
    (tmp_path / "gantry.urdf").write_text(SLIDE)
    file = tmp_path / "gantry.yaml"
    file.write_text(
        "name: gantry\nduration_s: 0.2\nmetrics: {from_s: 0}\nrobot: {urdf: gantry.urdf}\n"
        "reference: {kind: csv, file: ref.csv, beyond: hold}\n"
        "controller: {law: pid}\nplant: {physics: {engine: mujoco}}\n"
    )
    return file


@pytest.mark.parametrize(
    "names", [("position_rad", "velocity_rad_s"), ("position_m", "velocity_m_s")]
)
def test_columns_of_a_sliding_joint_may_be_named_in_m(gantry: Path, names: tuple[str, str]) -> None:
    position, velocity = names
    rows = f"time_s,x.{position},x.{velocity}\n0,0.1,0\n1,0.3,0\n"
    gantry.with_name("ref.csv").write_text(rows)
    motion = sample_motion(load_setup(str(gantry)).reference, np.array([0.0, 0.5, 1.0]), 1)
    assert motion[0][:, 0] == pytest.approx([0.1, 0.2, 0.3])


def test_a_column_in_m_of_a_turning_joint_names_what_is_allowed(tmp_path: Path) -> None:
    file = tmp_path / "ref.csv"
    file.write_text("time_s,shoulder.position_m\n0,0\n")
    with pytest.raises(ScenarioError, match="of one that slides also position_m, velocity_m_s"):
        load_setup("paper_arm", [*SHORT, from_file(file)])


def test_a_plant_without_rotors_and_friction_is_pointed_out(gantry: Path) -> None:
    """Of a file of one's own: `robot --scenario` estimates both, and so do studies of the file."""
    gantry.with_name("ref.csv").write_text("time_s,x.position_rad\n0,0\n1,0\n")

    def warned(*changes: str) -> bool:
        complaint = "gantry.urdf: the plant has neither rotors nor friction"
        return any(
            complaint in each for each in scenario_warnings(load_setup(str(gantry), changes))
        )

    assert warned()
    assert not warned("plant.friction={viscous_nm_s: 1}")
