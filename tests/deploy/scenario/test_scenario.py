"""Shipped scenarios load, overrides take the schema's types, the effective scenario is whole."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from deploy.run.simulate import simulate
from deploy.scenario.effective import effective_scenario, effective_values
from deploy.scenario.referenced_files import data_files
from deploy.scenario.scenario import SHIPPED, load_setup
from deploy.scenario.yaml_files import ScenarioError, plain

NAMES = sorted(path.stem for path in SHIPPED.glob("*.yaml"))


@pytest.mark.parametrize("name", NAMES)
def test_shipped_scenario_loads_under_its_own_name(name: str) -> None:
    setup = load_setup(name)
    assert setup.scenario.name == name
    # Over CAN they run 5 s at 500 Hz, the others 20 s at 1 kHz.
    assert setup.ticks == (2_500 if setup.scenario.link.kind == "can" else 20_000)
    assert setup.start_position_rad.shape == (setup.robot.joints,)
    assert np.all(setup.start_position_rad > setup.robot.lower_rad)
    assert np.all(setup.start_position_rad < setup.robot.upper_rad)


@pytest.mark.parametrize(
    ("key", "given", "expected"),
    [
        ("duration_s", "2", 2.0),
        ("seed", "7", 7),
        ("clock", "lockstep", "lockstep"),
        ("plant.friction.enabled", "false", False),
        ("link.deadline_ms", "3", 3.0),
        ("link.deadline_ms", "null", None),
        ("plant.friction.coulomb_nm", "3", [3.0]),
        ("plant.friction.coulomb_nm", "1e1", [10.0]),  # for YAML 1.1 alone, this is a string
        ("robot.initial_offset_rad", "[0, 0.1, 0]", [0.0, 0.1, 0.0]),
        ("link.uplink", "{delay_ms: 1}", {"delay_ms": 1.0}),
        ("controller.gains.pid.proportional", "5", [5.0]),
        (
            "plant.disturbance.terms",
            "[{joint: all, kind: constant, torque_nm: 1}]",
            [{"joint": "all", "kind": "constant", "torque_nm": 1.0}],
        ),
    ],
)
def test_override_takes_the_type_of_its_key(key: str, given: str, expected: object) -> None:
    value: Any = plain(load_setup("paper_arm", [f"{key}={given}"]).scenario)
    for part in key.split("."):
        value = value.get(part)
    if isinstance(expected, dict):
        value = {name: value[name] for name in expected}  # the rest are defaults
    assert repr(value) == repr(expected)  # 2 is not 2.0


def test_override_leaves_the_keys_beside_it_alone() -> None:
    before = plain(load_setup("paper_arm").scenario)
    after = plain(load_setup("paper_arm", ["plant.friction.viscous_nm_s=0"]).scenario)
    assert after["plant"]["friction"].pop("viscous_nm_s") == [0.0]
    before["plant"]["friction"].pop("viscous_nm_s")
    assert after == before


def test_all_mistakes_are_reported_at_once() -> None:
    with pytest.raises(ScenarioError) as refused:
        load_setup("paper_arm", ["duration=1", "seed=-1"])
    assert "duration: unknown key" in str(refused.value)
    assert "seed = -1: must be" in str(refused.value)


DRIVES = (
    "controller.delay_compensation={enabled: true, expected_round_trip_ms: 12.5}",
    "controller.drive_feedback.enabled=true", "plant.drive_feedback.damping_nm_s=4",
)  # fmt: skip


@pytest.mark.parametrize(("name", "more"), [*((name, ()) for name in NAMES), ("paper_arm", DRIVES)])
def test_effective_scenario_says_all_that_was_in_force(name, more, tmp_path):
    short = ["duration_s=0.05", "plant.encoder.velocity_noise_rad_s=0.001", *more]
    if load_setup(name).scenario.link.kind == "can":
        short.append(
            "link.can.interface=virtual"
        )  # whose drives answer however busy the machine is
    setup = load_setup(name, short)
    file = tmp_path / "elsewhere.yaml"
    file.write_text(effective_scenario(setup))
    again = load_setup(str(file))
    unchosen = {"link": plain(setup.scenario.link), "metrics": plain(setup.scenario.metrics)}
    assert plain(again.scenario) == effective_values(setup) | unchosen
    assert plain(again.gains) == plain(setup.gains)
    assert effective_scenario(again) == effective_scenario(setup)
    assert simulate(again).data().digest == simulate(setup).data().digest


@pytest.mark.parametrize(
    "setting",
    [
        "link.uplink={distribution: empirical, distribution_file: delays.csv}",
        "reference={kind: csv, file: motion.csv}",
        "robot.urdf=arm.urdf",
    ],
)
def test_path_that_is_set_starts_in_current_folder(setting, tmp_path, monkeypatch):
    robot = load_setup("paper_arm").robot
    names = ",".join(f"{name}.position_rad" for name in robot.joint_names)
    files = {
        "delays.csv": "1\n",
        "motion.csv": f"time_s,{names}\n" + "".join(f"{row},0.1,0.1,0.1\n" for row in range(3)),
        "arm.urdf": robot.path.read_text(),
        "mine.yaml": "name: mine\nextends: paper_arm\n",
    }
    for folder in ("here", "beside"):
        (tmp_path / folder).mkdir()
        for name, text in files.items():
            (tmp_path / folder / name).write_text(text)
    monkeypatch.chdir(tmp_path / "here")
    for scenario in ("paper_arm", "../beside/mine.yaml"):
        setup = load_setup(scenario, [setting, "duration_s=1"])
        paths = [setup.robot.path, *data_files(setup.scenario).values()]
        assert tmp_path / "here" in {path.parent for path in paths}


def test_scenario_extends_one_that_extends_another(tmp_path, monkeypatch):
    """The nearest file decides each key; a name is searched beside the file that has it."""
    (tmp_path / "base").mkdir()
    (tmp_path / "base" / "middle.yaml").write_text(
        "extends: panda_motors\nseed: 5\nplant: {payload_kg: 1}\nfunnel: {rate_per_s: 3}\n"
    )
    (tmp_path / "base" / "near.yaml").write_text("extends: middle.yaml\nplant: {payload_kg: 2}\n")
    (tmp_path / "mine.yaml").write_text("extends: base/near.yaml\nname: mine\nseed: 7\n")
    monkeypatch.chdir(tmp_path / "base")
    setup, shipped = load_setup("../mine.yaml"), load_setup("panda_motors")
    assert setup.scenario.name == "mine"
    assert setup.scenario.seed == 7
    assert setup.scenario.plant.payload_kg == 2.0
    assert setup.scenario.funnel.rate_per_s == 3.0
    assert setup.robot.path == shipped.robot.path  # of panda, which panda_motors extends
    assert plain(setup.scenario.plant.friction) == plain(shipped.scenario.plant.friction)


@pytest.mark.parametrize("scenario", ["paper_arm", "panda"])
@pytest.mark.parametrize("final", ["0.2", "2.5", "0.04"])
def test_conflict_of_a_final_bound_names_values_that_resolve_it(scenario: str, final: str) -> None:
    with pytest.raises(ScenarioError, match="must not exceed the bounds at time zero") as caught:
        load_setup(scenario, [f"funnel.final_rad={final}", "robot.initial_offset_rad=0.001"])
    named = dict(re.findall(r"(funnel\.\w+) to at least ([\d.]+)", str(caught.value)))
    assert "funnel.overshoot_margin_rad" in named
    assert ("funnel.widest_rad" in named) is (final == "2.5")
    settings = [f"{key}={value}" for key, value in named.items()]
    fixed = [f"funnel.final_rad={final}", "robot.initial_offset_rad=0.001", *settings]
    assert load_setup(scenario, fixed).funnel.final_rad[0] == float(final)
    for number, (key, value) in enumerate(named.items()):  # none is needlessly high
        fixed[2 + number] = f"{key}={float(value) - 0.002}"
        with pytest.raises(ScenarioError, match="must not exceed"):
            load_setup(scenario, fixed)
        fixed[2 + number] = f"{key}={value}"


@pytest.mark.parametrize(
    ("text", "delay_ms"),
    [("'010'", 10), ("007", 7), ("00", 0), ("08", 8), ("0x10", 16), ("1_000", 1000), ("1e1", 10)],
)
def test_numbers_that_yaml_reads_as_people_do_are_taken(text: str, delay_ms: float) -> None:
    setup = load_setup("paper_arm", [f"link.uplink.delay_ms={text}"])
    assert setup.scenario.link.uplink.delay_ms == delay_ms


@pytest.mark.parametrize(("text", "read"), [("010", "8"), ("1:30", "90")])
def test_override_that_yaml_reads_unlike_people_is_refused(text: str, read: str) -> None:
    with pytest.raises(ScenarioError, match=f"delay_ms={text}: '{text}' must .* as {read}$"):
        load_setup("paper_arm", [f"link.uplink.delay_ms={text}"])
