"""Laws in programs of their own: what they are asked, what they may do wrong, how they end."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import controller.external
from controller.control_law import Tracking
from controller.external.external_law import ExternalLaw, ExternalLawConfiguration
from controller.external.program import ExternalLawError
from controller.funnel import Funnel
from controller.reference import JointSinusoids
from deploy.judge.bounds import judge_bounds
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup
from tests.waiting import HANG_S
from tests.warm_process import output_of

HERE = Path(controller.external.__file__).parent
PYTHON_EXAMPLE = [sys.executable, str(HERE / "examples" / "stiff_pd.py")]
LIMITS = np.array([400.0, 700.0, np.inf])
PATIENT = [f"controller.external.{word}timeout_s={HANG_S}" for word in ("", "start_")]


@pytest.fixture(scope="module")
def c_example(tmp_path_factory):
    """The example in C, as its comment says that it is built."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("needs a C compiler, cc")
    program = tmp_path_factory.mktemp("c") / "stiff_pd"
    subprocess.run(
        [compiler, "-std=c99", "-Wall", "-Wextra", "-Werror", "-O2", "-ffp-contract=off",
         "-I", HERE, "-o", program, HERE / "examples" / "stiff_pd.c"],
        check=True,
    )  # fmt: skip
    return [str(program)]


def simulated(command, *overrides):
    words = ", ".join(f"'{word}'" for word in command)
    settings = ["controller.law=external", f"controller.external.command=[{words}]", *PATIENT]
    return simulate(load_setup("paper_arm", [*settings, *overrides])).data()


def test_the_examples_in_c_and_in_python_are_the_same_law_to_the_last_bit(c_example):
    runs = [simulated(command, "duration_s=1") for command in (c_example, PYTHON_EXAMPLE)]
    efforts = [run.tables["joint_commands"]["effort"] for run in runs]
    np.testing.assert_array_equal(*efforts)
    assert judge_bounds(runs[0]).violation_fraction == 0.0


def program(tmp_path, body, timeout_s=HANG_S):
    """An external law whose program is some Python."""
    path = tmp_path / "law.py"
    path.write_text(f"import struct, sys, time\nread = sys.stdin.buffer.read\n{body}\n")
    return ExternalLaw(
        ExternalLawConfiguration(
            command=(sys.executable, str(path)), timeout_s=timeout_s, start_timeout_s=HANG_S
        ),
        LIMITS,
    )


ECHO = """
def say(*values):
    sys.stdout.buffer.write(struct.pack(f"{len(values)}d", *values))
    sys.stdout.buffer.flush()
def asked():
    data = read(8 * (8 + 8 * 3))
    return struct.unpack("32d", data) if data else sys.exit(0)
"""


def situation():
    start = np.array([0.1, 0.2, 0.3])
    terms = np.zeros((1, 3, 3))
    terms[0, :, 0], terms[0, :, 1] = 0.1, 2.0
    wide = Funnel(np.full(3, 0.5), np.full(3, 0.4), np.full(3, 0.01), 4.0)
    tracking = Tracking(3)
    tracking.position[:], tracking.velocity[:] = [0.5, 0.6, 0.7], [1.0, 2.0, 3.0]
    tracking.update(0.25, 0.001, JointSinusoids(start, terms), wide)
    return tracking


def test_a_question_has_what_the_protocol_says(tmp_path):
    """Answered with rows of the question itself, one after the other."""
    law = program(
        tmp_path, ECHO + "row = 0\nwhile True:\n    q = asked()\n"
        "    say(0.0, *q[8 + 3 * row:11 + 3 * row]) if row < 8 else say(0.0, *q[:3]) if row == 8"
        " else say(0.0, *q[3:6]) if row == 9 else say(0.0, *q[5:8])\n    row += 1\n",
    )  # fmt: skip
    tracking = situation()
    expected = [
        tracking.position, tracking.velocity, tracking.reference_position,
        tracking.reference_velocity, tracking.reference_acceleration, tracking.upper_bound,
        tracking.lower_bound, LIMITS, [1.0, 1.0, 3.0], [0.25, 0.001, 0.0],
        [0.0, 1.0, 0.0],  # horizon; one row, no targets
    ]  # fmt: skip
    assert tracking.reference_acceleration.any()
    for row in expected:
        np.testing.assert_array_equal(law.torque(tracking), row)


def test_reset_is_asked_once_there_is_something_to_forget(tmp_path):
    law = program(
        tmp_path,
        ECHO + "n = 0\nwhile True:\n    n = n + 1 if asked()[0] else 10\n    say(0.0, n, n, n)",
    )
    law.reset()
    tracking = situation()
    assert [law.torque(tracking)[0], law.torque(tracking)[0]] == [1.0, 2.0]
    law.reset()
    assert law.torque(tracking)[0] == 11.0


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("print('no licence', file=sys.stderr); sys.exit(3)",
         "ended with exit code 3; end of its standard error: no licence"),
        ("read(8)\nsys.exit(0)", "ended with exit code 0"),
        (ECHO + "asked(); say(0.0, 1.0)\nsys.exit(4)", "ended with exit code 4"),
        (ECHO + "asked(); say(7.0, 0.0, 0.0, 0.0)\nread()", "reports failure 7 at 0.250 s"),
        ("import os\nos.abort()", "was ended by SIGABRT"),
        ("import os\nos.kill(os.getpid(), 40)", "was ended by signal 40"),
        (ECHO + "asked(); print('loaded', flush=True); say(0.0, 0.0, 0.0, 0.0); asked()",
         r"sent b'loaded\\n.*text must go to standard error.*at 0\.250 s"),
        (ECHO + "asked(); print(3 * 'this is a law. ', flush=True); read()",
         "sent b'this is a law. this is a"),
    ],
)  # fmt: skip
def test_error_of_a_program_is_reported(tmp_path, body, reason):
    law = program(tmp_path, body)
    tracking = situation()
    answers = (law.torque(tracking) for _ in range(2))
    with pytest.raises(ExternalLawError, match=reason):
        list(answers)
    law.close()


@pytest.mark.parametrize("answer", ["", "say(0.0);"], ids=["none", "a part of one"])
def test_a_program_that_does_not_answer_in_time_has_failed(tmp_path, answer):
    body = f"{ECHO}asked(); say(0.0, 0.0, 0.0, 0.0); asked(); {answer} time.sleep(600)"
    law = program(tmp_path, body, timeout_s=0.2)
    answers = (law.torque(situation()) for _ in range(2))
    with pytest.raises(ExternalLawError, match=r"did not answer within 0\.2 s"):
        list(answers)
    law.close()


def test_a_program_ends_with_its_law(tmp_path):
    law = program(tmp_path, ECHO + "while True:\n    asked(); say(0.0, 0.0, 0.0, 0.0)")
    law.torque(situation())
    process = law._program._process
    assert process.poll() is None
    law.close()
    assert process.poll() == 0
    law.close()


def test_a_recording_of_it_is_judged_but_not_done_again_unasked(tmp_path, monkeypatch):
    """A recording may be anybody's: its program is not started, nor has it to be there."""
    monkeypatch.chdir(tmp_path)
    script, command = Path("law.py"), f"['{sys.executable}', law.py]"
    script.write_text((HERE / "examples" / "stiff_pd.py").read_text())
    settings = ["controller.law=external", f"controller.external.command={command}"]
    arguments = [word for setting in settings for word in ("--set", setting)]
    output_of("simulate", *arguments, "--set", "duration_s=0.2", "--out", "out")
    output_of("replay", "out", "--allow-custom-law")
    script.write_text("import pathlib; pathlib.Path('started').touch()")
    output_of("report", "out")
    assert "--allow-custom-law" in output_of("replay", "out", code=2)
    assert not Path("started").exists()
