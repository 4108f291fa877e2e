"""Extensions of an installed package: each kind runs, and is named where users look for it."""

from __future__ import annotations

import shutil
import socket
import tomllib
from pathlib import Path

import numpy as np
import pytest

from bus_schema.messages import topics
from bus_schema.registry import REGISTRIES
from bus_schema.runtime.extensions import installed
from controller.chunks.answer import Answer, Holding
from controller.chunks.configuration import ChunksConfiguration
from controller.laws import LAWS
from deploy.reports.runs.run_panels import RUN_FIGURES
from deploy.run.confirmation import other_physics
from deploy.run.run_folder import manifest_of
from deploy.run.simulate import simulate
from deploy.scenario.effective import effective_scenario
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError
from deploy.study.execution.provenance import provenance_of
from plant_emulator.drives.commissioning import DRIVES
from plant_emulator.physics.engines import ENGINES, engine_name
from plant_emulator.robot_servers.robot_server import ROBOT_SERVERS
from tests.arms import INSTALLED
from tests.controller.compensation.prediction_bench import Bench, compensation_of

SHORT = "duration_s=0.2"
EXAMPLE = Path(__file__).with_name("package")
COMPENSATED = "controller.delay_compensation={enabled: true, predictor: constant_velocity}"
SCALED = "faults=[{kind: encoder_scaled, joint: elbow, factor: 1.01, at_s: 0.1}]"
FLYWHEELS = "plant.physics.engine=flywheels"


def run(*overrides):
    return simulate(load_setup("paper_arm", [SHORT, *overrides])).data()


@pytest.mark.usefixtures("example_package")
def test_example_has_an_entry_of_each_kind():
    # imported here, so that their registries exist
    assert DRIVES.extension("toy") is not None
    assert RUN_FIGURES.extension("speeds") is not None
    assert ROBOT_SERVERS.extension("jog") is not None
    assert set(installed()) == {kind for kind, each in REGISTRIES.items() if each.shipped}


@pytest.mark.usefixtures("example_package")
def test_law_keeps_its_bounds_with_gains_of_the_scenario(tmp_path):
    gains = "controller.gains.impedance={stiffness: [6000, 11000, 900], damping_ratio: 2}"
    setup = load_setup("paper_arm", ["controller.law=impedance", gains, "duration_s=1"])
    assert setup.gains.stiffness.tolist() == [6000.0, 11000.0, 900.0]
    simulation = simulate(setup)
    errors = simulation.data().true_errors_rad
    assert np.abs(errors[-1]).max() < 0.05 < np.abs(errors[0]).max()
    file = tmp_path / "effective.yaml"
    file.write_text(effective_scenario(setup))
    assert simulate(load_setup(str(file))).data().digest == simulation.data().digest


@pytest.mark.usefixtures("example_package")
def test_predictor_keeps_the_velocities_over_a_delay_of_8_ms():
    bench = Bench(compensation_of(predictor="constant_velocity"))
    bench.run(100, 8)
    for tick in (20, 50, 99):
        (position, velocity), (_, foreseen, foreseen_rate) = (
            bench.truth[tick],
            bench.predicted[tick],
        )
        np.testing.assert_allclose(foreseen, position + 0.008 * velocity, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(foreseen_rate, velocity)
    data = run(COMPENSATED, "link.uplink.delay_ms=8", "controller.law=pid")
    assert data.faults() == []


@pytest.mark.usefixtures("example_package")
def test_robot_obeys_the_lines_of_a_client():
    jog = "plant.interface={kind: jog, own: {speed_rad_s: 0.5}}"
    setup = load_setup("paper_arm", [jog, "controller.law=proportional_velocity"])
    server = ROBOT_SERVERS["jog"](setup.scenario.plant.interface.settings, 0.002, print)
    server.open("127.0.0.59", server.ports)
    with socket.create_connection(("127.0.0.59", server.ports["jog"])) as client:
        client.sendall(b"1 0 -3\n")
        while not server.counts["lines"]:
            server.serve(1.0)
    server.close()
    server.interface.start(np.zeros(3))
    moved = [server.interface.step(None, np.zeros((2, 3))) for _ in range(11)][-1]
    np.testing.assert_allclose(moved.position_rad, 10 * 0.002 * 0.5 * np.array([1, 0, -1]))


@pytest.mark.usefixtures("example_package")
def test_fault_changes_the_readings_from_its_start():
    data = run(SCALED)
    seen = data.tables[topics.JOINT_STATES.name]["position"][:200, 2]
    true = data.tables[topics.PLANT_TRUTH.name]["position"][:200, 2]
    np.testing.assert_allclose(seen[:100], true[:100], rtol=0, atol=1e-15)
    np.testing.assert_allclose(seen[100:], 1.01 * true[100:], rtol=1e-12)


@pytest.mark.usefixtures("example_package")
def test_flywheels_of_the_engine_gain_the_momentum_of_their_torques():
    data = run(FLYWHEELS, "plant.friction.enabled=false", "plant.disturbance.enabled=false")
    truth = data.tables[topics.PLANT_TRUTH.name]
    gained = np.diff(truth["velocity"], axis=0)
    # The torque that a row shows acted over the tick before it; of 1 kg m², for 1 ms.
    np.testing.assert_allclose(gained, 1e-3 * truth["torque"][1:], rtol=0, atol=1e-12)
    assert np.abs(gained).max() > 1e-4


@pytest.mark.usefixtures("example_package")
def test_robot_of_an_interface_moves_at_its_one_speed():
    """0.1 s after its drives have caught up, a tenth of 0.5 rad/s is travelled."""
    jog = ("plant.interface={kind: jog, own: {speed_rad_s: 0.5}}", "plant.friction.enabled=false",
           "plant.disturbance.enabled=false", "controller.law=proportional_velocity")  # fmt: skip
    positions = run(*jog).tables[topics.PLANT_TRUTH.name]["position"]
    travelled = np.abs(positions[180] - positions[80])
    np.testing.assert_allclose(travelled, 0.05, rtol=0.01)


@pytest.mark.usefixtures("example_package")
def test_merge_of_a_package_takes_its_share():
    chunks = ChunksConfiguration.model_validate({"merge": "halves", "own": {"share": 0.25}})
    old, new = (
        Answer(0.0, 0.0, 0.1, np.zeros((1, 1)), np.full((4, 2, 1), value), Holding())
        for value in (1.0, 2.0)
    )
    merged = chunks.build(1e-3, 0.0, np.ones(1)).merged(old, new, 0.0)
    np.testing.assert_array_equal(merged.targets[:, 0, 0], 1.25)
    law = ("controller.law=streaming", "plant.interface.kind=servoj")
    assert run(*law, "controller.chunks={merge: halves}").faults() == []
    with pytest.raises(ScenarioError, match=r"own\.shar: unknown key; did you mean share"):
        load_setup("paper_arm", [*law, "controller.chunks={merge: halves, own: {shar: 1}}"])


@pytest.mark.usefixtures("example_package")
def test_report_of_a_run_has_the_figure_of_a_package(funnel_hil, tmp_path):
    import funnel_hil as api

    funnel_hil("simulate", "paper_arm", "--set", SHORT, "--out", str(tmp_path / "run"))
    page = (tmp_path / "run" / "report.html").read_text()
    assert '<figure class="card" id="speeds"><h3>Speeds of the joints</h3>' in page
    run = api.load_run(tmp_path / "run")
    shown = run.figure("speeds").data[1].y
    assert shown.tolist() == run.table("plant_truth")["velocity"][:, 1].tolist()


@pytest.mark.parametrize(("draws", "reason"), [
    ("1 / 0", "ZeroDivisionError"), ("'text'", "gives a str, not a plotly figure"),
])  # fmt: skip
def test_figure_that_raises_is_left_out_and_named(
    draws, reason, add_package, funnel_hil, tmp_path, caplog
):
    source = (
        "from deploy.reports.page import Panel\n"
        f"BAD = Panel('Motion', 'bad', 'Bad', lambda _: {draws}, 'It raises.')\n"
    )
    module = f"figure_of_{len(draws)}"  # a module is imported once in a process
    (tmp_path / f"{module}.py").write_text(source)
    both = {"bad": f"{module}:BAD", "worse": "deploy.reports.page:Panel"}
    add_package(project(group="figures", **both), tmp_path)
    funnel_hil("simulate", "paper_arm", "--set", SHORT, "--out", str(tmp_path / "run"))
    assert 'id="bad"' not in (tmp_path / "run" / "report.html").read_text()
    assert "bad (funnel_hil.figures) of" in caplog.text
    assert reason in caplog.text


@pytest.mark.usefixtures("example_package")
def test_manifest_and_provenance_name_the_packages_that_a_run_uses():
    setup = load_setup("paper_arm", [SHORT, FLYWHEELS, SCALED])
    assert manifest_of([setup])["extensions"] == [
        "encoder_scaled (funnel_hil.faults) of funnel-hil-example 1.2",
        "flywheels (funnel_hil.engines) of funnel-hil-example 1.2",
    ]
    simulate(setup)
    made_by = provenance_of(setup, confirm=False, read={})
    assert made_by["funnel-hil-example"] == "1.2"
    sources = {part.rpartition("/")[2] for part in made_by if "/package/" in part}
    assert {"fault.py", "engine.py", "flywheels.py"} <= sources
    without = load_setup("paper_arm", [SHORT])
    assert "extensions" not in manifest_of([without])
    assert "funnel-hil-example" not in provenance_of(without, confirm=False, read={})


@pytest.mark.usefixtures("example_package")
def test_confirmation_uses_engines_of_packages_only_if_the_scenario_does():
    without = load_setup("paper_arm", [SHORT])
    assert [name for name in other_physics(without) if "Flywheels" in name] == []
    assert "funnel-hil-example" not in provenance_of(without, confirm=True, read={})
    setup = load_setup("paper_arm", [SHORT, FLYWHEELS])
    others = other_physics(setup)
    assert {engine_name(each.scenario.plant) for each in others.values()} == {
        name for name in ENGINES.shipped if name in INSTALLED
    }
    made_by = provenance_of(setup, confirm=True, read={})
    assert made_by["funnel-hil-example"] == "1.2"
    assert "mujoco" in made_by


def test_study_refuses_to_continue_after_an_edit_of_a_package(add_package, funnel_hil, tmp_path):
    shutil.copytree(EXAMPLE, tmp_path / "mine")
    add_package(
        tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"], tmp_path / "mine"
    )
    words = ("compare", "paper_arm", "--laws", "impedance", "--set", "duration_s=0.05")
    funnel_hil.output(*words, "--out", tmp_path / "out")
    with (tmp_path / "mine/funnel_hil_example/law.py").open("a") as law:
        law.write("# edited\n")
    output = funnel_hil.output(*words, "--out", tmp_path / "out", code=2)
    assert "mine/funnel_hil_example/law.py" in output


@pytest.mark.usefixtures("example_package")
@pytest.mark.parametrize(
    ("override", "named"),
    [
        ("controller.law=imperance", "impedance"),
        ("controller.gains.impedance.stiffness=-1", "stiffness"),
        ("controller.delay_compensation.predictor=constant", "constant_velocity"),
        ("faults=[{kind: encoder_scalled, joint: elbow, factor: 1, at_s: 0}]", "encoder_scaled"),
        ("plant.physics.engine=flywheel", "flywheels"),
        ("link.can.protocol=toi", "toy"),
        ("link.kind=loop", "loopback"),
        ("plant.interface.kind=jogg", "jog"),
        ("plant.interface={kind: jog, own: {speed_rad_s: fast}}", "interface.own.speed_rad_s ="),
    ],
)
def test_refusal_names_the_entries_of_packages(override, named):
    with pytest.raises(ScenarioError, match=r"--set .*must be .*") as refused:
        load_setup("paper_arm", [SHORT, override])
    assert named in str(refused.value)


@pytest.mark.usefixtures("example_package")
def test_laws_of_packages_are_in_options_and_benchmark(funnel_hil):
    from deploy.studies.benchmark.command import BenchmarkOptions

    assert "impedance" in BenchmarkOptions().definition()["laws"]
    output = funnel_hil.output("compare", "paper_arm", "--laws", "nolaw", code=2)
    assert "impedance" in output


def project(name="funnel-hil-broken", group="laws", **entries):
    return {
        "name": name, "version": "0.3", "entry-points": {f"funnel_hil.{group}": entries}
    }  # fmt: skip


BROKEN = {
    "module is missing": ("laws", "controller.law=new", "no_such_module:LAW", "No module named"),
    "attribute is missing": ("laws", "controller.law=new", "json:LAW", "has no attribute"),
    "another type": ("laws", "controller.law=new", "json:dumps", "controller.laws.LawEntry"),
    "predictor that is not compiled": (
        "predictors", COMPENSATED.replace("constant_velocity", "new"), "json:dumps", "Dispatcher",
    ),
    "fault": ("faults", "faults=[{kind: new, at_s: 0}]", "no_such_module:F", "No module named"),
    "engine": ("engines", "plant.physics.engine=new", "no_such_module:E", "No module"),
    "interface": ("interfaces", "plant.interface.kind=new", "no_such_module:I", "No module named"),
    "interface of another type": (
        "interfaces", "plant.interface.kind=new", "json:dumps", "settings.InterfaceSettings",
    ),
    "protocol": ("drive_protocols", "link.can.protocol=new", "no_such_module:P", "No module"),
    "protocol of another type": (
        "drive_protocols", "link.can.protocol=new", "json:dumps", "can.protocol.DriveProtocol",
    ),
    "protocol without drives": (
        "drive_protocols", "link.can.protocol=new", "funnel_hil_example.protocol:ToyProtocol",
        "has no drives: its package must add new to funnel_hil.drives too",
    ),
    "link": ("link_kinds", "link.kind=new", "no_such_module:L", "No module named"),
}  # fmt: skip


@pytest.mark.parametrize("case", BROKEN)
def test_broken_extension_is_refused_by_package_and_group_and_disturbs_nothing_else(
    case, add_package, funnel_hil, nothing_starts
):
    group, override, place, reason = BROKEN[case]
    add_package(project(group=group, new=place), EXAMPLE)
    output = funnel_hil.output("simulate", "paper_arm", "--set", override, code=2)
    assert f"new (funnel_hil.{group}) of funnel-hil-broken 0.3" in output
    assert reason in output
    assert "Traceback" not in output
    load_setup("paper_arm", ["controller.gains.pid.proportional=1"])  # another law's gains


@pytest.mark.parametrize("scenario", ["paper_arm", "paper_arm_can"])
@pytest.mark.parametrize(
    ("place", "reason"),
    [("no_such_module:D", "No module named"), ("json:dumps", "plant_emulator.drives.drive.Drive")],
)
def test_protocol_with_broken_drives_is_refused_before_a_run(scenario, place, reason, add_package):
    both = project(group="drive_protocols", new="funnel_hil_example.protocol:ToyProtocol")
    both["entry-points"]["funnel_hil.drives"] = {"new": place}
    add_package(both, EXAMPLE)
    with pytest.raises(ScenarioError, match=r"new \(funnel_hil\.drives\) of .*-broken") as refused:
        load_setup(scenario, ["link.can.protocol=new"])
    assert reason in str(refused.value)


OWN = "plant.interface={kind: jog, own: %s}"
CAN = "link.can={protocol: toy, settings: %s}"
GAINS = "controller={law: impedance, gains: {impedance: %s}}"
FAULT = "faults=[%s]"
WRONG_SETTINGS = [
    (OWN, "{sped_rad_s: 1}", "plant.interface.own.sped_rad_s: unknown key; did you mean speed_rad"),
    (OWN, "{speed_rad_s: a}", "plant.interface.own.speed_rad_s = 'a': must be a valid number"),
    (CAN, "{sample_identifer: 3}", "identifer: unknown key; did you mean sample_identifier?"),
    (CAN, "{sample_identifier: a}", "settings.sample_identifier = 'a': must be a valid integer"),
    (GAINS, "{stiff: 3}", "gains.impedance.stiff: unknown key; did you mean stiffness?"),
    (FAULT, "{kind: encoder_scaled, joint: elbow, factr: 2, at_s: 0.1}",
     "factr: unknown key; did you mean factor?"),
]  # fmt: skip


@pytest.mark.usefixtures("example_package")
@pytest.mark.parametrize(("place", "values", "words"), WRONG_SETTINGS)
def test_wrong_settings_of_extensions_are_refused_alike_with_what_is_allowed(place, values, words):
    with pytest.raises(ScenarioError) as refused:
        load_setup("paper_arm", [place % values])
    assert f"--set {place % values}: " in str(refused.value)
    assert words in str(refused.value)


SOURCES = {
    "law without gains": (
        "laws", "controller.law=new", "a NamedTuple with a method from_inertia",
        "from controller.laws import LawEntry\nNEW = LawEntry(print, dict)",
    ),
    "fault without its kind": (
        "faults", "faults=[{kind: new, at_s: 0}]", "must declare kind: Literal['new']",
        "from plant_emulator.faults.fault import Fault\nclass NEW(Fault): kind: str",
    ),
    "engine without its class": (
        "engines", "plant.physics.engine=new", "no_such_module:Arm cannot be loaded",
        "from plant_emulator.physics.engines import PhysicsEngine\n"
        "NEW = PhysicsEngine('New', 'json', 'no_such_module:Arm', ('semi_implicit_euler',))",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", SOURCES)
def test_entry_that_is_incomplete_is_refused_with_what_it_lacks(
    case, add_package, funnel_hil, tmp_path
):
    group, override, reason, source = SOURCES[case]
    module = f"incomplete_{group}"
    (tmp_path / f"{module}.py").write_text(f"{source}\n")
    add_package(project(group=group, new=f"{module}:NEW"), tmp_path)
    output = funnel_hil.output("simulate", "paper_arm", "--set", override, code=2)
    assert reason in output
    with pytest.raises(ScenarioError, match="encoder_stuck"):  # other refusals go on working
        load_setup("paper_arm", ["faults=[{kind: encoder_stick, joint: elbow, at_s: 0}]"])


def test_name_that_two_packages_or_funnel_hil_have_is_refused(add_package, funnel_hil):
    add_package(project("funnel-hil-one", same="json:dumps", smc="json:dumps"))
    add_package(project("funnel-hil-two", same="json:dumps"))
    for law, owners in {
        "same": ["funnel-hil-one 0.3", "funnel-hil-two 0.3"],
        "smc": ["funnel-hil itself", "funnel-hil-one 0.3"],
    }.items():
        words = ("simulate", "paper_arm", "--set", f"controller.law={law}")
        output = funnel_hil.output(*words, code=2)
        assert all(owner in output for owner in owners)
    assert load_setup("paper_arm", ["controller.law=pid"]).scenario.controller.law == "pid"


def test_doctor_lists_extensions_and_their_problems(add_package, example_package):
    from deploy.cli.doctor import _extensions

    add_package(project(new="no_such_module:LAW") | {"version": "0.3"})
    add_package(project("funnel-hil-typing", group="lawz", mine="json:dumps"))
    found = {each.name: each for each in _extensions()}
    assert found["extension impedance"].status == found["extension toy"].status == "ok"
    assert "No module named" in found["extension new"].found
    assert "funnel_hil.laws" in found["extension mine"].found
    assert {found[f"extension {name}"].status for name in ("new", "mine")} == {"limited"}


def test_packages_are_not_imported_before_they_are_used(add_package, tmp_path):
    (tmp_path / "loud_law.py").write_text("raise RuntimeError('imported')\n")
    add_package(project(loud="loud_law:LAW"), tmp_path)
    simulate(load_setup("paper_arm", ["duration_s=0.01"]))
    with pytest.raises(ScenarioError, match="RuntimeError: imported"):
        load_setup("paper_arm", ["controller.law=loud"])


def test_same_package_twice_on_the_search_path_counts_once(add_package, tmp_path, monkeypatch):
    from tests.deploy.extensions.conftest import install

    install(project(one="json:dumps"), tmp_path / "elsewhere")
    monkeypatch.syspath_prepend(str(tmp_path / "elsewhere"))
    add_package(project(one="json:dumps"))
    assert len(installed()["laws"]["one"]) == 1


def test_published_reference_is_the_same_beside_an_installed_package(add_package):
    pytest.importorskip("sphinx")
    from deploy.docs import generated_reference

    before = generated_reference.scenario()
    add_package(tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"], EXAMPLE)
    assert "impedance" in LAWS
    assert generated_reference.scenario() == before
