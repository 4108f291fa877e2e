"""Recordings that are damaged or foreign are judged, not trusted."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bus_schema.messages.run_event import EventKind, RunEvent
from bus_schema.messages.topics import PLANT_TRUTH, RUN_EVENTS, Role
from deploy.judge.bounds import judge_bounds
from deploy.judge.metrics import summarise
from deploy.judge.recorded_ticks import known_ticks
from deploy.judge.reported_values import reported_values
from deploy.reports.live.figures import live_figures
from deploy.run.run_folder import load_run
from deploy.run.simulate import Simulation, simulate
from deploy.scenario.scenario import load_setup
from tests.damage import damage_at, rewrite
from tests.deploy.own_laws import own_law as own_law_in
from tests.warm_process import no_report, output_of

TELLTALE = Path("imported")


@pytest.fixture(autouse=True)
def folder(import_folder):
    return import_folder


def short_run(*overrides):
    return simulate(load_setup("paper_arm", ["duration_s=0.2", *overrides]))


@pytest.fixture
def own_law(folder):
    """A recording that names a law of one's own, in a folder where its module is found."""
    law = own_law_in(folder, "return np.zeros_like(tracking.position)")
    file = folder / "own_law.py"
    file.write_text(f"{file.read_text()}open('{TELLTALE}', 'w').close()\n")
    short_run(f"controller.law={law}").write_log(folder / "run.mcap")
    TELLTALE.unlink()
    del sys.modules["own_law"]
    return folder, law


def test_replay_imports_a_custom_law_only_with_permission(own_law):
    folder, law = own_law
    output = output_of("replay", folder, code=2)
    assert law in output
    assert "--allow-custom-law" in output
    assert not TELLTALE.exists()
    assert "identical" in output_of("replay", folder, "--allow-custom-law")
    assert TELLTALE.exists()


@pytest.fixture
def lost_in_the_middle(folder):
    """A run that leaves its bounds in the middle, where its recording is damaged."""
    file = folder / "run.mcap"
    push = "{joint: elbow, kind: pulse, torque_nm: 500, start_s: 0.22, duration_s: 0.01}"
    short_run(
        "duration_s=0.7", "robot.initial_offset_rad=0", f"plant.disturbance.terms=[{push}]"
    ).write_log(file)
    assert judge_bounds(load_run(file)[0]).violation_fraction > 0.0
    damage_at(file, 25 * 10**7)
    return folder


def test_what_is_missing_in_the_middle_is_not_claimed(lost_in_the_middle):
    output = output_of("report", lost_in_the_middle, code=1)
    data, _ = load_run(lost_in_the_middle)
    times_s = data.times_s(PLANT_TRUTH)
    known, gap = len(times_s) - 1, int(np.argmax(np.diff(times_s)))
    first_s, last_s = times_s[gap] + 0.001, times_s[gap + 1] - 0.001
    assert 0.1 < first_s < 0.25 < last_s < 0.5
    output = " ".join(output.split())
    assert "recording damaged: bounds not kept" in output
    assert "The plant itself counted" in output
    assert f"inside its bounds at the {known} of 700 ticks at which it is known" in output
    assert f"those at {first_s:.3f} to {last_s:.3f} s are missing" in output
    assert "all 700 ticks" not in output
    assert "until then" not in output
    summary = json.loads((lost_in_the_middle / "summary.json").read_text())
    assert (summary["ticks"], summary["recording"]["ticks_known"]) == (700, known)
    assert summary["recording"]["gaps_s"] == [[pytest.approx(first_s), pytest.approx(last_s)]]
    assert not summary["completed"]
    assert "Recording damaged" in (lost_in_the_middle / "report.html").read_text()
    assert "damaged" in output_of("replay", lost_in_the_middle, code=1)


def test_an_export_of_a_damaged_recording_says_what_is_missing(lost_in_the_middle):
    words = ["export", lost_in_the_middle, "--csv", "--series", "tracking"]
    file, *damage = output_of(*words, code=1).splitlines()
    assert file == str(lost_in_the_middle / "export" / "tracking.csv")
    assert "The recording is damaged" in " ".join(damage)
    known = known_ticks(load_run(lost_in_the_middle)[0]).known
    assert f"known at {known} of 700 ticks" in " ".join(damage)


def test_what_is_known_counts_also_without_an_end(lost_in_the_middle):
    """Without a reported end, the ticks are those up to the last known one."""
    data, _ = load_run(lost_in_the_middle)
    whole = known_ticks(data)
    assert whole.missing > 0
    assert known_ticks(replace(data, events=[])) == whole
    truth = data.tables[PLANT_TRUTH.name]
    cut = replace(data, tables={**data.tables, PLANT_TRUTH.name: truth[:-10]})
    assert known_ticks(cut).gaps_s[-1] == pytest.approx((0.691, 0.7))
    assert summarise(replace(cut, events=[]))["ticks"] == 690


def with_events(*events):
    """A finished run with more events behind those that it had."""
    run = short_run()
    payloads = [RunEvent(10**8, *each).encode() for each in events]
    return Simulation(
        run.setup, run.topics + [RUN_EVENTS] * len(events), run.payloads + payloads, None
    )


MALFORMED = [
    (EventKind.ENDED, {"wall_s": "x"}, "wall_s"),
    (EventKind.ENDED, {"wall_s": float("nan"), "stolen_ms": []}, "wall_s"),
    (EventKind.ENDED, {"ticks": 10**400}, "ticks"),
    (EventKind.ENDED, {"ticks": True, "completed": "yes"}, "completed"),
    (EventKind.ENDED, {"limits": 3}, "limits"),
    (EventKind.COUNTS, {"rejected": 3, "downlink": {"rejected": 3}}, "rejected"),
    (EventKind.COUNTS, {"downlink": 3, "uplink": {"delay_ms": {"p50": "x"}}}, "downlink"),
    (EventKind.COUNTS, {"uplink": {"sent": -1, "loss_burst": None}, "can": 1}, "can"),
]


@pytest.mark.parametrize(("kind", "message", "named"), MALFORMED)
def test_malformed_last_words_spoil_nothing(kind, message, named):
    clean = summarise(short_run().data())
    for source in (Role.PLANT, Role.CONTROLLER):
        summary = summarise(with_events((source, kind, json.dumps(message))).data())
        notes = summary["recording"]["notes"]
        assert any(named in note and source in note for note in notes), notes
        for same in ("ticks", "completed", "digest", "bounds", "transport", "limits"):
            assert summary[same] == clean[same], same


def test_what_is_no_json_object_at_all_is_passed_over(folder):
    more = [(Role.PLANT, EventKind.ENDED, text) for text in ("[]", "{", "1" * 5000, "[" * 5000)]
    with_events(*more).write_log(folder / "run.mcap")
    data, _ = load_run(folder / "run.mcap")
    assert summarise(data)["completed"]


def test_notes_are_bounded():
    events = [RunEvent(0, f"{number}", EventKind.ENDED, '{"ticks": "x"}') for number in range(1000)]
    _, notes = reported_values(events)
    assert 0 < len(notes) < 100


def test_summary_says_what_one_commander_is_worth():
    data = short_run().data()
    assert summarise(data)["commander"] == {"authenticated": None, "note": None}
    on_a_bus = summarise(replace(data, link="zenoh"))["commander"]
    assert on_a_bus["authenticated"] is False
    assert "link.security" in on_a_bus["note"]


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    file = tmp_path_factory.mktemp("sound") / "run.mcap"
    short_run().write_log(file)
    return file


TWIST = ("geometry_msgs/msg/Twist", b"float64 x")
REWRITTEN = {
    "doubled": ({"copies": lambda _: 2}, "its recorder wrote"),
    "two in one": ({"times": 2}, "of the true motion repeat a time or go back"),
    "states doubled": ({"copies": lambda topic: 1 + (topic == "/joint_states")}, "messages, but"),
    "without events": ({"copies": lambda topic: topic != "/run_events"}, "end of the plant"),
    "without commands": ({"copies": lambda topic: topic != "/joint_commands"}, "messages, but"),
    "foreign type": ({"schemas": {"/joint_states": TWIST}}, "/joint_states are geometry_msgs"),
    "foreign truth": ({"schemas": {"/plant_truth": TWIST}}, "/plant_truth are geometry_msgs"),
    "foreign fields": (
        {"schemas": {"/joint_commands": ("sensor_msgs/msg/JointState", b"float64 x")}},
        "sensor_msgs/msg/JointState are from another version",
    ),
    "no number": (
        {"metadata": {"rejected": {"second_plant": "x"}}},
        "its metadata rejected: second_plant = 'x': must be a whole number",
    ),
    "negative": ({"metadata": {"lost": {"plant_truth": "-1"}}}, "its metadata lost: plant_truth"),
    "forged": ({"metadata": {"rejected": {"second_plant": "1"}}}, "second_plant: 1"),
}


@pytest.mark.parametrize(("change", "message"), REWRITTEN.values(), ids=REWRITTEN)
def test_rewritten_recording_is_damaged(change, message, sound, folder):
    rewrite(sound, folder / "run.mcap", **change)
    with no_report():
        output = output_of("report", folder, code=1)
    assert message in " ".join(output.split())
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["verdict"] in ("unknown", "nothing")
    assert not summary["completed"]
    assert any(message in each for each in summary["recording"]["damage"])


@pytest.mark.parametrize("name", ["foreign truth", "no number", "forged"])
def test_rewritten_recording_is_damaged_in_every_command(name, sound, folder):
    """Messages, metadata that cannot be read, and metadata that says so."""
    rewrite(sound, folder / "run.mcap", **REWRITTEN[name][0])
    output_of("report", folder, code=1)
    assert (folder / "report.html").is_file()
    output_of("replay", folder, code=1)
    output_of("export", folder, "--csv", code=1)


def test_recording_written_again_without_a_change_is_as_before(sound, folder):
    none_rejected = {"rejected": {"second_plant": "0"}}
    rewrite(sound, folder / "run.mcap", metadata=none_rejected)
    output_of("report", folder)
    again = json.loads((folder / "summary.json").read_text())
    assert again["digest"] == load_run(sound)[0].digest
    assert again["verdict"] == "kept"


def test_foreign_messages_are_not_decoded(sound, folder):
    rewrite(sound, folder / "run.mcap", schemas={"/joint_states": TWIST})
    data, contents = load_run(folder)
    assert "joint_states" not in contents.payloads
    assert len(data.tables["joint_states"]) == 0


@pytest.mark.parametrize(
    ("text", "overrides"),
    [
        ("time_s,delay_ms\n0,1\n1,2\n", ["link.uplink.trace.file={}"]),
        ("1\n2\n", ["link.downlink.distribution=empirical", "link.downlink.distribution_file={}"]),
    ],
)
def test_files_of_a_recording_can_be_read_as_long_as_its_setup_is_used(text, overrides, folder):
    given = folder / "given.csv"
    given.write_text(text)
    short_run(*(each.format(given) for each in overrides)).write_log(folder / "run.mcap")
    given.unlink()
    data, _ = load_run(folder)
    assert live_figures(data.setup)["age"]["data"]  # as `view` draws them
