"""Whatever is set for a study takes effect in its runs, or is refused with what to use instead."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import pytest

from bus_schema.link.configuration import KeyFolder
from bus_schema.messages.topics import Role
from controller.laws import COMPARED_LAWS
from deploy.run.execute import lockstep_setup
from deploy.run.network.keys import create_authority, issue
from deploy.scenario.effective import effective_scenario
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError, parse_override
from deploy.studies.comparison.comparison import LawComparison
from deploy.studies.margin.command import MarginOptions, definition_with
from deploy.studies.margin.margin import Margin
from deploy.studies.margin.margin_study import margin_study
from deploy.studies.sweep.sweep import Sweep
from deploy.study.planned_run import PlannedRun, row_of
from tests.deploy.own_laws import own_law
from tests.deploy.study.studies import Here, conduct, made_up


def load_setups(scenario, overrides, laws):
    """The scenario under each law, as `compare` checks it."""
    fixed = dict(map(parse_override, overrides))
    values = {"scenario": scenario, "laws": laws, "set": fixed}
    return LawComparison(values, Path("compare")).variants


PLANTS = {"plants": 2, "values": "4,8", "uncertainty": "half"}
UP, DOWN = "link.uplink", "link.downlink"
COMPENSATION = "controller.delay_compensation.enabled"
DRIVES = "controller.drive_feedback.enabled"

# Options of `margin`, and the keys that it sets by itself with them, beside those of ALWAYS.
OWN_KEYS = {
    "delay": ({}, [f"{UP}.delay_ms", f"{DOWN}.delay_ms"]),
    "jitter": ({"quantity": "jitter"}, [f"{UP}.jitter_ms", f"{DOWN}.jitter_ms"]),
    "loss": ({"quantity": "loss"}, [f"{UP}.loss", f"{DOWN}.loss"]),
    "uplink": ({"direction": "uplink"}, [f"{UP}.delay_ms"]),
    "downlink loss": ({"direction": "downlink", "quantity": "loss"}, [f"{DOWN}.loss"]),
    "running": ({"running": "on", "duration": 5.0}, [f"{UP}.schedule", f"{DOWN}.schedule"]),
    "compensation": ({"compensation": "off"}, [COMPENSATION]),
    "drive loop": ({"drive_feedback": "on"}, [DRIVES]),
    "plants": (PLANTS, [f"{UP}.delay_ms", "uncertainty"]),
    "plants of a key": (PLANTS | {"quantity": "plant.actuator.lag_ms"}, ["plant.actuator.lag_ms"]),
}  # fmt: skip
ALWAYS = ["seed", "controller.law", "uncertainty"]
VALUES = {
    "seed": 3, "controller.law": "smc", COMPENSATION: True, DRIVES: False, "uncertainty": {"x": 1},
    f"{UP}.schedule": [{"kind": "outage", "at_s": 1, "for_s": 0.1}],
    f"{DOWN}.schedule": [{"kind": "outage", "at_s": 1, "for_s": 0.1}],
}  # fmt: skip
IDLE = {
    "clock": "realtime", "link.domain": 3, "link.security.enabled": True,
    "link.plant_endpoint": "tcp/127.0.0.1:7999", "link.connect_timeout_s": 3,
}  # fmt: skip


def margin(overrides=(), **options):
    options = {"laws": "smc", "overrides": list(overrides), **options}
    return margin_study(definition_with(MarginOptions(**options), {}), Path("margin"))


def sweep(grid, **more):
    return Sweep({"name": "s", "scenario": "paper_arm", "grid": grid, **more}, Path("s.yaml"))


def compare(*overrides):
    return load_setups("paper_arm", overrides, ["smc"])


def forms(key, value):
    """A value by its own key, and inside of each of its sections."""
    yield key, value
    while "." in key:
        key, _, last = key.rpartition(".")
        value = {last: value}
        yield key, value


def refusals():
    for name, (options, keys) in OWN_KEYS.items():
        always = [key for key in ALWAYS if (name, key) != ("plants of a key", "uncertainty")]
        for key in dict.fromkeys([*keys, *always]):
            yield options, key, VALUES.get(key, 0.5)


@pytest.mark.parametrize(("options", "key", "value"), list(refusals()))
def test_what_margin_sets_by_itself_cannot_be_set(options, key, value):
    for said_key, text in forms(key, value):
        with pytest.raises(ScenarioError) as refused:
            margin([f"{said_key}={json.dumps(text)}"], **options)
        assert said_key in str(refused.value)
        assert "must be" in str(refused.value)


def assert_every_study_refuses(key, value):
    for said_key, message in forms(key, value):
        text = f"{said_key}={json.dumps(message)}"
        for build in (
            lambda text=text: margin([text]),
            lambda text=text: margin([text], **PLANTS),
            lambda text=text: compare(text),
            lambda k=said_key, v=message: sweep({"plant.payload_kg": [0, 1]}, set={k: v}),
            lambda k=said_key, v=message: sweep({k: [v]}),
        ):
            with pytest.raises(ScenarioError, match="must be left out"):
                build()


@pytest.mark.parametrize(("key", "value"), IDLE.items())
def test_what_means_nothing_in_a_simulation_is_refused_by_every_study(key, value):
    assert_every_study_refuses(key, value)


@pytest.mark.parametrize(("key", "value"), [
    ("link.kind", "zenoh"), ("link.can.bitrate", 500_000), ("link.can.protocol", "cia402"),
])  # fmt: skip
def test_what_is_set_of_a_link_that_no_run_goes_over_is_refused(key, value):
    assert_every_study_refuses(key, value)


def test_a_kind_of_link_may_be_set_where_it_changes_the_run():
    can = ["link.kind=can", "link.can.interface=virtual", "link.can.bitrate=1000000"]
    assert compare(*can)
    assert load_setups("paper_arm_can", ["link.can.encoder_bits=18"], ["smc"])
    assert load_setups("paper_arm_can", ["link.kind=zenoh"], ["smc"])
    assert sweep({"link.kind": ["zenoh", "can"]}, set={"link.can.encoder_bits": 18}).expected == 2
    assert margin(["link.kind=in_process"])
    assert margin(["uncertainty={}"])  # an empty section sets nothing


def test_virtual_time_may_be_asked_for_where_there_is_no_other():
    assert compare("clock=lockstep")
    assert margin(["clock=lockstep"])
    assert sweep({"plant.payload_kg": [0]}, set={"clock": "lockstep"})


def test_keys_of_other_quantities_take_effect():
    found = margin(["link.uplink.delay_ms=8", "plant.payload_kg=1"], quantity="jitter")
    link = load_setup("paper_arm", found.cases[0].setting.at(2.0)).scenario.link
    assert (link.uplink.delay_ms, link.uplink.jitter_ms) == (8.0, 2.0)
    one_way = margin(["link.downlink.delay_ms=8"], direction="uplink")
    link = load_setup("paper_arm", one_way.cases[0].setting.at(2.0)).scenario.link
    assert (link.uplink.delay_ms, link.downlink.delay_ms) == (2.0, 8.0)


def test_a_search_over_a_key_starts_from_what_is_set():
    options = {"quantity": "plant.payload_kg", "limit": 3.0, "resolution": 0.5}
    assert margin(["plant.payload_kg=1"], **options).searches[0].steps.origin == 1.0


def test_a_whole_section_may_be_set_around_the_keys_of_a_study():
    found = margin(["link.uplink={jitter_ms: 1}"])
    link = load_setup("paper_arm", found.cases[0].setting.at(4.0)).scenario.link
    assert (link.uplink.delay_ms, link.uplink.jitter_ms) == (2.0, 1.0)


@pytest.mark.parametrize("key", ["seed", "link.domain", "link.can.nonsense"])
def test_a_quantity_without_effect_is_refused(key):
    with pytest.raises(ScenarioError, match=key):
        margin(quantity=key, limit=100.0, resolution=1.0)


@pytest.mark.parametrize(("options", "message"), [
    ({"limit": 0.1}, "at least a step, 0.5 ms"), ({"limit": -1.0}, "limit = -1.* at least a step"),
    ({"resolution": 200.0}, "at least a step, 200 ms"),
    ({"quantity": "loss", "limit": 0.001}, "at least a step, 0.005,"),
    ({"quantity": "plant.payload_kg", "limit": 0.4, "resolution": 0.5}, "a step, 0.5 kg away from"),
])  # fmt: skip
def test_a_limit_that_no_step_reaches_is_refused(options, message):
    with pytest.raises(ScenarioError, match=message):
        margin(**options)


def test_no_value_beyond_the_limit_is_tried():
    (search,) = margin(limit=1.3).searches
    assert search.steps.value(search.steps.limit) == 1.0


@pytest.mark.parametrize(("grid", "more", "message"), [
    ({"seed": [1, 2]}, {}, "under seeds"), ({"plant": [{"payload_kg": 1}]}, {"seeds": 2}, None),
    ({"plant.payload_kg": [1]}, {"set": {"plant": {"payload_kg": 2}}}, "given once"),
    ({"link.uplink.loss": [0.1]}, {"set": {"link.uplink": {"loss": 0}}}, "given once"),
    ({"link.uplink": [{"loss": 0.1}]}, {"set": {"link.uplink.loss": 0}}, "given once"),
    ({"link.uplink": [{"loss": 0.1}], "link.uplink.loss": [0]}, {}, "given once"),
    ({"plant.payload_kg": [1]}, {"plant_seed": 3}, "without plants"),
    ({"plant.payload_kg": [1]}, {"uncertainty": "half"}, "without plants"),
    ({"plant.payload_kg": [1]}, {"set": {"uncertainty": {"a": 1}}}, "--plants"),
])  # fmt: skip
def test_a_sweep_follows_the_same_rule(grid, more, message):
    if message is None:
        assert sweep(grid, **more).expected == 2
        return
    with pytest.raises(ScenarioError, match=message):
        sweep(grid, **more)


def test_sweep_takes_what_is_set_beside_its_file(funnel_hil, tmp_path):
    file = tmp_path / "s.yaml"
    file.write_text(
        "{name: s, scenario: paper_arm, set: {duration_s: 6, plant.payload_kg: 1},"
        " grid: {controller.model_scale: [1]}}"
    )
    out = tmp_path / "out"
    words = ["sweep", file, "--workers", 1, "--out", out]
    output = funnel_hil.output(*words, "--set", "controller.model_scale=2", code=2)
    assert "given once" in output
    funnel_hil.output(*words, "--set", "duration_s=0.05", "--set", "metrics.from_s=0.01")
    scenario = load_setup(str(out / "scenarios" / "00000.yaml")).scenario
    assert (scenario.duration_s, scenario.plant.payload_kg) == (0.05, 1.0)


@pytest.mark.parametrize("law", ["controller.law=smc", "controller={law: smc}"])
def test_compare_takes_laws_only_from_their_option(law):
    with pytest.raises(ScenarioError, match="--laws"):
        compare(law)


def test_the_scenarios_own_law_is_always_among_all(tmp_path, import_folder):
    law, file = own_law(tmp_path, "pass"), tmp_path / "mine.yaml"
    file.write_text(f"{{extends: paper_arm, name: mine, controller: {{law: '{law}'}}}}")
    everyone = [*COMPARED_LAWS, law]
    setups = load_setups(str(file), [], None)
    assert [setup.scenario.controller.law for setup in setups] == everyone
    both = Margin({"scenarios": [str(file), "paper_arm"]}, Path("margin"))
    assert [case.setting.tags["law"] for case in both.cases] == [*everyone, *COMPARED_LAWS]


def test_errors_are_summed_up_over_some_time(tmp_path):
    for words in (["metrics.from_s=20"], ["duration_s=1", "metrics.from_s=2"]):
        with pytest.raises(ScenarioError, match=r"metrics\.from_s .* before the end of the run"):
            load_setup("paper_arm", words)
    with pytest.raises(ScenarioError, match=r"metrics\.from_s"):
        margin(["metrics.from_s=6"], duration=5.0)
    late = ["metrics.from_s=30", "duration_s=2"]
    for words in (late, ["metrics={from_s: 2}", "duration_s=2"]):
        with pytest.raises(ScenarioError, match=r"^--set metrics.*from_s.*: metrics\.from_s = "):
            load_setup("paper_arm", words)
    short = tmp_path / "short.yaml"  # what is in force is written out, and can be run again
    short.write_text(effective_scenario(load_setup("paper_arm", ["duration_s=1"])))
    assert load_setup(str(short)).scenario.metrics.from_s == 0.5


RANDOM = [
    "link.uplink.jitter_ms=1", "link.downlink.loss=0.1", "link.uplink.duplicate=0.1",
    "link.uplink.burst_loss={mean_loss: 0.1, mean_burst: 2}",
    "link.uplink.schedule=[{kind: step, at_s: 0.02, loss: 0.2}]",
    "link.uplink.trace={file: wifi_idle}",
    "plant.encoder.velocity_noise_rad_s=1e-4",
    "plant.disturbance.terms=[{joint: all, kind: noise, rms_nm: 1, lowest_hz: 1, highest_hz: 5}]",
    "controller={inference_ms: 4, inference_jitter_ms: 4}",
    "faults=[{kind: encoder_noisy, joint: elbow, at_s: 0.01, noise_rad: 1e-4}]",
]  # fmt: skip
CERTAIN = [
    "seed=1", "link.uplink.delay_ms=5", "link.uplink.rate_kbit_s=100000",
    "link.uplink.schedule=[{kind: ramp, at_s: 0.01, for_s: 0.02, delay_ms: 9}]",
    "link.uplink.schedule=[{kind: outage, at_s: 0.01, for_s: 0.01}]", "link.kind=in_process",
    "link.uplink.schedule=[{kind: step, at_s: 1, loss: 0.2}]",
    "link.uplink.trace={file: wifi_idle, start_s: 0}", "controller.inference_ms=4",
    "faults=[{kind: payload_picked_up, at_s: 0.01, payload_kg: 1}]",
]  # fmt: skip


def short_run(*overrides, scenario="paper_arm"):
    """The row of a run of 0.05 s."""
    run = PlannedRun("0", scenario, ("duration_s=0.05", *overrides), 1, {})
    found = row_of(run)
    assert found["error"] is None, found["error"]
    return found


@pytest.mark.parametrize(
    ("override", "chance"), [*((r, True) for r in RANDOM), *((c, False) for c in CERTAIN)]
)
def test_run_knows_whether_its_seed_mattered(override, chance):
    assert short_run(override)["seed_used"] is chance


@pytest.mark.parametrize("probability", [0, 0.1])
def test_can_bus_uses_the_seed_for_error_frames_alone(probability):
    errors = f"link.can.faults.frame_error_probability={probability}"
    assert short_run(errors, scenario="paper_arm_can")["seed_used"] is bool(probability)


def test_noise_of_drives_uses_the_seed():
    noise = "plant.drive_feedback.encoder.velocity_noise_rad_s=[0, 0, 1e-4]"
    assert short_run(noise)["seed_used"]


def test_other_seeds_follow_where_the_first_run_used_its_seed():
    study = margin(seeds="3", exhaustive=True)
    runs, expected = list(study.first()), study.expected
    assert [run.seed for run in runs] == [1, 1]
    certain, chance = (
        made_up(run, seed_used=used) for run, used in zip(runs, (False, True), strict=True)
    )
    assert list(study.follow(runs[0], certain)) == []
    assert study.expected == expected
    followers = list(study.follow(runs[1], chance))
    assert [(run.point, run.seed) for run in followers] == [(runs[1].point, 2), (runs[1].point, 3)]
    assert study.expected == 3 * expected


@pytest.mark.parametrize(
    "options",
    [
        {"overrides": ["controller.inference_ms=4", "controller.inference_jitter_ms=4"]},
        {"overrides": ["link.uplink.loss=0.8"], "quantity": "link.uplink.loss", "limit": 0.0},
    ],
)
def test_every_seed_runs_where_chance_has_a_part(options, tmp_path):
    study = margin(seeds="3", duration=0.1, offsets="1", resolution=0.4, **options)
    conduct(study, tmp_path, Here())
    assert study.searches[0].rows[0]
    assert sorted(row["seed"] for row in study.searches[0].rows[0]) == [1, 2, 3]


def test_all_pairs_of_options_make_a_study_or_are_refused_by_name():
    """No combination of options is passed over in silence."""
    given = {"quantity": "loss", "direction": "uplink", "running": "on", "plants": 2,
             "plant_seed": 3, "uncertainty": "half", "values": "0.1", "kept_share": 0.5,
             "offsets": "1", "resolution": 0.01, "limit": 0.2}  # fmt: skip
    needs_plants = {"plant_seed", "uncertainty", "values", "kept_share"}
    needs_search = {"offsets", "resolution", "limit"}
    for pair in itertools.combinations(given, 2):
        options = {name: given[name] for name in pair}
        refused = set(pair) & (needs_search if "plants" in pair else needs_plants)
        if "plants" in pair and not refused:
            options = {"values": "0.1", "uncertainty": "half"} | options
        if refused:
            with pytest.raises(ScenarioError, match="|".join(refused)):
                margin(**options)
        elif "limit" not in pair or "quantity" in pair:
            assert margin(**options).expected > 0


def test_what_is_of_a_bus_takes_effect_for_a_process(tmp_path):
    keys = KeyFolder.at(tmp_path / "keys")
    create_authority(keys, 1)
    for role in Role:
        issue(keys, role, ["127.0.0.1"], 1)
    reported = ["link.security.enabled=true", f"link.security.folder={keys.path}", "link.domain=3"]
    process = "controller.process=[sleep, 1]"
    (setup,) = load_setups("paper_arm", [*reported, process], ["process"])
    assert setup.scenario.link.security.enabled
    assert lockstep_setup(setup).scenario.link.plant_endpoint.startswith("tls/")
    for given in (reported, ["link.plant_endpoint=tcp/127.0.0.1:7999", process]):
        with pytest.raises(ScenarioError, match="has no effect in a study"):
            load_setups("paper_arm", given, ["smc"])
