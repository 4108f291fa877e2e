"""One session of work on a study: find or create its folder, do the runs that it lacks."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from deploy.run.first_answer import require_answers
from deploy.study.execution.folder import StudyFolder, find_folder, opened, require_same_provenance
from deploy.study.execution.runner import Progress, Workers, WorkersLostError, carry_out
from deploy.study.study import StudyOfRuns


@dataclass
class Session:
    """Outcome of the runs of a study.

    Attributes:
        folder: folder of the rows.
        is_interrupted: the user stopped them.
        lost: why the workers are gone, if they are.
    """

    folder: StudyFolder
    is_interrupted: bool = False
    lost: WorkersLostError | None = None


@contextmanager
def open_session(
    study: StudyOfRuns,
    team: Callable[[], AbstractContextManager[Workers]],
    out: Path | None,
    on_row: AbstractContextManager[Progress],
    *,
    overwrite: bool = False,
    is_elsewhere: bool = False,
    stop: threading.Event | None = None,
) -> Iterator[Session]:
    """Do the runs that the folder of a study lacks; the folder is locked within the context.

    Args:
        study: the study.
        team: starts the workers.
        out: the folder; by default as for `find_folder` and `create_folder`.
        on_row: entered during the runs; its function is called with every row.
        overwrite: replace the results in the folder.
        is_elsewhere: the workers are on other hosts, with versions and files of their own.
        stop: set to end early, with all finished rows kept.

    Raises:
        ScenarioError: the folder holds another study, or rows made with other code or files; or a
            law answers with another shape than its scenario needs.
    """
    if not is_elsewhere:
        require_answers(study.variants)
    stop = threading.Event() if stop is None else stop
    path = None if overwrite else find_folder(study, out)
    with ExitStack() as open_:
        if not is_elsewhere:  # a folder is refused before any process starts
            require_same_provenance(study, path)
            folder = open_.enter_context(opened(study, path, out, overwrite=overwrite))
        workers = open_.enter_context(team())
        if is_elsewhere:
            require_same_provenance(study, path, workers.current)
            folder = open_.enter_context(opened(study, path, out, overwrite=overwrite))
        done = Session(folder)
        with on_row as progress:
            try:
                carry_out(study, workers, folder, stop, progress)
            except WorkersLostError as error:
                done.lost = error
        done.is_interrupted = stop.is_set() and done.lost is None
        yield done
