"""Ctrl-C, SIGTERM and SIGHUP mean the same to every command; a closed output means nothing."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from deploy import cli
from deploy.cli import recorded
from deploy.run.stop_signals import STOPS
from tests.deploy.own_laws import own_law

ROOT = Path(__file__).resolve().parents[3]
SHORT = ["--set", "duration_s=0.02"]
ENDLESS = ["--set", "duration_s=3600", "--set", "reference.x.velocity_m_s=0"]
pytestmark = pytest.mark.usefixtures("heeded_signals")


def funnel_hil(*words, **streams):
    return subprocess.Popen(
        [sys.executable, "-m", "deploy.cli", *words],
        env={**os.environ, "PYTHONPATH": str(ROOT)}, **streams,
    )  # fmt: skip


@pytest.mark.parametrize("number", STOPS)
def test_a_command_that_has_nothing_to_end_in_order_ends_at_once(number, tmp_path, capsys):
    def be_signalled(*_):
        os.kill(os.getpid(), number)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recorded, "load_run", be_signalled)
        patch.setattr(sys, "argv", ["funnel-hil", "replay", str(tmp_path)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
    assert ended.value.code == 130
    assert capsys.readouterr().err == "stopped\n"


def test_a_run_is_ended_in_order(tmp_path, monkeypatch):
    from deploy.cli.parts.progress import CommandProgress  # what it shows is what it has got to

    follow, asked = CommandProgress.follow, []

    def signalled(progress, position, name):
        def look():
            time_s = position()
            if time_s > 0.2 and not asked:
                asked.append(time_s)
                os.kill(os.getpid(), signal.SIGTERM)
            return time_s

        follow(progress, look, name)

    monkeypatch.setattr(CommandProgress, "follow", signalled)
    out = tmp_path / "out"
    words = ["funnel-hil", "simulate", "paper_arm", *ENDLESS, "--out", str(out)]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 130
    assert (out / "summary.json").exists()


LOOPS = {
    "python": """print("begins", flush=True)
while True:
    try:
        while True:
            pass
    except BaseException:
        pass""",
    # All in C, which keeps Python's lock: a signal after "begins" finds no Python code to end.
    "compiled": """import itertools, os
begins = map(os.write, (1,), (b"begins\\n",))
sum(itertools.chain(begins, itertools.repeat(0)))""",
}


@pytest.mark.parametrize(
    ("command", "signals", "loop", "code"),
    [
        ("simulate", 1, "python", 130), ("compare", 2, "python", 130),
        ("simulate", 1, "compiled", -signal.SIGKILL),
    ],
)  # fmt: skip
def test_law_in_an_endless_loop_keeps_no_command_from_ending(
    command, signals, loop, code, tmp_path
):
    law = own_law(tmp_path, LOOPS[loop])
    scenario = f"{{extends: paper_arm, name: mine, controller: {{law: '{law}'}}}}"
    (tmp_path / "mine.yaml").write_text(scenario)
    words = [command, "mine.yaml", *(["--laws", law] * (command == "compare"))]
    with funnel_hil(*words, "--out", "out", cwd=tmp_path, stdout=subprocess.PIPE) as process:
        while b"begins" not in process.stdout.readline():
            assert process.poll() is None
        for _ in range(signals):
            process.send_signal(signal.SIGTERM)
        assert process.wait(60) == code


ENDINGS = {
    "exits in Python": ("import os; os._exit(0)", 1),
    "exits in C": ("import ctypes; ctypes.CDLL(None).exit(0)", 1),
    "exits with a code of its own": ("import os; os._exit(7)", 7),
    "crashes": ("import ctypes; ctypes.string_at(0)", -signal.SIGSEGV),
}


@pytest.mark.parametrize("ending", ENDINGS)
def test_law_that_ends_its_process_never_ends_simulate_with_0(ending, tmp_path):
    does, code = ENDINGS[ending]
    words = ["simulate", *SHORT, "--set", f"controller.law={own_law(tmp_path, does)}"]
    process = funnel_hil(*words, "--out", "out", cwd=tmp_path, stderr=subprocess.PIPE)
    _, output = process.communicate(timeout=120)
    assert process.returncode == code
    assert code == 7 or b"error: the " in output
    assert not (tmp_path / "out" / "summary.json").exists()


def test_sighup_ends_nothing_under_nohup(monkeypatch, tmp_path):
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    words = ["funnel-hil", "simulate", "paper_arm", *SHORT, "--out", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit):
        cli.main()
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN


@pytest.mark.parametrize(
    ("output", "message"),
    [
        ("| true", ""), (">&-", ""),
        (">/dev/full", "standard output is lost: No space left on device\n"),
    ],
    ids=["no reader", "closed", "full"],
)  # fmt: skip
def test_run_without_an_output_goes_on_to_its_end(output, message, tmp_path):
    shell = f'"$0" -m deploy.cli simulate --set duration_s=0.02 --out "$1" {output}'
    command = ["bash", "-o", "pipefail", "-c", shell, sys.executable, str(tmp_path / "out")]
    ended = subprocess.run(command, cwd=ROOT, check=False, stderr=subprocess.PIPE, text=True)
    assert (ended.returncode, ended.stderr) == (0, message)
    assert (tmp_path / "out" / "summary.json").exists()
    assert (tmp_path / "out" / "report.html").exists()


LOADING = """
import builtins, os, signal, sys
loads = builtins.__import__

def stopped(name, *rest):
    if name == "typer":
        os.kill(os.getpid(), int(sys.argv[-1]))
    return loads(name, *rest)

builtins.__import__ = stopped
from deploy.cli import main
main()
"""


@pytest.mark.parametrize("number", STOPS)
def test_a_request_while_the_program_loads_is_one_too(number):
    command = [sys.executable, "-c", LOADING, "--help", str(int(number))]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "stopped\n")
