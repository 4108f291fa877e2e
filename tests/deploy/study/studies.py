"""Studies for tests: small ones, and workers that carry them out at once."""

from __future__ import annotations

import random
import threading
from pathlib import Path

from deploy.studies.margin.margin import Margin
from deploy.studies.sweep.sweep import Sweep
from deploy.study.execution.dask_workers import packed, row_with
from deploy.study.execution.folder import StudyFolder
from deploy.study.execution.runner import carry_out
from deploy.study.planned_run import row_of

TIED = "link.uplink.delay_ms, link.downlink.delay_ms"


class Here:
    """Workers that do a run when asked for one, in an order of their own."""

    count = 2

    def __init__(self, do=row_of, seed=0, at_most=None):
        self._do, self._waiting, self._random = do, [], random.Random(seed)
        self.submitted, self.stop, self._at_most = [], threading.Event(), at_most

    def submit(self, run):
        self.submitted.append(run)
        self._waiting.append(run)

    def finished(self, _timeout_s):
        run = self._waiting.pop(self._random.randrange(len(self._waiting)))
        if self._at_most is not None and len(self.submitted) - len(self._waiting) >= self._at_most:
            self.stop.set()
        return run, self._do(run)


class OneWorkerHere(Here):
    """In place of `DaskWorkers`: does the runs of a command in this process, one by one."""

    count = 1

    def __init__(self, workers=None, scheduler=None, laws=()):
        sent = packed(laws)
        super().__init__(lambda run: row_with(run, sent))
        self._random.randrange = lambda _count: 0  # in order, as a worker does them

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def forget(self):
        self._waiting.clear()


def made_up(run, **values):
    """A row without a simulation."""
    fraction = values.pop("violation_fraction", 0.0)
    return {
        "law": "pid", "point": run.point, **run.columns, "scenario": "made_up", "seed": run.seed,
        "completed": True, "error": None, "bounds_kept": fraction == 0.0,
        "verdict": "faulted" if values.get("error") else "lost" if fraction else "kept",
        "violation_fraction": fraction, "margin_min": 0.5, "rms_rad": [1e-3, 2e-3, 1e-3],
        "total_variation_nm_per_s": [1.0, 1.0, 1.0], "joint_names": ["a", "b", "c"], **values,
    }  # fmt: skip


def sweep_of(grid, **more):
    return {"name": "s", "scenario": "paper_arm", "grid": grid, **more}


def make_sweep(tmp_path, grid, **more):
    return Sweep(sweep_of(grid, **more), tmp_path / "s.yaml")


def folder_of(study, path):
    path.mkdir(exist_ok=True)
    return StudyFolder(path, study)


def conduct(study, path, workers):
    folder = folder_of(study, path)
    whole = carry_out(study, workers, folder, workers.stop)
    folder.write(completed=True)
    return whole, folder


def case_of(study, folder):
    """The only case of a study."""
    (case,) = study.summary(folder.rows)["cases"]
    return case


NOISE = {"plant.encoder.velocity_noise_rad_s": 1e-5}
"""With which another seed is another run."""


def margin_of(**values):
    given = {"laws": ["pid", "smc"], "seeds": 2, "limit": 16, "set": NOISE, **values}
    return Margin(given, Path("margin"))


def limits(run):
    """PID holds to 3 ms, SMC to 9.5 ms, but only to 7 ms from the second start."""
    smc = any("smc" in override for override in run.overrides)
    limit = 3.0 if not smc else 9.5 if run.columns["offset_scale"] == 1.0 else 7.0
    over = max(0.0, run.columns["value"] - limit)
    return made_up(run, violation_fraction=over / 100)
