"""The table of commands: what it says of each, and that help imports none of them."""

import subprocess
import sys

import pytest

from deploy.cli.commands import COMMANDS, LazyCommand


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_says_of_itself_what_the_table_says(name):
    command = LazyCommand(name, *COMMANDS[name])
    paragraph = (command.load().help or "").partition("\n\n")[0]
    assert " ".join(paragraph.split()) == command.help


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
