"""Bad input ends with exit code 2 and one message, before anything is written or started."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from deploy import cli
from deploy.scenario import SHIPPED

ROOT = Path(__file__).resolve().parents[2]
JOINTLESS = '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="fixed">{}</joint></robot>'
ENDS = '<parent link="a"/><child link="b"/>'


@pytest.fixture
def refuse(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> Refusal:
    return Refusal(monkeypatch, tmp_path / "out", capsys)


class Refusal:
    """Runs a command that has to be refused; gives back its only message."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, out: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        self._monkeypatch, self._out, self._capsys = monkeypatch, out, capsys

        def start(*_: object) -> None:
            pytest.fail("something was started")

        for name in ("Launcher", "simulate_setup", "run_controller", "run_plant", "run_recorder"):
            monkeypatch.setattr(cli, name, start)

    def __call__(self, *words: str, out: Path | None = None) -> str:
        if words[0] in ("run", "simulate", "record"):
            words = (*words, "--out", str(out or self._out))
        self._monkeypatch.setattr(sys, "argv", ["funnel-hil", *words])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        said = self._capsys.readouterr()
        assert ended.value.code == 2
        assert said.out == ""
        assert not self._out.exists()
        assert said.err.startswith("error: ")
        assert said.err.count("error: ") == 1
        assert "Traceback" not in said.err
        return said.err.removeprefix("error: ").rstrip("\n")


IMPOSSIBLE = [
    # override, what the message names as key and value, what it says is allowed
    ("duration=2", "duration", "there is no such key"),
    ("link.uplink.delay=2", "link.uplink.delay", "there is no such key"),
    ("a.b=1", "a", "there is no such key"),
    ("duration_s=abc", "duration_s = 'abc'", "a valid number"),
    ("duration_s=", "duration_s = None", "a valid number"),
    ("duration_s=0", "duration_s = 0", "greater than 0"),
    ("duration_s=.nan", "duration_s = nan", "a finite number"),
    ("duration_s=1000000000", "duration_s = 1000000000", "must"),
    ("rate_hz=0.5", "rate_hz = 0.5", "at least 1|greater than or equal to 1"),
    ("seed=1.5", "seed = 1.5", "a valid integer"),
    ("seed=-1", "seed = -1", "greater than or equal to 0"),
    ("clock=fast", "clock = 'fast'", "'realtime' or 'lockstep'"),
    ("plant.gui=maybe", "plant.gui = 'maybe'", "a valid boolean"),
    ("link.kind=carrier_pigeon", "link.kind = 'carrier_pigeon'", "zenoh"),
    ("link.uplink.delay_ms=-1", "link.uplink.delay_ms = -1", "greater than or equal to 0"),
    ("link.downlink.delay_ms=[1]", "link.downlink.delay_ms = [1]", "a valid number"),
    ("link.uplink=3", "link.uplink = 3", "mapping|dictionary"),
    ("link.router_endpoint=nowhere", "link.router_endpoint = 'nowhere'", "tcp/127.0.0.1:7451"),
    ("robot.urdf=nowhere.urdf", "robot.urdf = 'nowhere.urdf'", "no such file"),
    ("robot.initial_offset_rad=1.6", "robot.initial_offset_rad = [1.6, 1.6, 1.6]", "funnel|limits"),
    ("robot.initial_offset_rad=[0, 0, -2]", "robot.initial_offset_rad = [0.0, 0.0, -2.0]", "1.5 rad"),
    ("robot.initial_offset_rad=[9, 0, 0]", "robot.initial_offset_rad = [9.0, 0.0, 0.0]", "[-3.1, 3.1]"),
    ("robot.initial_offset_rad=[0.1, 0.1]", "robot.initial_offset_rad = [0.1, 0.1]", "each of the 3 joints"),
    ("funnel.final_rad=1", "funnel.final_rad = [1.0, 1.0, 1.0]", "must not exceed"),
    ("reference.x.offset_m=9", "reference", "within the arm's reach"),
    ("controller.law=magic", "controller.law = 'magic'", "fixed_time_neural, fixed_time_model_based, pid"),
    ("controller.gains.magic=1", "controller.gains.magic", "there is no such key"),
    ("controller.gains.fixed_time_neural.k_1=[1, 2]", "controller.gains.fixed_time_neural.k_1 = [1.0, 2.0]", "each of the 3 joints"),
    ("controller.gains.fixed_time_neural.k_1=-1", "controller.gains.fixed_time_neural.k_1 = -1", "at least 0"),
    ("controller.torque_rate_limit_nm_s=[1, 2]", "controller.torque_rate_limit_nm_s = [1.0, 2.0]", "each of the 3 joints"),
    ("plant.substeps=0", "plant.substeps = 0", "greater than or equal to 1"),
    ("plant.command_timeout_ms=0", "plant.command_timeout_ms = 0", "greater than 0"),
    ("plant.friction.coulomb_nm=[1, 2]", "plant.friction.coulomb_nm = [1.0, 2.0]", "each of the 3 joints"),
    ("plant.friction.viscous_nm_s=-1", "plant.friction.viscous_nm_s = -1", "at least 0"),
    ("plant.actuator.saturation_nm=[1, 2]", "plant.actuator.saturation_nm = [1.0, 2.0]", "each of the 3 joints"),
    ("plant.encoder.resolution_rad=[1, 2]", "plant.encoder.resolution_rad = [1.0, 2.0]", "each of the 3 joints"),
    ("plant.stop_damping_nm_s=[1, 2]", "plant.stop_damping_nm_s = [1.0, 2.0]", "each of the 3 joints"),
    ("plant.disturbance.terms=[{joint: knee, kind: constant, torque_nm: 1}]", "plant.disturbance.terms.0.joint = 'knee'", "base_yaw, shoulder, elbow"),
    ("plant.disturbance.terms=[{joint: all, kind: noise, rms_nm: 1, lowest_hz: 9, highest_hz: 2}]", "plant.disturbance.terms.0.highest_hz = 2", "above lowest_hz"),
    ("plant.disturbance.terms=[{joint: all, kind: drum}]", "plant.disturbance.terms.0", "'sine'"),
]  # fmt: skip


@pytest.mark.parametrize(("override", "named", "allowed"), IMPOSSIBLE, ids=lambda value: value)
def test_impossible_value_is_refused(
    refuse: Refusal, override: str, named: str, allowed: str
) -> None:
    message = refuse("run", "paper_arm", "--set", override)
    assert message.startswith(str(SHIPPED / "paper_arm.yaml"))
    assert named in message
    assert any(choice in message for choice in allowed.split("|")), message


@pytest.mark.parametrize("override", ["duration_s", "=2", "duration_s=["])
def test_malformed_override_is_refused(refuse: Refusal, override: str) -> None:
    assert refuse("run", "paper_arm", "--set", override).startswith(f"--set {override}:")


@pytest.mark.parametrize("command", ["run", "simulate", "controller", "plant", "record"])
def test_every_command_checks_its_scenario(refuse: Refusal, command: str) -> None:
    assert "link.uplink.delay_ms = -1" in refuse(
        command, "paper_arm", "--set", "link.uplink.delay_ms=-1"
    )


def test_unknown_scenario_is_refused_with_the_names_of_the_shipped_ones(refuse: Refusal) -> None:
    message = refuse("run", "paper_leg")
    assert message.startswith("paper_leg: ")
    assert "paper_arm" in message.removeprefix("paper_leg")


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"name: [", "YAML"),
        (b"- name\n- duration_s\n", "a mapping of keys to values"),
        (b"just words", "a mapping of keys to values"),
        (b"", "a mapping of keys to values"),
        (b"\xff\xfe\x00", "YAML"),
    ],
    ids=["broken", "list", "text", "empty", "binary"],
)
def test_file_that_is_no_scenario_is_refused(
    refuse: Refusal, tmp_path: Path, content: bytes, complaint: str
) -> None:
    file = tmp_path / "mine.yaml"
    file.write_bytes(content)
    message = refuse("run", str(file))
    assert message.startswith(f"{file}: ")
    assert complaint in message


def test_missing_keys_are_named(refuse: Refusal, tmp_path: Path) -> None:
    values = yaml.safe_load((SHIPPED / "paper_arm.yaml").read_text())
    del values["duration_s"]
    file = tmp_path / "mine.yaml"
    file.write_text(yaml.safe_dump(values))
    assert refuse("run", str(file)) == f"{file}: duration_s: is missing"


@pytest.mark.parametrize(
    ("urdf", "complaint"),
    [
        (JOINTLESS.format(ENDS), "no revolute or continuous joint"),
        ("<robot", "cannot be read as URDF"),
        ("<model/>", "no URDF"),
    ],
    ids=["no joints", "broken", "not a robot"],
)
def test_urdf_that_is_no_arm_is_refused(
    refuse: Refusal, tmp_path: Path, urdf: str, complaint: str
) -> None:
    file = tmp_path / "arm.urdf"
    file.write_text(urdf)
    message = refuse("run", "paper_arm", "--set", f"robot.urdf={file}")
    assert f"robot.urdf = '{file}'" in message
    assert complaint in message


def test_place_that_cannot_be_written_to_is_refused(refuse: Refusal, tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    for out in (file, file / "below"):
        assert refuse("run", "paper_arm", out=out).startswith(f"--out {out}: cannot be created")
    assert file.read_bytes() == b""


def test_run_needs_a_bus_between_its_processes(refuse: Refusal) -> None:
    message = refuse("run", "paper_arm", "--set", "link.kind=in_process")
    assert "link.kind = 'in_process': must be zenoh" in message


@pytest.mark.parametrize("command", ["replay", "report"])
def test_folder_without_a_run_is_refused(refuse: Refusal, tmp_path: Path, command: str) -> None:
    assert refuse(command, str(tmp_path)).startswith(f"{tmp_path}: ")
    (tmp_path / "run.mcap").write_bytes(b"no recording")
    assert "no recording of funnel-hil" in refuse(command, str(tmp_path))


def test_process_of_its_own_ends_with_the_same_code_and_message(tmp_path: Path) -> None:
    words = ["run", "paper_arm", "--set", "link.uplink.delay_ms=-1", "--out", str(tmp_path / "out")]
    ended = subprocess.run(
        [sys.executable, "-m", "deploy.cli", *words], cwd=tmp_path, check=False, timeout=120,
        env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True,
    )  # fmt: skip
    assert ended.returncode == 2
    assert ended.stderr.count("\n") == 1
    assert "link.uplink.delay_ms = -1: must be greater than or equal to 0" in ended.stderr
    assert list(tmp_path.iterdir()) == []
