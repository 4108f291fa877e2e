"""Dask as the workers of studies: separate processes on this machine, or an existing cluster."""

from __future__ import annotations

import asyncio
import gc
import io
import logging
import os
import queue
import signal
import sys
import tempfile
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import lru_cache
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import cloudpickle
import dask
from distributed import Client, Future, LocalCluster, Worker, rpc
from distributed.scheduler import KilledWorker
from distributed.security import Security

from bus_schema.runtime import compiled
from bus_schema.safe_path import restore_path, safe_path
from controller.laws.custom import EXTERNAL, Maker, find_law, is_custom, laws_given
from controller.laws.read_files import is_of_the_user
from deploy.judge.run_rows import Row
from deploy.scenario.yaml_files import ScenarioError
from deploy.study.execution.provenance import Provenance, current
from deploy.study.execution.runner import WorkersLostError
from deploy.study.planned_run import PlannedRun, failed, row_of

_ANSWER_S = 3.0
_WORKERS_S = 5.0
_FIRST_TASK_S = 30.0
_UNWATCHED = {"distributed.worker.profile.enabled": False, "distributed.admin.tick.interval": "1s"}
"""Dask's own profiler and its watch over its event loop interrupt a run hundreds of times."""
_COMPILES = "funnel-hil compiles"
"""Topic of the events by which workers report that they compile."""
Packed = Mapping[str, bytes]
"""Laws by name, in `cloudpickle`'s format."""


class DaskWorkers:
    """Processes that execute runs.

    A worker that dies costs no row, as others take over its runs. Runs whose workers die repeatedly
    are tried once more, alone, as any run of a worker may be the cause; if its workers die even
    then, the run becomes a row with an error.

    Args:
        workers: number of processes to start on this machine; by default its number of cores.
        scheduler: address of a scheduler to use instead.
        laws: names of laws; custom ones are sent with every run, so that no worker needs their
            files.

    Raises:
        ScenarioError: the scheduler does not answer, or its workers cannot execute runs.
    """

    def __init__(
        self, workers: int | None = None, scheduler: str | None = None, laws: Iterable[str] = ()
    ) -> None:
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        self._laws = packed(laws)
        self._futures: list[Future] = []
        self._open = ExitStack()
        self.forget()
        if scheduler is not None:
            self.client = self._open.enter_context(_connect(scheduler))
            return
        with self._open:
            self._open.enter_context(safe_path())  # a worker that dies is replaced at any time
            scratch = tempfile.TemporaryDirectory(
                prefix="funnel-hil-", dir=dask.config.get("temporary-directory", None)
            )
            cluster = _own_cluster(workers, self._open.enter_context(scratch))
            self.client = self._open.enter_context(Client(self._open.enter_context(cluster)))
            self.client.subscribe_topic(_COMPILES, _say_that_they_compile)
            self._open = self._open.pop_all()

    def __enter__(self) -> DaskWorkers:
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    @property
    def count(self) -> int:
        """Number of runs that they execute at a time, as far as known."""
        workers = self.client.scheduler_info(n_workers=-1)["workers"].values()
        return sum(worker["nthreads"] for worker in workers)

    def current(self, parts: Iterable[str]) -> list[Provenance]:
        """Return the present values of parts of a provenance, as each worker has them."""
        found: Mapping[str, Provenance] = self.client.run(current, list(parts))
        return list(found.values())

    def forget(self) -> None:
        """Drop all runs, so that another study of the same laws can begin."""
        for future in self._futures:
            if self.client.status == "running":
                future.cancel()
        self._futures.clear()
        self._finished: queue.SimpleQueue[tuple[PlannedRun, Future]] = queue.SimpleQueue()
        self._in_flight = 0
        self._suspects: deque[PlannedRun] = deque()
        self._alone: PlannedRun | None = None

    def submit(self, run: PlannedRun) -> None:
        """Submit a run."""
        self._in_flight += 1
        future = self.client.submit(row_with, run, self._laws, pure=False)
        finished = self._finished  # of this study
        future.add_done_callback(lambda done: finished.put((run, done)))
        self._futures = [each for each in self._futures if not each.done()] + [future]

    def finished(self, timeout_s: float) -> tuple[PlannedRun, Row] | None:
        """Return a finished run, in any order; None if none was finished in time.

        Raises:
            WorkersLostError: no run will ever finish.
        """
        if not self._in_flight and self._suspects:
            self._alone = self._suspects.popleft()
            self.submit(self._alone)
        try:
            run, future = self._finished.get(timeout=timeout_s)
        except queue.Empty:
            if self.client.status not in ("running", "connecting"):
                raise WorkersLostError("the connection to the Dask scheduler is lost") from None
            return None
        self._in_flight -= 1
        if future.status == "cancelled":
            raise WorkersLostError("the connection to the Dask scheduler is lost")
        error = future.exception()
        if error is None:
            return run, future.result()
        if isinstance(error, KilledWorker) and run is not self._alone:
            self._suspects.append(run)
            return None
        reason = f"{type(error).__name__}: {error}"
        if isinstance(error, KilledWorker):
            reason = "ended the process of every worker that tried it"
        return run, failed(run, reason)


def _own_cluster(workers: int | None, scratch: str) -> LocalCluster:
    """Start worker processes on this machine, in a folder for files that Dask leaves behind.

    Raises:
        OSError: one of them did not start.
    """
    with dask.config.set(_UNWATCHED | {"temporary-directory": scratch}), _naming_workers():
        return LocalCluster(
            n_workers=workers or len(os.sched_getaffinity(0)),
            threads_per_worker=1,
            processes=True,
            security=Security.temporary(),  # else any user of this machine may run code on it
            memory_limit=0,
            dashboard_address=None,
            scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},  # any free port
            silence_logs=logging.CRITICAL,
            preload=[f"{__package__}.worker_start", __name__],  # no first run waits for imports
        )


@contextmanager
def _naming_workers() -> Iterator[None]:
    """Raise an `OSError` with the first cause of an error of Dask, which names its own parts."""
    try:
        yield
    except (OSError, RuntimeError) as error:
        cause: BaseException = error
        while cause.__cause__ or cause.__context__:
            cause = cause.__cause__ or cause.__context__ or cause
        needs = " (they need room in /dev/shm)" if isinstance(cause, OSError) else ""
        raise OSError(f"the study's worker processes did not start: {cause}{needs}") from error


class _ForwardingHandler(logging.Handler):
    """Logs a worker's messages through the command, whose terminal line may be half written."""

    def __init__(self, worker: Worker) -> None:
        super().__init__()
        self._worker = worker

    def emit(self, record: logging.LogRecord) -> None:
        self._worker.log_event(_COMPILES, record.getMessage())


def _say_that_they_compile(_event: object) -> None:
    compiled.say_that_it_compiles(compiled.logger.warning)


def dask_setup(worker: Worker) -> None:
    """Set up each of our own worker processes (called by Dask): Ctrl-C is for the command alone.

    The errors of a run are in its row, cause first; a log here would not show whose they are.
    """
    gc.freeze()  # modules last as long as the process
    gc.enable()
    restore_path()
    compiled.logger.addHandler(_ForwardingHandler(worker))
    compiled.logger.propagate = False
    logging.getLogger("plant_emulator").setLevel(logging.CRITICAL)
    for number in (signal.SIGINT, signal.SIGHUP):  # which a terminal sends to all processes
        signal.signal(number, signal.SIG_IGN)


def _connect(scheduler: str) -> Client:
    """Return a client of a scheduler whose workers can execute runs."""
    try:
        asyncio.run(asyncio.wait_for(_identity(scheduler), _ANSWER_S))
        client = Client(scheduler, timeout=_WORKERS_S, set_as_default=False, security=Security())
    except (OSError, ValueError, TypeError, RuntimeError) as error:  # the last two: of TLS
        reason = str(error) or f"no answer for {_ANSWER_S:g} s"
        raise ScenarioError(
            f"--scheduler {scheduler}: must be the address of a Dask scheduler that answers, such"
            f" as tcp://127.0.0.1:8786: {reason}"
        ) from error
    try:
        client.wait_for_workers(1, timeout=_WORKERS_S)
        client.submit(callable, row_of, pure=False).result(timeout=_FIRST_TASK_S)  # imports it
    except Exception as error:
        client.close()
        raise ScenarioError(
            f"--scheduler {scheduler}: has no worker that can run funnel-hil: {error}"
        ) from error
    return client


async def _identity(scheduler: str) -> None:
    """Ask the scheduler for its identity; cheaper to give up than a client."""
    arguments = Security().get_connection_args("client")  # certificates as Dask is configured
    async with rpc(scheduler, connection_args=arguments) as peer:
        await peer.identity()


def packed(laws: Iterable[str]) -> Packed:
    """Return the custom ones of these laws, packed.

    A law that cannot be packed is left out: workers import it if they have its file.
    """
    found = {name: _packed(find_law(name)) for name in laws if is_custom(name) and name != EXTERNAL}
    return {name: code for name, code in found.items() if code is not None}


def row_with(run: PlannedRun, laws: Packed) -> Row:
    """Return `row_of` a run, with the laws that were sent with it."""
    try:
        makers = {name: _unpacked(code) for name, code in laws.items()}
    except Exception as error:  # noqa: BLE001 - imports of a law may be missing
        return failed(run, f"{type(error).__name__}: {error}")
    with laws_given(makers):
        return row_of(run)


def _packed(make: Maker) -> bytes | None:
    """Pack a law with its whole module, unless that is a package that workers have as well."""
    module = sys.modules.get(make.__module__)
    by_value = module is not None and _is_of_the_user(module)
    if by_value:
        cloudpickle.register_pickle_by_value(module)
    try:
        code = io.BytesIO()
        _Packer(code).dump(make)
        return code.getvalue()
    except Exception:  # noqa: BLE001 - an object may refuse to be pickled in any way
        return None
    finally:
        if by_value:
            cloudpickle.unregister_pickle_by_value(module)


def _code_of_file(file: str, make: Callable[..., CodeType], parts: tuple[Any, ...]) -> CodeType:
    return make(*parts).replace(co_filename=file)


def _reduced(code: CodeType) -> tuple[Any, ...]:
    make, parts = cloudpickle.Pickler.dispatch_table[CodeType](code)
    return _code_of_file, (code.co_filename, make, parts)


class _Packer(cloudpickle.Pickler):  # type: ignore[misc]  # it has no types
    """Pickler of functions with the names of their files, which `cloudpickle` leaves out.

    So an error of a law reports its place in the user's file.
    """

    dispatch_table = cloudpickle.Pickler.dispatch_table.new_child({CodeType: _reduced})


def _is_of_the_user(module: ModuleType) -> bool:
    """Whether a module is a user's file, not installed."""
    file = getattr(module, "__file__", None)
    if module.__name__ == "__main__" or file is None:
        return False
    return is_of_the_user(str(Path(file).resolve()))


@lru_cache(maxsize=16)
def _unpacked(code: bytes) -> Maker:
    make: Maker = cloudpickle.loads(code)
    return make
