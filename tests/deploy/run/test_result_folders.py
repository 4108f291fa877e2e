"""Results are not lost to another command, a full disk, or a stop while they are judged."""

from __future__ import annotations

import json
import resource
import signal

import pytest

from deploy.reports import html
from deploy.run.new_folder import FolderLock, new_folder
from deploy.study.execution import dask_workers

SHORT = ["--set", "duration_s=0.05", "--set", "metrics.from_s=0.01"]
COMMANDS = {
    "simulate": ["simulate", *SHORT],
    "run": ["run", *SHORT, "--set", "clock=lockstep"],
    "compare": ["compare", "--laws", "pid", *SHORT],
    "margin": ["margin", "--laws", "pid", *SHORT],
    "sweep": ["sweep", "delay_sweep", *SHORT],
}


@pytest.fixture
def no_workers(monkeypatch):
    """Workers that would start fail the test."""
    monkeypatch.setattr(dask_workers, "LocalCluster", lambda **_: pytest.fail("workers started"))


@pytest.mark.usefixtures("no_workers")
@pytest.mark.parametrize("command", COMMANDS)
def test_folder_with_results_is_refused(funnel_hil, tmp_path, command):
    (tmp_path / "summary.json").write_text("precious")
    output = funnel_hil.output(*COMMANDS[command], "--out", tmp_path, code=2)
    assert [word for word in ("--out", str(tmp_path), "summary.json", "--overwrite")
            if word not in output] == []  # fmt: skip
    assert [file.name for file in tmp_path.iterdir()] == ["summary.json"]
    assert (tmp_path / "summary.json").read_text() == "precious"


@pytest.mark.parametrize("command", ["simulate", "compare"])
def test_results_are_overwritten_where_that_is_asked_for(funnel_hil, tmp_path, command):
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "study.yaml").write_text("of another kind of command")
    words = [*COMMANDS[command], "--out", tmp_path]
    assert funnel_hil(*words)[0] == 2
    assert funnel_hil(*words, "--overwrite")[0] == 0
    # The same comparison goes on where it is, and finds all there.
    assert funnel_hil(*words)[0] == (0 if command == "compare" else 2)
    assert funnel_hil(*words, "--overwrite")[0] == 0
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert (tmp_path / "study.yaml").exists() == (command == "compare")  # its own


@pytest.mark.usefixtures("no_workers")
def test_overwrite_means_nothing_without_a_folder(funnel_hil, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for words in COMMANDS.values():
        output = funnel_hil.output(*words, "--overwrite", code=2)
        assert "--overwrite: needs --out" in output
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("no_workers")
@pytest.mark.parametrize("command", COMMANDS)
def test_two_commands_in_one_folder_are_refused(funnel_hil, tmp_path, command):
    lock = FolderLock(tmp_path)
    code, output = funnel_hil(*COMMANDS[command], "--out", tmp_path, "--overwrite")
    lock.close()
    assert code == 2
    assert f"error: {tmp_path}: another command is writing there" in output
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def no_large_files():
    """The system takes no file above 2 MB, which a report is, and a short recording is not."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2_000_000, limits[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, limits)


@pytest.mark.usefixtures("no_large_files")
def test_file_that_the_disk_does_not_take_is_named(funnel_hil, tmp_path):
    output = funnel_hil.output(*COMMANDS["simulate"], "--out", tmp_path, code=1)
    assert f"{tmp_path / 'report.html'}: cannot be written: File too large" in output
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert not summary["completed"]
    assert "report.html" in summary["faults"][0]
    assert not (tmp_path / "report.html").exists()


def test_old_results_stay_where_new_ones_have_no_room(funnel_hil, tmp_path, request):
    words = (*COMMANDS["simulate"], "--no-report", "--out", tmp_path)
    assert funnel_hil(*words)[0] == 0
    old = (tmp_path / "run.mcap").read_bytes()
    request.getfixturevalue("no_large_files")
    output = funnel_hil.output(*words, "--overwrite", code=2)
    assert "the old results are kept, because there is no room for 10 MB" in " ".join(
        output.split()
    )
    assert (tmp_path / "run.mcap").read_bytes() == old


@pytest.mark.parametrize(
    ("summary", "is_own"),
    [
        (None, False),
        ({"kind": "run"}, False),
        ({"files": ["other.urdf", "../robot.urdf", 3]}, False),
        ({"files": ["robot.urdf"]}, True),
    ],
)
def test_overwrite_removes_only_files_that_the_summary_lists(tmp_path, summary, is_own):
    (tmp_path / "robot.urdf").write_text("an arm")
    if summary is not None:
        (tmp_path / "summary.json").write_text(json.dumps(summary))
    new_folder("x", tmp_path, overwrite=True)
    assert (tmp_path / "robot.urdf").exists() != is_own
    assert not (tmp_path / "summary.json").exists()


@pytest.mark.usefixtures("heeded_signals")
def test_judging_stops_when_asked_to_and_can_be_done_again(funnel_hil, tmp_path, monkeypatch):
    draw = html.write_page

    def be_stopped_and_draw(*words):
        assert (tmp_path / "summary.json").exists()
        signal.raise_signal(signal.SIGTERM)
        draw(*words)

    with monkeypatch.context() as patch:
        patch.setattr(html, "write_page", be_stopped_and_draw)
        code, output = funnel_hil(*COMMANDS["simulate"], "--out", tmp_path)
    assert code == 130
    assert f"funnel-hil report {tmp_path}" in output
    assert not (tmp_path / "report.html").exists()
    assert not json.loads((tmp_path / "summary.json").read_text())["completed"]
    assert funnel_hil("report", tmp_path)[0] == 0
    assert (tmp_path / "report.html").exists()
    assert json.loads((tmp_path / "summary.json").read_text())["completed"]


def test_no_report_leaves_it_for_later(funnel_hil, tmp_path):
    out = tmp_path / "out"
    output = funnel_hil.output("simulate", "--set", "duration_s=0.1", "--no-report", "--out", out)
    assert not (out / "report.html").exists()
    assert f"funnel-hil report {out} writes the report" in output
    before = (out / "summary.json").read_text()
    assert funnel_hil("report", out)[0] == 0
    assert (out / "report.html").stat().st_size > 100_000
    assert (out / "summary.json").read_text() == before
