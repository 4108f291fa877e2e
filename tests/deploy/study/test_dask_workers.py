"""Sweeps on Dask: a cluster of separate processes, killed workers, killed commands."""

from __future__ import annotations

import errno
import gc
import json
import os
import signal
import socket
import sys
import tempfile
import time

import pytest
import yaml
from distributed import Client
from distributed.security import Security
from pyarrow import parquet

from bus_schema.runtime import compiled
from deploy.studies.sweep.sweep import load_sweep
from deploy.study.execution import dask_workers, law_code
from deploy.study.execution.dask_workers import DaskWorkers
from deploy.study.execution.folder import StudyFolder
from deploy.study.execution.runner import carry_out
from deploy.study.planned_run import PlannedRun
from tests.deploy.own_laws import own_law
from tests.deploy.study.dask_parts import TRUSTED
from tests.deploy.study.studies import Here
from tests.waiting import HANG_S, await_true
from tests.warm_process import ROOT, WarmProcess

# Runs of the latter begin when they are let, so that a sweep can be caught in the middle.
DEADLY = "import os\nos._exit(1)"
GATED = """if not hasattr(self, "has_begun"):
    import time
    from pathlib import Path
    self.has_begun = True
    here = Path({folder!r})
    with open(here / "begun", "ab", buffering=0) as begun:
        begun.write(b".")
        place = begun.tell()
    while place > (here / "let").stat().st_size:  # its content would be an input of the run
        time.sleep(0.01)"""
EVERY = 10**6


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """A scheduler and two workers, each a process of its own: its address, and the worker that
    is not restarted when it dies.
    """
    folder = tmp_path_factory.mktemp("cluster")
    own_law(folder, DEADLY, "deadly")
    place = folder / "scheduler.json"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([*sys.path, str(folder)])}

    def start_part(part, *words):
        return WarmProcess(
            *words, "--scheduler-file", place, "--no-dashboard",
            main=f"tests.deploy.study.dask_parts:{part}", cwd=folder, environment=environment,
        )  # fmt: skip

    processes = [start_part("scheduler", "--host", "127.0.0.1", "--port", "0")]
    await_true(place.exists)
    await_true(lambda: place.read_text().endswith("}"))
    processes += [
        start_part(part, "--nthreads", "1", "--no-nanny") for part in ("lasting_worker", "worker")
    ]
    yield json.loads(place.read_text())["address"], processes[-1]
    for process in reversed(processes):
        process.kill()
        process.wait()


@pytest.fixture
def definition(tmp_path):
    """A sweep of 12 short runs."""
    return write_sweep(tmp_path / "short.yaml", {"link.uplink.delay_ms": [0, 1, 2]}, seeds=4)


def write_sweep(file, grid, **more):
    fixed = {"duration_s": 0.2, "metrics.from_s": 0.1, **more.pop("set", {})}
    values = {"name": "short", "scenario": "paper_arm", "set": fixed, "grid": grid, **more}
    file.write_text(yaml.safe_dump(values))
    return file


def write_gated_sweep(folder, seeds):
    """A sweep of two points, whose runs wait for a `Gate`."""
    grid, gated = {"link.uplink.delay_ms": [0, 1]}, {"controller.law": "gated:Own"}
    return write_sweep(folder / "long.yaml", grid, seeds=seeds, set=gated)


class Gate:
    """Lets the runs of sweeps whose law is `gated:Own` begin.

    Args:
        folder: where the law is written.
    """

    def __init__(self, folder):
        self._let, self._begun = folder / "let", folder / "begun"
        self._begun.touch()
        self.let(0)
        own_law(folder, GATED.format(folder=str(folder)), "gated")

    def let(self, runs):
        """Let so many runs begin in all."""
        self._runs_let = runs
        self._let.touch()
        os.truncate(self._let, runs)

    def wait_for(self, runs):
        """Wait until so many runs are at the gate or through it."""
        await_true(lambda: self._begun.stat().st_size >= runs)

    def let_until(self, condition):
        """Let one run after another begin until something is so."""
        self.wait_for(self._runs_let + 1)
        while not condition():
            self.let(self._runs_let + 1)
            self.wait_for(self._runs_let + 1)
            time.sleep(0.2)  # the table is written once a second


def start(definition, out, *words, cwd=ROOT):
    """`sweep` in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    words = ["sweep", definition, "--out", out, *words]
    main = "tests.deploy.study.dask_parts:trusting_command"
    return WarmProcess(*words, main=main, cwd=cwd, environment=environment)


def rows_in(out):
    """How many rows the table of a sweep has so far."""
    file = out / "sweep.parquet"
    return parquet.read_table(file).num_rows if file.exists() else 0


def assert_as_done_here(file, definition, folder):
    """A table is that of the sweep when this process does one run after another."""
    sweep = load_sweep(str(definition))
    folder.mkdir()
    table, workers = StudyFolder(folder, sweep), Here()
    carry_out(sweep, workers, table, workers.stop)
    table.write(completed=True)
    found, expected = parquet.read_table(file), parquet.read_table(table.rows_file)
    assert found.schema == expected.schema
    pairs = zip(found.to_pylist(), expected.to_pylist(), strict=True)
    differing = [
        (row["point"], name, value, other[name])
        for row, other in pairs
        for name, value in row.items()
        if value != other[name]
    ]
    assert not differing


def test_a_sweep_on_a_cluster_gives_the_rows_of_one_process(
    funnel_hil, cluster, definition, tmp_path
):
    address, _ = cluster
    out = tmp_path / "out"
    output = funnel_hil.output("sweep", definition, "--scheduler", address, "--out", out)
    assert "12 of 12 runs" in output
    assert_as_done_here(out / "sweep.parquet", definition, tmp_path / "here")


def test_a_scheduler_that_does_not_answer_is_refused(funnel_hil, definition, tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        code, output = funnel_hil(
            "sweep", definition, "--scheduler", address, "--out", tmp_path / "out"
        )
    assert code == 2
    assert output.startswith(f"error: --scheduler {address}: must be")
    assert not (tmp_path / "out").exists()


def test_a_worker_killed_in_the_middle_costs_no_row_and_doubles_none(funnel_hil, cluster, tmp_path):
    address, worker = cluster
    gate, definition = Gate(tmp_path), write_gated_sweep(tmp_path, seeds=30)
    command = start(definition, tmp_path / "out", "--scheduler", address, cwd=tmp_path)
    gate.let(4)
    gate.wait_for(6)  # each worker is in the middle of a run
    worker.kill()
    gate.let(EVERY)
    assert command.wait(timeout=HANG_S) == 0
    rows = parquet.read_table(tmp_path / "out" / "sweep.parquet").to_pylist()
    assert [(row["point"], row["seed"]) for row in rows] == [
        (point, seed) for point in ("00000", "00001") for seed in range(1, 31)
    ]
    assert all(row["error"] is None for row in rows)


def test_a_command_killed_in_the_middle_goes_on_where_it_stopped(cluster, tmp_path, monkeypatch):
    gate, definition = Gate(tmp_path), write_gated_sweep(tmp_path, seeds=40)
    out = tmp_path / "out"
    words = (definition, out, "--workers", "1")
    killed = start(*words, cwd=tmp_path)
    gate.let_until(lambda: rows_in(out))
    killed.kill()
    killed.wait()
    kept = rows_in(out)
    assert 0 < kept < 80
    stopped = start(*words, cwd=tmp_path)
    gate.let_until(lambda: rows_in(out) > kept)
    stopped.send_signal(signal.SIGINT)
    gate.let(EVERY)
    output = stopped.communicate(timeout=HANG_S)[0]
    assert stopped.returncode == 130, output
    assert f"{kept} runs were there from before" in output
    assert "repeat the same command to continue" in output
    assert kept < rows_in(out) < 80
    # who does the rest does not matter
    last = start(definition, out, "--scheduler", cluster[0], cwd=tmp_path)
    assert last.wait(timeout=HANG_S) == 0
    monkeypatch.chdir(tmp_path)
    for name, names in TRUSTED.items():
        monkeypatch.setattr(law_code, name, names)
    assert_as_done_here(out / "sweep.parquet", definition, tmp_path / "here")


def test_workers_of_our_own_leave_interrupts_to_the_command(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with DaskWorkers(1) as team:
        ignoring = team.client.run(lambda: signal.getsignal(signal.SIGINT) == signal.SIG_IGN)
        collecting = team.client.run(gc.isenabled)  # which it is not while modules are loaded
    assert list(ignoring.values()) == [True]
    assert list(collecting.values()) == [True]


def test_next_study_gets_no_run_of_the_one_before():
    """Both have a run of the same point and seed."""
    before, after = (
        PlannedRun("0", "paper_arm", (f"duration_s={duration_s}",), 1, {})
        for duration_s in (1.0, 0.05)
    )
    with DaskWorkers(1) as team:
        team.submit(before)
        team.forget()
        team.submit(after)
        found = []
        await_true(lambda: found.append(team.finished(0.2)) or found[-1])
        run, row = found[-1]
        assert run is after
        assert row["duration_s"] == 0.05
        assert team.finished(1.0) is None


def test_workers_of_our_own_leave_no_files(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with DaskWorkers(1):
        assert list(tmp_path.iterdir())
    assert list(tmp_path.iterdir()) == []


def test_compilation_in_workers_is_reported_once_by_the_command(monkeypatch, caplog, capfd):
    monkeypatch.delenv(compiled.HAS_SAID)
    with DaskWorkers(2) as team:
        team.client.run(compile_something)
        await_true(lambda: caplog.messages)
    ours = [each.message for each in caplog.records if each.name.startswith("bus_schema.")]
    assert ours == [compiled.COMPILES]  # Dask may complain of a connection that ends
    assert compiled.COMPILES not in capfd.readouterr().err


def compile_something():
    compiled.say_that_it_compiles(compiled.logger.warning)


def test_a_run_that_takes_its_workers_with_it_is_a_row(cluster, tmp_path):
    laws = {"controller.law": ["pid", own_law(tmp_path, DEADLY, "deadly")]}
    definition = write_sweep(tmp_path / "d.yaml", laws)
    command = start(definition, tmp_path / "out", "--scheduler", cluster[0], cwd=tmp_path)
    assert command.wait(timeout=HANG_S) == 0
    survivor, deadly = parquet.read_table(tmp_path / "out" / "sweep.parquet").to_pylist()
    assert survivor["error"] is None
    assert "ended the process of every worker" in deadly["error"]
    assert deadly["controller.law"] == "deadly:Own"


def test_stranger_on_this_machine_cannot_use_our_own_cluster():
    with DaskWorkers(workers=1) as team:
        scheduler = team.client.scheduler.address
        workers = team.client.scheduler_info(n_workers=-1)["workers"]
        places = [scheduler, *workers, *(worker["nanny"] for worker in workers.values())]
        assert {place.partition("://")[0] for place in places} == {"tls"}
        for address, security in (
            (scheduler.replace("tls", "tcp"), Security()),
            (scheduler, Security.temporary()),
        ):
            with pytest.raises(OSError, match=r"TCP|TLS"):
                Client(address, security=security, timeout=3, set_as_default=False)


def test_worker_that_is_ended_while_it_starts_is_one_sentence(monkeypatch):
    monkeypatch.setattr(dask_workers, "__name__", "no_such_module")  # what a worker preloads
    with pytest.raises(OSError, match=r"^the study's worker processes did not start: "):
        DaskWorkers(1)


def test_missing_shared_memory_is_named_where_workers_need_it(monkeypatch):
    def semaphore(*_args, **_options):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("multiprocessing.synchronize.SemLock.__init__", semaphore)
    with pytest.raises(OSError, match=r"No space left on device \(they need room in /dev/shm\)"):
        DaskWorkers(1)
