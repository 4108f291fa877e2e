"""Bad input ends with exit code 2 and one message, before anything is written or started."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml

from deploy.scenario.checking.explanation import _keys, _sections
from deploy.scenario.definition import ScenarioConfiguration
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError, set_value
from tests.deploy.cli.refused import BASE, FILES, MISSPELT, NO_YAML, OUT_OF_RANGE, REFUSED, TYPOS
from tests.deploy.cli.refused_settings import IMPOSSIBLE, SET, TOGETHER


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All files that the table names."""
    folder = tmp_path_factory.mktemp("given")
    for name, content in FILES.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    (folder / "loop").symlink_to(folder / "loop")
    return folder


@pytest.fixture
def refuse(funnel_hil, nothing_starts, folder: Path, monkeypatch: pytest.MonkeyPatch):
    """The only message of a command that has to be refused."""
    monkeypatch.chdir(folder)

    def run(*words: str) -> str:
        before = {*folder.rglob("*")}
        code, output = funnel_hil(*(word.replace("HERE", str(folder)) for word in words))
        output = re.sub(r"\Aruns code of .*\n", "", output.replace(f"{folder}/", ""))
        assert code == 2, output
        assert output.startswith("error: ")  # and nothing on standard output
        assert output.count("error: ") == 1
        assert "Traceback" not in output
        assert len(output) < 1000
        assert {*folder.rglob("*")} == before
        return output.removeprefix("error: ").rstrip("\n")

    return run


@pytest.mark.parametrize("row", REFUSED, ids=lambda row: row[0][:40])
def test_bad_input(refuse, row: tuple[str, ...]) -> None:
    line, begins, *found = row
    message = refuse(*shlex.split(line))
    assert message.startswith(begins)
    for text in found:
        assert text in message


@pytest.mark.parametrize("row", SET, ids=lambda row: row[0][:40])
def test_bad_setting(refuse, row: tuple[str, ...]) -> None:
    setting, begins, *found = row
    message = refuse("run", "paper_arm", "--set", setting)
    shown = f"--set {setting.replace('HERE/', '')}"
    assert message.startswith(f"{shown}: {begins}" if begins else shown[:60])
    for text in found:
        assert text in message


@pytest.mark.parametrize(("key", "given", "shown", "allowed"), IMPOSSIBLE)
def test_impossible_value(refuse, key: str, given: str, shown: str, allowed: str) -> None:
    message = refuse("run", "paper_arm", "--set", f"{key}={given}")
    assert message.startswith(f"--set {key}={given}: {key} = {shown}: ")
    assert allowed in message


@pytest.mark.parametrize(("scenario", "settings", "message"), TOGETHER)
def test_settings_that_do_not_fit_together(refuse, scenario, settings, message):
    words = [word for each in settings.split(" & ") for word in ("--set", each)]
    assert message in refuse("run", scenario, *words)


@pytest.mark.parametrize(("line", "option"), OUT_OF_RANGE)
def test_option_out_of_its_range(funnel_hil, line: str, option: str) -> None:
    output = funnel_hil.output(*line.split(), code=2)
    assert option in output


@pytest.mark.parametrize(("value", "message"), NO_YAML, ids=[value[:12] for value, _ in NO_YAML])
def test_value_that_yaml_cannot_hold(refuse, tmp_path: Path, value: str, message: str) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(re.sub("(?m)^seed:.*\n", "", BASE) + f"\nseed: {value}\n")
    assert re.match(f"{re.escape(str(file))}: {message}", refuse("simulate", str(file)))
    assert refuse("simulate", "--set", f"seed={value}").startswith("--set seed=")


@pytest.mark.parametrize(("key", "known", "meant"), TYPOS)
def test_unknown_key(refuse, tmp_path: Path, key: str, known: str, meant: str | None) -> None:
    hint = f"; did you mean {meant}?" if meant else ""
    message = refuse("run", "paper_arm", "--set", f"{key}=1")
    assert message == f"--set {key}=1: {known}: unknown key{hint}"
    file = tmp_path / "mine.yaml"
    values: dict[str, Any] = {"extends": "paper_arm"}
    set_value(values, key, 1)
    file.write_text(yaml.safe_dump(values))
    assert refuse("run", str(file)) == f"{file}: {known}: unknown key{hint}"


@pytest.mark.parametrize(("line", "meant"), MISSPELT)
def test_misspelt_choice(refuse, line: str, meant: str) -> None:
    assert refuse(*shlex.split(line)).endswith(f"; did you mean {meant}?")


def numbers_of(section, prefix=""):
    """Dotted keys of a scenario that take one number, or one for each joint."""
    for name, annotation in _keys(section).items():
        inner = list(_sections(annotation))
        taken = re.findall(r"\b(float|int|ndarray|bool|str)\b", str(annotation))
        if not inner and taken and not {"bool", "str"} & set(taken):
            yield prefix + name
        elif len(inner) == 1 and "tuple" not in str(annotation) and "list" not in str(annotation):
            yield from numbers_of(inner[0], f"{prefix}{name}.")


def test_no_number_may_be_a_boolean() -> None:
    numbers = [
        key for key in numbers_of(ScenarioConfiguration) if not key.startswith("uncertainty")
    ]
    assert len(numbers) > 80
    taken = []
    for key in numbers:
        try:
            load_setup("paper_arm", [f"{key}=true"])
        except ScenarioError as error:
            if not re.search("number|is missing|a list of", str(error)):
                taken.append(f"{key}: {error}")
        else:
            taken.append(key)
    assert not taken


def test_last_of_a_key_that_is_set_twice_holds(funnel_hil, tmp_path: Path) -> None:
    twice = ("--set", "duration_s=2", "--set", "duration_s=0.1")
    output = funnel_hil.output("simulate", *twice, "--no-report", "--out", tmp_path / "out")
    assert "--set duration_s=2: replaced by a later --set" in output
    assert "set: duration_s=0.1. The" in " ".join(output.split())
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["ticks"] == 100


def test_merged_keys_of_a_section_can_be_overridden(tmp_path: Path) -> None:
    file = tmp_path / "merged.yaml"
    file.write_text(
        "extends: paper_arm\nlink:\n  uplink: &way {delay_ms: 2, loss: 0.1}\n"
        "  downlink: {<<: *way, delay_ms: 3}\n"
    )
    link = load_setup(str(file)).scenario.link
    assert (link.downlink.delay_ms, link.downlink.loss) == (3.0, 0.1)
