"""What draws the report of a run is loaded as the processes leave the bus, not before."""

import threading

from deploy.cli import one_run
from deploy.run.processes.status import StatusMessage

LONG_S = 60.0


def test_it_is_loaded_once_the_plant_has_ended(monkeypatch):
    loaded, shown = threading.Semaphore(0), []
    monkeypatch.setattr(one_run, "load_report", loaded.release)
    handle = one_run.loading_report(shown.append)
    early = [
        StatusMessage("plant", "note", {}),
        StatusMessage("plant", "progress", {"time_s": 0.2}),
        StatusMessage("controller", "result", {}),
    ]
    for message in early:
        handle(message)
    assert not loaded.acquire(blocking=False)
    results = [StatusMessage("plant", "result", {})] * 2  # of a plant that was started again, too
    for message in results:
        handle(message)
    assert loaded.acquire(timeout=LONG_S)
    assert not loaded.acquire(blocking=False)
    assert shown == [*early, *results]
