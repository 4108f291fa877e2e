"""Calls of other people's code that may never return."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Generic, TypeVar

T = TypeVar("T")


class TimedCalls(Generic[T]):
    """Calls a function in a thread of its own, and waits for it no longer than a given time.

    All calls come from one thread, as some libraries ask for that. It ends with this object, or is
    left behind if the function never returns.

    Args:
        timeout_s: longest time of a call, wall time.
    """

    def __init__(self, timeout_s: float) -> None:
        self._timeout_s = timeout_s
        self._calls: SimpleQueue[Callable[[], T] | None] = SimpleQueue()
        self._results: SimpleQueue[tuple[T | None, BaseException | None]] = SimpleQueue()
        self._thread: threading.Thread | None = None

    def __call__(self, function: Callable[[], T]) -> T:
        """Return what the function returns.

        Raises:
            TimeoutError: it did not return in time.
            BaseException: as the function raises.
        """
        if self._thread is None:
            self._thread = threading.Thread(
                target=_serve, args=(self._calls, self._results), daemon=True
            )
            self._thread.start()
            weakref.finalize(self, self._calls.put, None)
        self._calls.put(function)
        try:
            result, error = self._results.get(timeout=self._timeout_s)
        except Empty:
            raise TimeoutError(f"no answer within {self._timeout_s:g} s") from None
        if error is not None:
            raise error
        return result  # type: ignore[return-value]  # of a function that raised nothing


def _serve(
    calls: SimpleQueue[Callable[[], T] | None],
    results: SimpleQueue[tuple[T | None, BaseException | None]],
) -> None:
    while (function := calls.get()) is not None:
        try:
            results.put((function(), None))
        except BaseException as error:  # noqa: BLE001 (it is raised where the caller waits)
            results.put((None, error))
        del function
