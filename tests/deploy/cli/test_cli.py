"""Bad input ends with exit code 2 and one message, before anything is written or started."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from deploy import cli
from deploy.scenario.scenario import SHIPPED
from deploy.scenario.yaml_files import set_value

ROOT = Path(__file__).resolve().parents[3]
JOINTLESS = """<robot name="r"><link name="a"/><link name="b"/>
  <joint name="j" type="fixed"><parent link="a"/><child link="b"/></joint></robot>"""


@pytest.fixture
def refuse(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    nothing_starts: None,
) -> Refusal:
    return Refusal(monkeypatch, tmp_path / "out", capsys)


class Refusal:
    """Runs a command that has to be refused; gives back its only message."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, out: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        self._monkeypatch, self._out, self._capsys = monkeypatch, out, capsys

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


ONE_EACH = "each of the 3 joints"
IMPOSSIBLE = [
    # key, value as given, as the message shows it, what the message says is allowed
    ("duration_s", "abc", "'abc'", "a valid number"),
    ("duration_s", "", "null", "a valid number"),
    ("duration_s", "0", "0", "greater than 0"),
    ("duration_s", ".nan", "nan", "a finite number"),
    ("duration_s", "1000000000", "1000000000", "must"),
    ("rate_hz", "0.5", "0.5", "greater than or equal to 1"),
    ("seed", "1.5", "1.5", "a valid integer"),
    ("seed", "-1", "-1", "greater than or equal to 0"),
    ("clock", "fast", "'fast'", "'realtime' or 'lockstep'"),
    ("link.kind", "pigeon", "'pigeon'", "zenoh"),
    ("link.uplink.delay_ms", "-1", "-1", "greater than or equal to 0"),
    ("link.downlink.delay_ms", "[1]", "[1]", "a valid number"),
    ("link.uplink.jitter_ms", "-3", "-3", "greater than or equal to 0"),
    ("link.uplink.loss", "1.5", "1.5", "less than or equal to 1"),
    ("link.downlink.duplicate", "-0.1", "-0.1", "greater than or equal to 0"),
    ("link.uplink.correlation", "1.1", "1.1", "less than or equal to 1"),
    ("link.uplink.distribution", "cauchy", "'cauchy'", "'uniform', 'normal', 'pareto' or 'emp"),
    ("link.uplink.rate_kbit_s", "0", "0", "greater than 0"),
    ("link.uplink.burst_loss", "{p: 0.1}", "{'p': 0.1}", "p and r, or mean_loss and mean_burst"),
    ("link.uplink.burst_loss", "{r: 0.1}", "{'r': 0.1}", "p and r, or mean_loss and mean_burst"),
    ("link.uplink.burst_loss.r", "0", "0", "greater than 0"),
    ("link.uplink.burst_loss.mean_burst", "0.5", "0.5", "greater than or equal to 1"),
    (
        "link.uplink.burst_loss",
        "{mean_loss: 0.9, mean_burst: 2}",
        "{'mean_loss': 0.9, 'mean_burst': 2}",
        "at most mean_burst / (mean_burst + 1)",
    ),
    ("link.uplink.distribution_file", "a.txt", "'a.txt'", "unless distribution is 'empirical'"),
    ("link.playout_ms", "-1", "-1", "greater than or equal to 0"),
    ("link.router_endpoint", "nowhere", "'nowhere'", "tcp/127.0.0.1:7451"),
    ("robot.urdf", "nowhere.urdf", "'nowhere.urdf'", "no such file"),
    ("robot.initial_offset_rad", "[0, 0, -2]", "[0.0, 0.0, -2.0]", "opens to 1.5 rad"),
    ("robot.initial_offset_rad", "[9, 0, 0]", "[9.0, 0.0, 0.0]", "[-3.1, 3.1]"),
    ("robot.initial_offset_rad", "[0.1, 0.1]", "[0.1, 0.1]", ONE_EACH),
    ("funnel.final_rad", "1", "[1.0, 1.0, 1.0]", "must not exceed"),
    ("controller.law", "magic", "'magic'", "fixed_time_neural"),
    ("controller.gains.fixed_time_neural.k_1", "[1, 2]", "[1.0, 2.0]", ONE_EACH),
    ("controller.gains.fixed_time_neural.k_1", "-1", "-1", "at least 0"),
    ("controller.torque_rate_limit_nm_s", "[1, 2]", "[1.0, 2.0]", ONE_EACH),
    ("plant.substeps", "0", "0", "greater than or equal to 1"),
    ("plant.gui", "maybe", "'maybe'", "a valid boolean"),
    ("plant.command_timeout_ms", "0", "0", "greater than 0"),
    ("plant.friction.coulomb_nm", "[1, 2]", "[1.0, 2.0]", ONE_EACH),
    ("plant.friction.viscous_nm_s", "-1", "-1", "at least 0"),
    ("plant.actuator.saturation_nm", "[1, 2]", "[1.0, 2.0]", ONE_EACH),
    ("plant.encoder.resolution_rad", "[1, 2]", "[1.0, 2.0]", ONE_EACH),
    ("plant.stop_damping_nm_s", "[1, 2]", "[1.0, 2.0]", ONE_EACH),
]
DISTURBANCES = [
    ("{joint: knee, kind: constant, torque_nm: 1}", "0.joint = 'knee'", "base_yaw, shoulder"),
    (
        "{joint: all, kind: noise, rms_nm: 1, lowest_hz: 9, highest_hz: 2}",
        "0.highest_hz = 2.0",
        "above lowest_hz = 9.0",
    ),
    ("{joint: all, kind: drum}", "0", "'sine'"),
    ("{joint: all, kind: constant}", "0.constant.torque_nm", "is missing"),
]
SCHEDULES = [
    ("{kind: step, at_s: -1}", "schedule.0.step.at_s = -1: must be greater than or equal to 0"),
    ("{kind: step, at_s: 1, loss: 2}", "schedule.0.step.loss = 2: must be less than or equal to 1"),
    ("{kind: outage, at_s: 1}", "schedule.0.outage.for_s: is missing"),
    ("{kind: jump, at_s: 1}", "'step', 'ramp', 'outage'"),
    (
        "{kind: step, at_s: 2, loss: 0}, {kind: step, at_s: 1, loss: 0}",
        "must be in increasing order of at_s; 1.0 follows 2.0",
    ),
    (
        "{kind: ramp, at_s: 1, for_s: 2, loss: 1}, {kind: step, at_s: 2, loss: 0}",
        "must be without a change before the ramp ends at 3.0 s",
    ),
]


@pytest.mark.parametrize(("key", "given", "shown", "allowed"), IMPOSSIBLE)
def test_impossible_value_is_refused(
    refuse: Refusal, key: str, given: str, shown: str, allowed: str
) -> None:
    message = refuse("run", "paper_arm", "--set", f"{key}={given}")
    assert message.startswith(f"--set {key}={given}: {key} = {shown}: ")
    assert allowed in message


TYPOS = [
    # key as given, as far as it is known, what may have been meant
    ("duration", "duration", "duration_s"),
    ("link.uplink.delay", "link.uplink.delay", "delay_ms"),
    ("linc.uplink.delay_ms", "linc", "link"),
    ("paylod_kg", "paylod_kg", "plant.payload_kg"),
    ("controller.gains.pid.proportinal", "controller.gains.pid.proportinal", "proportional"),
    ("reference.x.ofset_m", "reference.cartesian_path.x.ofset_m", "offset_m"),
    ("controller.gains.magic", "controller.gains.magic", None),
    ("a.b", "a", None),
]


@pytest.mark.parametrize(("key", "known", "meant"), TYPOS)
def test_unknown_key_is_refused_with_the_one_that_may_be_meant(
    refuse: Refusal, tmp_path: Path, key: str, known: str, meant: str | None
) -> None:
    hint = f"; did you mean {meant}?" if meant else ""
    message = refuse("run", "paper_arm", "--set", f"{key}=1")
    assert message == f"--set {key}=1: {known}: there is no such key{hint}"
    file = tmp_path / "mine.yaml"
    values: dict[str, Any] = {"extends": "paper_arm"}
    set_value(values, key, 1)
    file.write_text(yaml.safe_dump(values))
    assert refuse("run", str(file)) == f"{file}: {known}: there is no such key{hint}"


@pytest.mark.parametrize(("term", "named", "allowed"), DISTURBANCES)
def test_impossible_disturbance_is_refused(
    refuse: Refusal, term: str, named: str, allowed: str
) -> None:
    message = refuse("run", "paper_arm", "--set", f"plant.disturbance.terms=[{term}]")
    assert f"plant.disturbance.terms.{named}" in message
    assert allowed in message


@pytest.mark.parametrize(("entries", "complaint"), SCHEDULES)
def test_impossible_schedule_is_refused(refuse: Refusal, entries: str, complaint: str) -> None:
    message = refuse("run", "paper_arm", "--set", f"link.uplink.schedule=[{entries}]")
    assert message.startswith(f"--set link.uplink.schedule=[{entries}]"[:100])
    assert complaint in message


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (None, "cannot be read"),
        ("", "holds no delay"),
        ("1\n-2\n", "line 2: a delay is at least 0"),
    ],
    ids=["missing", "empty", "negative"],
)
def test_impossible_file_of_delays_is_refused(
    refuse: Refusal, tmp_path: Path, text: str | None, complaint: str
) -> None:
    file = tmp_path / "delays.txt"
    if text is not None:
        file.write_text(text)
    section = f"{{distribution: empirical, distribution_file: {file}}}"
    message = refuse("run", "paper_arm", "--set", f"link.downlink={section}")
    assert "link.downlink.distribution_file = " in message
    assert str(file) in message
    assert complaint in message


def test_empirical_distribution_needs_a_file_and_has_no_jitter(refuse: Refusal) -> None:
    words = ["run", "paper_arm", "--set", "link.uplink.distribution=empirical"]
    message = refuse(*words, "--set", "link.uplink.jitter_ms=2")
    assert "link.uplink.distribution_file = null: must be a file of delays in ms" in message
    assert "link.uplink.jitter_ms = 2: must be left at 0" in message


def test_reference_out_of_reach_is_refused(refuse: Refusal) -> None:
    message = refuse("run", "paper_arm", "--set", "reference.x.offset_m=9")
    assert "must stay within the arm's reach and joint limits" in message


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
        (JOINTLESS, "no revolute or continuous joint"),
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


@pytest.mark.parametrize(
    ("value", "complaint"),
    [
        ("link.can.interface=nope", "'nope': must be one that python-can knows"),
        ("link.can.interface=virtual", "'virtual': reaches no other process"),
        ("link.can.channel=10.0.0.1", "'10.0.0.1': must be a multicast address"),
        ("link.can.bitrate=42", "42: must be 125000, 250000, 500000, 800000 or 1000000"),
        ("link.can.node_ids=[1, 2, 2]", "given more than once: [2]"),
        ("link.can.node_ids=[1, 2]", f"one for {ONE_EACH}"),
        ("link.can.eds=/etc/hostname", "'/etc/hostname': must be a file that is an EDS"),
        ("link.can.faults.drives=['drive:9@1s']", "must name one of the nodes 1, 2, 3"),
        ("link.uplink.jitter_ms=1", "link.uplink = {'jitter_ms': 1.0}: must be delay_ms alone"),
        ("rate_hz=2000", "the nearest rate that fits is 1000 Hz"),
    ],
)
def test_can_bus_that_cannot_be_is_refused(refuse: Refusal, value: str, complaint: str) -> None:
    assert complaint in refuse("run", "paper_arm_can", "--set", value)


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
