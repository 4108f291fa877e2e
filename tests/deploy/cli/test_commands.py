"""The table of commands: what it says of each, and that nothing is imported without need."""

import re

import pytest
from rich.text import Text

from deploy.cli.commands import COMMANDS, EARLIER, PANELS, LazyCommand, summary_of
from tests.warm_process import cold_python, output_of


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_says_of_itself_what_the_table_says(name):
    paragraph = (LazyCommand(name).load().help or "").partition("\n\n")[0]
    assert " ".join(paragraph.split()) == summary_of(name)


def imported(program, *heavy):
    """Which of these a program has imported when it has ended."""
    look = f"import sys; print('imported:', *(name for name in {heavy} if name in sys.modules))"
    return cold_python("-c", f"{program}\n{look}").stdout.splitlines()[-1].split()[1:]


@pytest.mark.parametrize(
    "words",
    [
        ["--help"], ["nothing-of-ours"], [],
        ["run", "--help"], ["simulate", "--help"], ["run", "--no-such-option"],
    ],
)  # fmt: skip
def test_help_and_wrong_words_import_nothing_heavy(words):
    program = (
        f"import sys; sys.argv = ['funnel-hil', *{words}]\n"
        "from deploy.cli import main\ntry:\n    main()\nexcept SystemExit:\n    pass"
    )
    heavy = ("numba", "numpy", "pinocchio", "pybullet", "plotly", "zenoh", "yaml")
    assert imported(program, *heavy) == []


def test_run_and_its_processes_load_nothing_that_only_others_need():
    program = "from deploy.cli.commands import LazyCommand; LazyCommand('plant').load()"
    assert imported(program, "plotly", "dask", "pyarrow", "can", "canopen", "cryptography") == []
    program = "import deploy.run.processes.role_process"  # `run` starts it before the libraries
    assert imported(program, "numpy", "numba") == []
    others = (
        "plotly",
        "jinja2",
        "distributed",
        "pyarrow",
        "deploy.study.execution.folder",
        "pybullet",
    )
    assert imported("import deploy.cli.run_and_simulate", *others) == []


def test_help_names_every_command_and_a_typing_error_its_neighbour(funnel_hil):
    output = funnel_hil.output("--help")
    for name in COMMANDS:
        is_shown = re.search(rf"^. {name} +[A-Z]", output, re.MULTILINE) is not None
        assert is_shown is (name not in EARLIER), name
    shown = re.findall(r"^╭─ ([A-Z][a-z ]+?) ─", output, re.MULTILINE)
    assert shown == ["Options", *PANELS]
    output = funnel_hil.output("smulate", code=2)
    assert "Did you mean 'simulate'" in output


def test_earlier_names_do_what_their_successors_do(funnel_hil, tmp_path):
    assert funnel_hil("includes") == funnel_hil("doctor", "--includes")
    written = []
    for number, words in enumerate((["ros2-control"], ["ros2", "control"])):
        funnel_hil.output(*words, "paper_arm", "--out", tmp_path / str(number))
        files = sorted((tmp_path / str(number)).iterdir())
        written.append([(file.name, file.read_bytes()) for file in files])
    assert written[0] == written[1]
    assert [name for name, _ in written[0]] == ["controllers.yaml", "robot.urdf"]


def parameters(command):
    """The parameters of a command and of those below it."""
    yield from command.params
    for below in getattr(command, "commands", {}).values():
        yield from parameters(below)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_shows_words_in_brackets(name):
    """Typer reads help as Rich's markup, where `[word]` is a style and not shown."""
    for each in parameters(LazyCommand(name).load()):
        text = getattr(each, "help", None) or ""
        assert Text.from_markup(text).plain == text.replace("\\[", "["), each.name


@pytest.mark.parametrize(
    ("words", "instead"),
    [
        (("margin", "--quick"), "use --duration 6 --offsets 1"),
        (("simulate", "--interface", "servoj"), "use --set plant.interface.kind=KIND"),
        (("simulate", "--network", "wifi_campus"), "use --set link.uplink.trace.file=LOG"),
        (("simulate", "--laws", "pid"), "use --set controller.law=NAME"),
        (("margin", "--law", "pid"), "--laws"),
    ],
)
def test_option_of_another_command_names_what_does_the_same(words, instead, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    output = output_of(*words, code=2)
    assert "No such option" in output
    assert instead in output
