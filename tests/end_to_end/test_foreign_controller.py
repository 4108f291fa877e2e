"""A controller of the user's own on the bus: started by `run` for a scenario, or awaited."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from running import Finished, funnel_hil_here, settings, started

from deploy.judge.run_data import FOREIGN
from deploy.run.processes.program import program_variables
from deploy.scenario.scenario import load_setup
from tests.waiting import HANG_S, free_endpoint

CLIENT = [sys.executable, str(Path(__file__).with_name("limited_client.py"))]
WIDE = {"convergence_margin_rad": 1.0, "overshoot_margin_rad": 1.0, "final_rad": 0.9}
POINT = {"kind": "minimum_jerk", "waypoints": [{"time_s": 0, "position_rad": [0.2, -0.3, 0.5]}]}
SHORT: dict[str, Any] = {
    "duration_s": 0.2, "reference": POINT, "funnel": WIDE, "link__publish_reference": True
}  # fmt: skip
LOCKSTEP = {**SHORT, "clock": "lockstep"}
NAME = "process: limited_client"


def run(out: Path, *, code: int = 0, with_report: bool = False, **values: Any) -> Finished:
    words = ["run", "paper_arm", *settings(**values)]
    return funnel_hil_here(*words, out=out, code=code, with_report=with_report)


def test_a_process_is_judged_by_its_joint_states_alone(tmp_path: Path) -> None:
    ended = run(tmp_path / "run", with_report=True, **LOCKSTEP, controller__process=CLIENT)
    summary = ended.summary
    assert summary["law"] == NAME
    assert summary["completed"]
    assert summary["bounds"]["kept"]
    assert summary["transport"]["downlink"]["delivered"] == summary["ticks"] == 200
    assert min(summary["torque"]["peak_nm"]) > 10.0
    assert summary["timing"]["control_step_us"]["p50"] is None
    assert NAME in (ended.folder / "report.html").read_text()
    assert f"law: {NAME}" in ended.output
    assert "fixed_time_neural" not in ended.output
    assert (ended.folder / "controller_stdout.log").read_text() == "200 states answered\n"


def test_in_lockstep_it_gives_the_same_bits_again_under_delay_too(tmp_path: Path) -> None:
    late = {**LOCKSTEP, "link__uplink__delay_ms": 0.6, "link__downlink__delay_ms": 0.4}
    first, second = (
        run(tmp_path / name, **late, controller__process=CLIENT) for name in ("first", "second")
    )
    assert first.digest == second.digest
    assert first.summary["timing"]["round_trip_us"]["p50"] == 1000.0


def test_torques_for_the_next_ticks_in_one_command_give_the_bits_of_one_command_for_each(tmp_path):
    client = [sys.executable, "-m", "tests.end_to_end.chunk_client"]
    each = run(tmp_path / "each", **LOCKSTEP, controller__process=[*client, "each"])
    rows = run(
        tmp_path / "rows", **LOCKSTEP, controller__process=[*client, "rows"], controller__every=4
    )
    assert each.summary["transport"]["downlink"]["delivered"] == 200
    assert rows.summary["transport"]["downlink"]["delivered"] == 50
    assert rows.summary["timing"]["deadline_misses"] == 0
    for name in ("rms_nm", "peak_nm", "total_variation_nm_per_s", "share_above_50_hz"):
        assert rows.summary["torque"][name] == each.summary["torque"][name]
    for quantity in ("torque", "position", "velocity"):
        truths = [ended.data.tables["plant_truth"][quantity] for ended in (each, rows)]
        assert (truths[0] == truths[1]).all()


@pytest.mark.parametrize(
    ("process", "first"),
    [
        (
            [*CLIENT, "fail", "100"],
            "failed with exit code 1: RuntimeError: the encoder of my own is gone",
        ),
        ([*CLIENT, "leave", "100"], "ended by itself with exit code 0: it printed no message"),
        (["sh", "-c", "echo no such gain >&2; exit 3"], "failed with exit code 3: no such gain"),
        ([os.devnull], None),
    ],
    ids=["fails", "leaves", "fails at once", "cannot be run"],
)
def test_how_it_failed_is_the_first_cause(process, first, tmp_path):
    code = 2 if first is None else 1
    ended = run(tmp_path / "run", **LOCKSTEP, controller__process=process, code=code)
    if first is None:
        assert "['/dev/null']: must begin with an executable program" in ended.output
        assert not ended.folder.exists()
        return
    assert ended.summary["faults"][0].startswith("the controller (process: ")
    assert ended.summary["faults"][0].endswith(first)
    assert not ended.summary["completed"]


def test_silence_that_the_plant_gave_up_on_comes_before_the_end_of_the_process(tmp_path):
    """Whoever falls silent, and ends in order once the plant has left, did not end the run."""
    silent = [*CLIENT, "silence", "100"]
    impatient = {**LOCKSTEP, "link__reply_timeout_s": 2}
    ended = run(tmp_path / "run", **impatient, controller__process=silent, code=1)
    faults = ended.summary["faults"]
    assert faults[0] == "the plant failed: the controller is silent: no reply to a state within 2 s"
    assert not any("ended by itself" in fault for fault in faults)


def test_what_it_started_itself_does_not_outlive_the_run(tmp_path: Path) -> None:
    pid = tmp_path / "pid"
    script = f'sleep 1000 & echo $! > {pid}; exec "$0" "$@"'
    run(tmp_path / "run", **LOCKSTEP, controller__process=["sh", "-c", script, *CLIENT])
    state = Path(f"/proc/{int(pid.read_text())}/stat")
    assert not state.exists() or state.read_text().rpartition(")")[2].split()[0] == "Z"


@pytest.fixture
def client_from_elsewhere() -> Iterator[tuple[dict[str, str], Any]]:
    """Endpoints, and a function that starts the foreign client at them."""
    at = {"plant_endpoint": free_endpoint(), "controller_endpoint": free_endpoint()}
    clients = []

    def start() -> None:
        link = [f"link.{key}={value}" for key, value in at.items()]
        setup = load_setup("paper_arm", link)
        variables = program_variables(setup, Path("nowhere.yaml"), at["plant_endpoint"])
        clients.append(subprocess.Popen(CLIENT, env={**os.environ, **variables}))

    yield at, start
    for client in clients:
        client.kill()
        client.wait()


def test_a_controller_from_elsewhere_is_awaited_at_the_given_endpoints(
    client_from_elsewhere: tuple[dict[str, str], Any], tmp_path: Path
) -> None:
    at, start = client_from_elsewhere
    given = settings(**LOCKSTEP, **{f"link__{key}": value for key, value in at.items()},
                     link__connect_timeout_s=HANG_S)  # fmt: skip
    words = ["run", "paper_arm", *given, "--await-controller"]
    with started(*words, out=tmp_path / "run") as running:
        assert running.plant_endpoint() == at["plant_endpoint"]
        start()
        ended = running.end(0)
    assert f"the plant is at {at['plant_endpoint']}" in ended.output
    assert ended.summary["completed"]
    assert ended.summary["law"] == FOREIGN
    assert ended.summary["transport"]["downlink"]["delivered"] == 200


def test_compare_sets_it_beside_a_law(tmp_path: Path) -> None:
    given = settings(**SHORT, controller__process=CLIENT, link__uplink__delay_ms=1.0)
    words = ["compare", "paper_arm", "--laws", "process,pid", *given]
    ended = funnel_hil_here(*words, out=tmp_path / "both")
    own, pid = (ended.summary["laws"][law] for law in (NAME, "pid"))
    assert own["completed"]
    assert own["law"] == NAME
    assert own["timing"]["round_trip_us"] == pid["timing"]["round_trip_us"]
    assert min(own["torque"]["peak_nm"]) > 10.0
    funnel_hil_here("report", str(ended.folder))
