"""Runs of the command line: starting them, watching them from outside, reading what they leave."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.lib.recfunctions import repack_fields

from bus_schema.messages import topics
from bus_schema.messages.types import stamp_of
from bus_schema.recording.mcap_log import LogContents, read_log
from bus_schema.runtime.modes import Mode
from bus_schema.zenoh.session import Delivery, ZenohSession
from deploy.judge.run_data import RunData
from deploy.run.run_folder import load_run
from tests.waiting import HANG_S, await_true
from tests.warm_process import FUNNEL_HIL, ROOT, WITHOUT_REPORT, WarmProcess, here, no_report

PERIOD_S = 0.001
PAPER_ARM_JOINTS = ("base_yaw", "shoulder", "elbow")
_ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "400"}


def bits(log: LogContents, topic: str) -> list[bytes]:
    """What must be equal in equal runs: all of a topic's messages, but for times on the wall."""
    if topic != topics.PLANT_TRUTH.name:
        return log.payloads[topic]
    layout = topics.layout(topics.PLANT_TRUTH, PAPER_ARM_JOINTS)
    truth = np.frombuffer(b"".join(log.payloads[topic]), layout.dtype)
    kept = [name for name in layout.dtype.names or () if not name.startswith("timing.")]
    return [row.tobytes() for row in repack_fields(truth[kept])]


@dataclass(frozen=True)
class Finished:
    """A command that has ended, and the folder it wrote to."""

    folder: Path
    code: int
    output: str

    @cached_property
    def summary(self) -> dict[str, Any]:
        summary: dict[str, Any] = json.loads((self.folder / "summary.json").read_text())
        return summary

    @cached_property
    def log(self) -> LogContents:
        return read_log(self.folder / "run.mcap")

    @cached_property
    def data(self) -> RunData:
        return load_run(self.folder)[0]

    @property
    def digest(self) -> str:
        return str(self.summary["digest"])


def settings(**values: Any) -> list[str]:
    """Overrides for the command line; ``__`` in a name stands for the dot."""
    return [
        word
        for name, value in values.items()
        for word in ("--set", f"{name.replace('__', '.')}={json.dumps(value)}")
    ]


PATIENT = settings(link__reply_timeout_s=60, link__connect_timeout_s=HANG_S)
"""What every run has that is not given others: no busy machine holds up a process for so long."""
ENDLESS = settings(duration_s=3600.0, reference__x__velocity_m_s=0.0)
"""Of paper_arm: a run to act upon that the test ends, and that no machine is too slow for. The path
of the scenario itself leaves the arm's reach after 97 s."""
IN_LOCKSTEP = ("run", "paper_arm", *ENDLESS, *settings(clock="lockstep"))
"""A command for such a run in lockstep."""
WIDE = settings(
    funnel__widest_rad=3.0,
    funnel__convergence_margin_rad=3.0,
    funnel__overshoot_margin_rad=3.0,
    funnel__final_rad=3.0,
)
"""A funnel that an arm does not leave when the machine holds up a real-time run for half a second:
its commands missing for 0.4 s, paper_arm uses 5 % of it."""


def funnel_hil(*words: str, out: Path | None, code: int = 0, with_report: bool = False) -> Finished:
    """Run a command that has to end with this exit code, in a process of its own."""
    process = _process(*words, out=out, with_report=with_report)
    output, _ = process.communicate()
    assert process.wait() == code, output
    return Finished(out or Path(), code, output)


def funnel_hil_here(*words, out=None, code=0, with_report=False):
    """Run a command that has to end with this exit code, in this process."""
    with nullcontext() if with_report else no_report():
        found, output = here(*_command(*words, out=out), **_ENVIRONMENT)
    assert found == code, output
    return Finished(out or Path(), found, output)


class Running:
    """A command under way."""

    def __init__(self, folder: Path, process: WarmProcess) -> None:
        self.folder = folder
        self.process = process

    def plant_endpoint(self) -> str:
        """Where the plant of this run listens."""
        await_true(lambda: bool(processes_of(self.folder).keys() - {"run"}), "it has children")
        scenario = yaml.safe_load((self.folder / "scenario.yaml").read_text())
        return str(scenario["link"]["plant_endpoint"])

    def send(self, number: signal.Signals, role: str | None = None) -> None:
        """Send a signal to one of the run's processes, or to the run itself."""
        os.kill(self.process.pid if role is None else processes_of(self.folder)[role], number)

    def end(self, code: int | None = None) -> Finished:
        """Wait for the end of the run, with this exit code if one is given."""
        output, _ = self.process.communicate()
        ended = Finished(self.folder, self.process.wait(), output)
        assert code in (None, ended.code), output
        return ended

    def end_later(self, more_s=1.0, number=signal.SIGINT):
        """End the run once it has gone on for so much of its own time; how far it came at least."""
        with Watcher(self.plant_endpoint()) as watcher:
            watcher.await_time(0.0, self)
            come_s = watcher.last_stamp_ns * 1e-9 + more_s
            watcher.await_time(come_s, self)
        self.send(number)
        return self.end(130), come_s


@contextmanager
def started(*words: str, out: Path, with_report: bool = False) -> Iterator[Running]:
    """A command under way; its remaining processes are killed at the end."""
    process = _process(*words, out=out, with_report=with_report)
    try:
        yield Running(out, process)
    finally:
        process.kill()
        for pid in processes_of(out).values():
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        process.wait()


class Watcher:
    """A stranger on the bus who listens to what the plant says of every tick."""

    def __init__(self, endpoint: str) -> None:
        self.session = ZenohSession([], [endpoint], low_latency=False)
        self.last_stamp_ns = -1
        self.session.subscribe(topics.PLANT_TRUTH.key_expression(0), self._hear)

    def await_time(self, time_s: float, run: Running) -> None:
        """Wait until `run` has come to a time on its own clock."""

        def has_come() -> bool:
            assert run.process.poll() is None, run.end().output
            return self.last_stamp_ns >= time_s * 1e9

        await_true(has_come, f"the run is at {time_s} s")

    def __enter__(self) -> Watcher:
        return self

    def __exit__(self, *_: object) -> None:
        self.session.close()

    def _hear(self, delivery: Delivery) -> None:
        stamp_ns = stamp_of(delivery.payload)
        self.last_stamp_ns = max(self.last_stamp_ns, -1 if stamp_ns is None else stamp_ns)


def assert_as_simulated(run: Finished, until_s: float, out: Path, *names: str) -> None:
    """Until its interruption a run in lockstep is its simulation, bit for bit."""
    so_long = settings(duration_s=round(until_s, 3), metrics__from_s=0)
    scenario = str(run.folder / "scenario.yaml")
    alone = funnel_hil_here("simulate", scenario, *so_long, out=out)
    for name in names:
        expected = bits(alone.log, name)[: round(1e3 * until_s) - 10]  # without how it ends
        assert len(expected) > 100
        assert bits(run.log, name)[: len(expected)] == expected


def assert_stopped_in_time(run: Finished, timeout_s: float) -> None:
    """In the first tick for which the last command is too old, however late that tick comes."""
    truth, times_s = run.data.tables[topics.PLANT_TRUTH.name], run.data.times_s(topics.PLANT_TRUTH)
    stopped = np.isin(truth["mode"], (Mode.STOPPING, Mode.FAULT))
    assert stopped[-1]
    assert (np.diff(stopped.astype(int)) >= 0).all()  # there is no way back
    last_s = times_s[truth["round_trip_ns"] >= 0][-1]
    first = int(np.argmax(stopped))
    assert times_s[first] > last_s
    assert times_s[first - 1] - last_s <= timeout_s + PERIOD_S + 1e-9
    assert "safe stop" in " ".join(run.summary["faults"])


def processes_of(folder: Path) -> dict[str, int]:
    """Living processes whose command line names a run folder: process ids by role."""
    found = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with suppress(OSError):
                words = (entry / "cmdline").read_bytes().decode().replace("\0", " ").split()
                if any(word.startswith(str(folder)) for word in words) and "deploy.cli" in words:
                    verb = words[words.index("deploy.cli") + 1]
                    found["recorder" if verb == "record" else verb] = int(entry.name)
    return found


def outputs_of(processes: Sequence[WarmProcess]) -> list[str]:
    """Return the output of processes, once all have ended; remaining ones are killed."""
    try:
        return [process.communicate()[0] for process in processes]
    finally:
        for process in processes:
            process.kill()


def _process(*words: str, out: Path | None, with_report: bool) -> WarmProcess:
    main = FUNNEL_HIL if with_report else WITHOUT_REPORT
    return WarmProcess(*_command(*words, out=out), main=main, environment=_ENVIRONMENT)


def _command(*words: str, out: Path | None) -> list[str]:
    verb, *rest = words
    patience = PATIENT if verb == "run" else []
    return [verb, *patience, *rest, *([] if out is None else ["--out", str(out)])]
