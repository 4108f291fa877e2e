"""Input that YAML, physics or the file system cannot take: exit code 2, with what is allowed."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from deploy.scenario.definition import Scenario
from deploy.scenario.explanation import _keys, _sections
from deploy.scenario.scenario import SHIPPED, load_setup
from deploy.scenario.yaml_files import ScenarioError
from deploy.study.sweep import load_sweep

BASE = (SHIPPED / "paper_arm.yaml").read_text()
TENFOLD = "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 9))
BOMB = f"a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]\n{TENFOLD}"
DEEPER = "must not be nested deeper than 50 levels"
VALUES = [
    # what is written under seed, what is said of it
    ("2024-13-45", "seed = '2024-13-45': must be a date of the calendar"),
    ("!!int z", "seed = 'z': must be a whole number"),
    ("!!float z", "seed = 'z': must be a number"),
    ("[!!bool z]", "seed.0 = 'z': must be a valid bool"),
    ("9" * 5000, r"seed = '9+\.\.\.: must be a whole number"),
    ("0x" + "f" * 5000, r"seed = '0xf+\.\.\.: must be a whole number"),
    ("[" * 3000 + "]" * 3000, f"seed = 'line .*{DEEPER}"),
    ("[" * 100_000, f"seed = 'line .*{DEEPER}"),
    ("&a [*a]", r"seed = '\*a': must not contain itself"),
    ("true", "seed = True: must be a number, not true or false"),
]


@pytest.mark.parametrize(("value", "said"), VALUES, ids=[value[:12] for value, _ in VALUES])
def test_value_that_yaml_cannot_hold_is_refused(value, said, tmp_path, funnel_hil):
    file = tmp_path / "mine.yaml"
    file.write_text(re.sub("(?m)^seed:.*\n", "", BASE) + f"\nseed: {value}\n")
    code, text = funnel_hil("simulate", file, "--out", tmp_path / "out")
    assert code == 2
    assert re.search(f"{re.escape(str(file))}: {said}", text), text[:500]
    assert len(text) < 1000
    assert not (tmp_path / "out").exists()
    code, text = funnel_hil("simulate", "--set", f"seed={value}", "--out", tmp_path / "out")
    assert code == 2
    assert text.startswith("error: --set seed=")
    assert len(text) < 1000


def test_aliases_count_for_what_they_stand_for(tmp_path):
    file = tmp_path / "bomb.yaml"
    file.write_text(BOMB + BASE)
    with pytest.raises(ScenarioError, match=r"a4 = .*must have at most 100000 values"):
        load_setup(str(file))


@pytest.mark.parametrize(
    ("override", "allowed"),
    [
        ("plant.payload_kg=1e300", "must be less than or equal to"),
        ("plant.payload_kg=1e7", "must be less than or equal to 1000000"),
        ("controller.model_scale=1e308", "must be less than or equal to"),
        ("controller.model_scale=1e-9", "must be greater than or equal to"),
        ("plant.friction.coulomb_nm=1e13", "must be numbers of at most 1e+12 in size"),
        (f"robot.initial_offset_rad=1{'0' * 290}", "1e+12"),
        (f"name={'x' * 5000}", "must have at most 100 characters"),
    ],
)
def test_number_or_name_beyond_all_use_is_refused(override, allowed):
    with pytest.raises(ScenarioError) as refused:
        load_setup("paper_arm", [override])
    key = override.partition("=")[0]
    assert str(refused.value).startswith(f"--set {key}=")
    assert allowed in str(refused.value)
    assert len(str(refused.value)) < 1000


def numbers_of(section, prefix="", place=()):
    """Dotted keys of a scenario that take one number, or one for each joint."""
    for name, annotation in _keys(section).items():
        inner = list(_sections(annotation))
        taken = re.findall(r"\b(float|int|ndarray|bool|str)\b", str(annotation))
        if not inner and taken and not {"bool", "str"} & set(taken):
            yield prefix + name
        elif len(inner) == 1 and "tuple" not in str(annotation) and "list" not in str(annotation):
            yield from numbers_of(inner[0], f"{prefix}{name}.")


NUMBERS = [key for key in numbers_of(Scenario) if not key.startswith("uncertainty")]


def test_no_number_may_be_a_boolean():
    assert len(NUMBERS) > 80
    taken = []
    for key in NUMBERS:
        try:
            load_setup("paper_arm", [f"{key}=true"])
        except ScenarioError as error:
            if not re.search("number|is missing|a list of", str(error)):
                taken.append(f"{key}: {error}")
        else:
            taken.append(key)
    assert not taken


@pytest.mark.parametrize(
    ("given", "held"),
    [
        ("link.can.node_ids=3", "whole numbers"),
        ("robot.joints=elbow", "strings"),
        ("faults=1", "mappings of keys to values"),
        ("link.uplink.schedule=1", "mappings of keys to values"),
    ],
)
def test_one_value_where_a_list_belongs_is_told_what_lists_hold(given, held):
    with pytest.raises(ScenarioError) as refused:
        load_setup("paper_arm", [given])
    assert str(refused.value).endswith(f": must be a list of {held}")


@pytest.mark.parametrize("base", ["nowhere", "x" * 5000])
def test_base_that_is_not_found_is_told_as_extends(base, tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text(f"extends: {base}\nname: mine\n")
    with pytest.raises(ScenarioError, match=f"{file}: extends = .*no such file"):
        load_setup(str(file))


@pytest.mark.parametrize(
    "words", [["simulate"], ["compare", "--laws", "pid"], ["margin", "--laws", "pid"]]
)
def test_folder_that_is_a_loop_of_links_is_refused(words, tmp_path, funnel_hil):
    loop = tmp_path / "loop"
    loop.symlink_to(loop)
    for out in (loop, loop / "below"):
        code, text = funnel_hil(*words, "--out", out)
        assert code == 2
        assert f"--out {out}: cannot be created" in text


@pytest.mark.parametrize("words", [["simulate"], ["sweep"], ["margin", "--study"]])
def test_name_of_a_file_that_no_file_can_have_is_refused(words, funnel_hil):
    code, text = funnel_hil(*words, "x" * 5000)
    assert code == 2
    assert "no such file" in text
    assert len(text) < 1000


EXITS = ["raise SystemExit(7)", "class Law:\n    def __init__(self, model):\n        exit()"]


@pytest.mark.parametrize("source", EXITS)
def test_law_that_exits_is_refused(source, tmp_path, monkeypatch):
    (tmp_path / "exiting_law.py").write_text(source)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(__import__("sys").modules, "exiting_law", raising=False)
    with pytest.raises(ScenarioError, match="SystemExit"):
        load_setup("paper_arm", ["controller.law=exiting_law:Law"])


def test_sweep_of_too_many_runs_is_refused_with_the_limit(tmp_path):
    file = tmp_path / "big.yaml"
    values = "{from: 0, to: 9999, step: 1}"
    file.write_text(f"name: big\nscenario: paper_arm\ngrid: {{seed_1: {values}, b: {values}}}\n")
    with pytest.raises(ScenarioError, match="are 100000000 runs; at most 100000 are allowed"):
        load_sweep(str(file))


def test_key_of_a_sweep_is_told_as_the_sweep_has_it(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("name: a\nscenario: paper_arm\nset: {plant.paylod_kg: 1}\ngrid: {}\n")
    with pytest.raises(ScenarioError, match=f"{file}: set plant.paylod_kg=1: .*mean payload_kg"):
        load_sweep(str(file))
    file.write_text("name: a\nscenario: paper_arm\ngrid: {plant.payload_kg: [0, -1]}\n")
    with pytest.raises(ScenarioError, match=f"{file}: grid plant.payload_kg=-1: "):
        load_sweep(str(file))
    file.write_text("name: a\nscenari: paper_arm\ngrid: {}\n")
    with pytest.raises(ScenarioError, match=f"{file}: scenari: .*did you mean scenario"):
        load_sweep(str(file))


def test_law_that_is_none_is_told_as_the_option_has_it(funnel_hil):
    for command in ("compare", "margin"):
        code, text = funnel_hil(command, "--laws", "pid,smcc")
        assert code == 2
        assert "--laws 'smcc': must be one of fixed_time_neural" in text


@pytest.mark.parametrize("option", ["--seeds", "--values", "--offsets", "--running"])
def test_option_that_is_no_yaml_is_told_by_its_name(option, funnel_hil):
    code, text = funnel_hil("margin", option, "[")
    assert code == 2
    assert f"{option}: '[' is no YAML value" in text


ARM = Path(load_setup("paper_arm").robot.path).read_text()
ARMS = [
    ('child link="column"', 'child link="base"', "joins link 'base' to itself"),
    ('child link="upper_arm"', 'child link="forearm"', "the child of more than one joint"),
    ('parent link="base"', 'parent link="forearm"', "form a circle"),
    ('<link name="base">', '<link name="loose"/><link name="base">', "one link must be the child"),
    ('parent link="column"', 'parent link="nowhere"', "no link 'nowhere'"),
    ('name="shoulder" type', 'name="base_yaw" type', "joint names must be unique"),
    (
        'name="shoulder" type="revolute"',
        'name="shoulder" type="spherical"',
        "one of revolute, continuous",
    ),
    ('axis xyz="0 1 0"', 'axis xyz="0 0 0"', "is no direction"),
    ('origin xyz="0.40 0 0"', 'origin xyz="0.40 0"', "must be three numbers"),
    ('mass value="33.429"', 'mass value="1e300"', "must be at most 1e"),
    ('mass value="33.429"', 'mass value="-1"', "must not be negative"),
    ('<mass value="33.429"/>', "", "must have one mass"),
    ("</robot>", "<a>" * 100_000 + "</a>" * 100_000 + "</robot>", "must not be nested deeper"),
    (r'(mass value|i[xyz]{2})="[^"]*"', r'\1="0"', "has no inertia"),
]


@pytest.mark.parametrize(("old", "new", "said"), ARMS, ids=[new[:20] for _, new, _ in ARMS])
def test_urdf_that_no_simulator_should_see_is_refused(old, new, said, tmp_path):
    changed = re.sub(old, new, ARM)
    assert changed != ARM
    file = tmp_path / "a.urdf"
    file.write_text(changed)
    with pytest.raises(ScenarioError, match=f"robot.urdf={file}: robot.urdf = ") as refused:
        load_setup("paper_arm", [f"robot.urdf={file}"])
    assert said in str(refused.value)


def test_a_key_that_is_given_twice_is_refused_by_name(tmp_path, funnel_hil):
    file = tmp_path / "twice.yaml"
    for text, key in (
        ("duration_s: 1\nseed: 2\nduration_s: 3\n", "duration_s"),
        ("plant: {payload_kg: 1, friction: {}, payload_kg: 1}\n", "plant.payload_kg"),
    ):
        file.write_text(f"extends: paper_arm\n{text}")
        code, said = funnel_hil("simulate", file, "--out", tmp_path / "out")
        assert code == 2
        assert re.search(
            rf"twice\.yaml: {re.escape(key)} = .*must be given once; .* lines \d and \d", said
        )
    assert not (tmp_path / "out").exists()


def test_of_a_key_that_is_set_twice_the_last_holds_and_that_is_said(funnel_hil, tmp_path):
    twice = ("--set", "duration_s=2", "--set", "duration_s=0.1")
    code, said = funnel_hil("simulate", *twice, "--no-report", "--out", tmp_path / "out")
    assert code == 0
    assert "--set duration_s=2: a later --set takes its place" in said
    assert "set: duration_s=0.1;" in " ".join(said.split())
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["ticks"] == 100


def test_what_is_merged_into_a_section_may_be_said_anew(tmp_path):
    file = tmp_path / "merged.yaml"
    file.write_text(
        "extends: paper_arm\nlink:\n  uplink: &way {delay_ms: 2, loss: 0.1}\n"
        "  downlink: {<<: *way, delay_ms: 3}\n"
    )
    link = load_setup(str(file)).scenario.link
    assert (link.downlink.delay_ms, link.downlink.loss) == (3.0, 0.1)


def test_what_is_there_but_no_file_is_said_to_be_so(tmp_path, funnel_hil):
    for place in ("/dev/null", tmp_path):
        code, said = funnel_hil("simulate", place)
        assert code == 2
        assert f"{place}: is no regular file, nor one of the shipped" in said


LATE = [
    # command, scenario, what is set, what is refused: by a check that comes after the schema
    ("drives", "paper_arm", "link.can.interface=nonsense", "link.can.interface = 'nonsense'"),
    ("run", "paper_arm", "controller.process=[./nope]", "controller.process = "),
    ("run", "paper_arm", "link.plant_endpoint=tcp/1.2.3.4:7000", "link.plant_endpoint = "),
    ("simulate", "paper_arm", "controller.process=[./nope]", "controller.process = "),
]


@pytest.mark.parametrize(("command", "scenario", "given", "said"), LATE)
def test_what_is_set_is_blamed_on_what_set_it_however_late_it_is_refused(
    command, scenario, given, said, funnel_hil, nothing_starts
):
    code, text = funnel_hil(command, scenario, "--set", given)
    assert code == 2
    assert f"error: --set {given}: {said}" in text


UNFIT = [
    # scenario, what is set, the value of the file that does not fit with it
    ("iiwa_can", "link.can.protocol=cansimple", "link.can.fd_process_data = True"),
    ("iiwa_can", "link.can.fd=false", None),
    ("paper_arm_can", "link.can.bitrate=125000", "rate_hz = 500.0"),
    ("paper_arm", "duration_s=600", "reference = "),
]


@pytest.mark.parametrize(("scenario", "given", "said"), UNFIT)
def test_a_value_that_does_not_fit_with_what_is_set_is_told_with_both(scenario, given, said):
    with pytest.raises(ScenarioError) as refused:
        load_setup(scenario, ["seed=3", given])
    place = f"{SHIPPED / scenario}.yaml, with --set" if said else "--set"
    assert str(refused.value).startswith(f"{place} {given}: {said or 'link.can.fd = False'}")


def test_a_recorded_reference_that_is_played_too_fast_is_told_with_the_speed(tmp_path, funnel_hil):
    short = ("--set", "duration_s=0.1")
    funnel_hil("reference", "paper_arm", "--csv", *short, "--out", tmp_path / "way.csv")
    file = tmp_path / "csv.yaml"
    base = re.sub(r"(?ms)^reference:.*?(?=^\S)", "", BASE)
    file.write_text(
        re.sub("(?m)^duration_s:.*", "duration_s: 0.1", base)
        + f"reference:\n  kind: csv\n  file: {tmp_path / 'way.csv'}\n"
    )
    load_setup(str(file))
    with pytest.raises(ScenarioError) as refused:
        load_setup(str(file), ["reference.speed=2"])
    assert str(refused.value).startswith(f"{file}, with --set reference.speed=2: duration_s = 0.1")
