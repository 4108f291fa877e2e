"""The table of commands: what it says of each, and that nothing is imported without need."""

import re
import subprocess
import sys

import pytest

from deploy.cli.commands import COMMANDS, LazyCommand, summary_of


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_says_of_itself_what_the_table_says(name):
    paragraph = (LazyCommand(name).load().help or "").partition("\n\n")[0]
    assert " ".join(paragraph.split()) == summary_of(name)


@pytest.mark.parametrize(
    "words",
    [
        ["--help"], ["nothing-of-ours"], [],
        ["run", "--help"], ["simulate", "--help"], ["run", "--no-such-option"],
    ],
)  # fmt: skip
def test_help_and_wrong_words_import_nothing_heavy(words):
    heavy = ("numba", "numpy", "pinocchio", "pybullet", "plotly", "zenoh", "yaml")
    program = (
        f"import sys; sys.argv = ['funnel-hil', *{words}]\n"
        "from deploy.cli import main\n"
        "try:\n    main()\nexcept SystemExit:\n    pass\n"
        f"print('imported:', *(name for name in {heavy} if name in sys.modules))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "imported:"


def test_a_process_of_a_run_starts_without_what_only_others_need():
    look = (
        "import sys; from deploy.cli.commands import LazyCommand; LazyCommand('plant').load();"
        "print(*{'plotly', 'dask', 'pyarrow', 'can', 'canopen', 'cryptography'} & {*sys.modules})"
    )
    ended = subprocess.run([sys.executable, "-c", look], check=True, capture_output=True, text=True)
    assert ended.stdout.strip() == ""


def test_help_names_every_command_and_a_typing_error_its_neighbour(funnel_hil):
    code, said = funnel_hil("--help")
    assert code == 0
    for name in COMMANDS:
        assert re.search(rf"^. {name} +[A-Z]", said, re.MULTILINE), name
    code, said = funnel_hil("smulate")
    assert code == 2
    assert "Did you mean 'simulate'" in said


def test_a_run_loads_neither_figures_nor_studies():
    heavy = ("plotly", "jinja2", "distributed", "pyarrow", "deploy.study.folder", "pybullet")
    program = (
        "import sys; import deploy.cli.one_run\n"
        f"print('imported:', *(name for name in {heavy} if name in sys.modules))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "imported:"
