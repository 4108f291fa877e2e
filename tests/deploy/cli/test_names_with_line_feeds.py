"""A line feed in the name of a user's file begins no line of an error message."""

from __future__ import annotations

import pickle

import pytest

from bus_schema.errors import InputError
from deploy.run.run_folder import RunFolderError
from deploy.scenario.yaml_files import ScenarioError

NAME = "no\nerror: forged"
COMMANDS = [
    ("simulate", NAME), ("simulate", f"{NAME}.yaml"), ("simulate", f"{NAME}.urdf"),
    ("margin", NAME), ("sweep", NAME), ("compare", NAME), ("policy", "smc", NAME),
    ("margin", "--study", NAME), ("datasheet", "--network", NAME), ("tune", NAME),
    ("datasheet", NAME), ("benchmark", NAME), ("benchmark", "--tuned", NAME),
    ("report", NAME), ("export", NAME, "--csv"), ("replay", NAME), ("diff", NAME, NAME),
    ("robot", NAME), ("robot", "paper_arm", "--picture", f"{NAME}/a.png"), ("view", NAME),
    ("identify", NAME, "--robot", "paper_arm"), ("identify", "log.csv", "--robot", NAME),
    ("latency", NAME), ("robot-server", NAME), ("drives", NAME),
    ("simulate", "--set", f"robot.urdf={NAME}.urdf"), ("margin", "--laws", NAME),
    ("simulate", "--set", NAME), ("simulate", "--set", f"controller.law={NAME}"),
    ("simulate", "--set", f'link.uplink.trace.file="{NAME}"'),
    ("margin", "--at-least", NAME), ("margin", "--baseline", NAME), ("robot", "--hold", NAME),
]  # fmt: skip


@pytest.mark.parametrize("words", COMMANDS, ids=lambda words: " ".join(words).replace("\n", "␊"))
def test_a_name_stays_on_the_line_of_its_message(words, funnel_hil, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    output = funnel_hil.output(*words, code=2)
    assert not any(line.startswith("error: forged") for line in output.splitlines())
    assert not list(tmp_path.iterdir())


def test_only_lines_that_are_given_as_such_begin_a_line():
    error = ScenarioError("one\nname", "two\x1b[31m")
    assert str(error) == "one\\nname\ntwo\\x1b[31m"
    assert str(RunFolderError(*error.lines("in: ", "!"))) == "in: one\\nname\ntwo\\x1b[31m!"
    assert str(pickle.loads(pickle.dumps(error))) == str(error)
    assert str(InputError(str(InputError("a\nb")))) == "a\\nb"
