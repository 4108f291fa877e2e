"""A kind of study of a package: command line, Python, report, list, gate and growth know it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

import funnel_hil as python
from deploy.reports.kinds import RESULT_KINDS
from tests.deploy.extensions.conftest import EXAMPLE
from tests.warm_process import ROOT

pytestmark = pytest.mark.usefixtures("example_package")
STUDY = """
name: gripper
scenario: paper_arm
payloads_kg: [{}]
set: {{duration_s: 0.3}}
"""
HERE = ("--workers", "1")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "gripper.yaml"
    path.write_text(STUDY.format("0, 0.5"))
    return path


def test_command_runs_it_grows_it_and_writes_its_page_again(funnel_hil, file, tmp_path) -> None:
    out, words = tmp_path / "out", ["payloads", file, *HERE, "--out", tmp_path / "out"]
    output = funnel_hil.output(*words)
    assert "0.5 kg is the heaviest payload" in output
    assert (out / "payloads.parquet").is_file()
    page = (out / "report.html").read_text()
    (out / "report.html").unlink()
    funnel_hil.output("report", out)
    assert (out / "report.html").read_text() == page
    assert "payloads" in funnel_hil.output("runs", "list", tmp_path)
    file.write_text(STUDY.format("0, 0.5, 1"))
    funnel_hil.output(*words)
    assert json.loads((out / "summary.json").read_text())["heaviest_kg"] == 1.0
    file.write_text(STUDY.format("0"))
    assert "payloads_kg = [0.0]: must have all of" in funnel_hil.output(*words, code=2)


def test_gate_reads_its_number(funnel_hil, file, tmp_path) -> None:
    words = ["payloads", file, *HERE, "--out", tmp_path / "out", "--at-least"]
    funnel_hil.output(*words, "0.5kg")
    output = funnel_hil.output(*words, "2kg", code=3)
    assert "paper_arm: 0.5 kg, must be at least 2 kg" in output


def test_python_runs_it() -> None:
    done = python.study("payloads", "paper_arm", {"duration_s": 0.3}, payloads_kg=[0, 0.5])
    assert done.summary["heaviest_kg"] == 0.5
    assert [row["payload_kg"] for row in done.rows] == [0.0, 0.5]


def test_python_refuses_a_kind_that_nobody_adds() -> None:
    with pytest.raises(python.InputError, match=r"'payload': must be .*payloads"):
        python.study("payload")


def test_help_names_it(funnel_hil) -> None:
    assert "Run a study of funnel-hil-example" in funnel_hil.output("--help")


def test_each_extension_of_the_example_is_one_file() -> None:
    code = EXAMPLE / "funnel_hil_example"
    files = {file.stem for file in code.glob("*.py")} - {"__init__"}
    one_each = {
        "law",
        "predictor",
        "fault",
        "figure",
        "interface",
        "merge",
        "link",
        "payloads",
        "robot_server",
    }
    two = {"engine": {"flywheels"}, "protocol": {"drive"}}
    assert files == one_each | set(two) | set().union(*two.values())
    for name in one_each:
        text = (code / f"{name}.py").read_text()
        assert not any(f"funnel_hil_example.{other} import" in text for other in files - {name})


KINDS = [name for name in RESULT_KINDS.shipped if name != "run"]


def package_of(name: str) -> str:
    return str(RESULT_KINDS.shipped[name]).rpartition(".kind:")[0]


@pytest.mark.parametrize("name", KINDS)
def test_each_shipped_kind_is_one_package(name: str) -> None:
    kind = RESULT_KINDS[name]
    parts = [kind.study, kind.page, kind.gauged, kind.judged, kind.again]
    assert kind.name == name
    assert {each.__module__.rpartition(".")[0] for each in parts if each} == {package_of(name)}


def test_only_kinds_and_python_import_kinds() -> None:
    outside = [
        file.relative_to(ROOT).parts[:2]
        for room in ("bus_schema", "controller", "plant_emulator", "deploy")
        for file in (ROOT / room).rglob("*.py")
        if re.search(r"^ *from deploy\.studies\.", file.read_text(encoding="utf-8"), re.MULTILINE)
    ]
    assert {folder for _, folder in outside} <= {"studies", "api"}
