"""Runs over CAN in which drives close loops of their own in their protocols' position modes."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from bus_schema.can.cia402.codec import rated_torque_nm
from bus_schema.messages.topics import PLANT_TRUTH
from bus_schema.runtime.modes import Mode
from controller.reference import sample_positions
from deploy.runs.judging.metrics import summarise
from deploy.runs.run_data import RunData
from deploy.runs.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError
from tests.multicast import own_bus

TURN = 2 * np.pi
FEEDBACK = "controller.drive_feedback.enabled=true"
GIVEN = (FEEDBACK, "link.can.interface=virtual", "link.can.answer_timeout_s=60")
PROTOCOLS = {
    "cia402": (),
    "cansimple": ("link.can.protocol=cansimple", "link.can.cansimple.input_torque_scale=40"),
}


def run(*overrides: str, log: Path | None = None) -> RunData:
    return simulate(load_setup("paper_arm_can", [*GIVEN, *overrides]), can_log=log).data()


def frames(log: Path, identifier: int) -> list[bytes]:
    fields = [line.split()[2].split("#") for line in log.read_text().splitlines()]
    return [
        bytes.fromhex(content)
        for each, content in fields
        if int(each, 16) == identifier and content != "R"
    ]


@pytest.fixture(scope="module", params=PROTOCOLS)
def done(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory):  # type: ignore[no-untyped-def]
    log = tmp_path_factory.mktemp("position") / "can.log"
    return request.param, run("duration_s=0.6", *PROTOCOLS[request.param], log=log), log


def test_bounds_are_kept_as_with_drives_that_are_no_can_nodes(done) -> None:  # type: ignore[no-untyped-def]
    """The same laws, gains and targets without CAN between them: what differs is rounding."""
    _, data, _ = done
    setup = load_setup("paper_arm_can", [FEEDBACK, "duration_s=0.6", "link.kind=in_process"])
    without, over_can = summarise(simulate(setup).data()), summarise(data)
    assert over_can["completed"]
    assert over_can["faults"] == []
    assert over_can["bounds"]["kept"]
    assert over_can["bounds"]["margin_min"] == pytest.approx(
        without["bounds"]["margin_min"], abs=0.01
    )


def test_frames_carry_reference_and_torque_and_the_drives_were_given_the_gains(done) -> None:  # type: ignore[no-untyped-def]
    protocol, data, log = done
    setup = data.setup
    stiffness, damping = (each[1] for each in setup.drive[1:])
    if protocol == "cia402":
        said = [struct.unpack("<Hih", each) for each in frames(log, 0x402)]
        to_rad = TURN / setup.scenario.link.can.counts_per_turn
        targets = [counts * to_rad for word, counts, _ in said if word == 0x0F]
        rated_nm = rated_torque_nm(setup.scenario.link.can, setup.robot)[1]
        step_nm = rated_nm / 1000
        gains = [struct.unpack("<4xI", each)[0] for each in frames(log, 0x602)
                 if each[:4] in (b"\x23\xfb\x60\x01", b"\x23\xf9\x60\x01")]  # fmt: skip
        wanted = [round(1000 * stiffness / damping), round(1000 * damping)]
    else:
        said = [struct.unpack("<fhh", each) for each in frames(log, 2 << 5 | 0x0C)]
        targets = [turns * TURN for turns, _, _ in said]
        step_nm = 1 / 40
        gains = [*struct.unpack("<f", frames(log, 2 << 5 | 0x1A)[-1]),
                 struct.unpack("<ff", frames(log, 2 << 5 | 0x1B)[-1])[0]]  # fmt: skip
        wanted = [stiffness / damping, damping * TURN]
    assert gains == pytest.approx(wanted, rel=1e-5)
    times_s = data.times_s(PLANT_TRUTH)[:300]
    reference = sample_positions(setup.reference, times_s, setup.robot.joints)[:, 1]
    assert np.abs(np.array(targets)[:, None] - reference).min(axis=0).max() < 1e-4
    commanded = data.tables["joint_commands"]["effort"][:, 1]
    assert set(np.rint(commanded / step_nm)) <= {steps for _, _, steps in said}


def test_same_run_gives_the_same_bits_on_another_interface(done) -> None:  # type: ignore[no-untyped-def]
    protocol, data, _ = done
    again = run("duration_s=0.6", *PROTOCOLS[protocol], *own_bus())
    assert again.digest == data.digest


def test_torques_without_targets_keep_bounds_too() -> None:
    """The drives could take targets, and the controller sends none."""
    data = run("duration_s=0.4", "controller.drive_feedback.enabled=false",
               "plant.drive_feedback.enabled=true")  # fmt: skip
    assert summarise(data)["bounds"]["kept"]
    assert data.faults() == []


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_all_joints_come_to_rest_when_one_drive_fails(protocol: str) -> None:
    data = run("duration_s=2", *PROTOCOLS[protocol], "link.can.faults.drives=['drive:2@300ms']")
    assert not summarise(data)["completed"]
    truth = data.tables[PLANT_TRUTH.name]
    assert truth["mode"][-1] == Mode.STOPPING
    assert np.abs(truth["velocity"][-1]).max() < 0.02


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_targets_that_stop_coming_end_in_the_drives_own_timeout(protocol: str) -> None:
    data = run("duration_s=2", *PROTOCOLS[protocol], "link.can.faults.bus_off_s=0.3")
    assert not summarise(data)["completed"]
    assert np.abs(data.tables[PLANT_TRUTH.name]["velocity"][-1]).max() < 0.02


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (["link.can.protocol=cansimple"],
         r"link\.can\.cansimple\.input_torque_scale = 1000.*at most 46\.81"),
        (["plant.drive_feedback.damping_nm_s=0"], r"plant\.drive_feedback\.damping_nm_s = 0"),
        (["rate_hz=1000"], r"RPDOs 8 and 4 bytes"),
    ],
)  # fmt: skip
def test_scenarios_that_do_not_fit_are_refused(overrides: list[str], told: str) -> None:
    with pytest.raises(ScenarioError, match=told):
        load_setup("paper_arm_can", [*GIVEN, *overrides])
