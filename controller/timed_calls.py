"""Calls of other people's code that may never return."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable
from concurrent.futures import Future
from queue import SimpleQueue
from typing import Generic, TypeVar

T = TypeVar("T")


class CallThread(Generic[T]):
    """Calls functions in a thread of its own.

    All calls come from one thread, as some libraries ask for that. It ends with this object, or is
    left behind if a function never returns; the exit of the process does not wait for it.
    """

    def __init__(self) -> None:
        self._calls: SimpleQueue[tuple[Callable[[], T], Future[T]] | None] = SimpleQueue()
        self._thread: threading.Thread | None = None

    def start(self, function: Callable[[], T]) -> Future[T]:
        """Have the thread call a function after those before it; return its future result."""
        if self._thread is None:
            self._thread = threading.Thread(target=_serve, args=(self._calls,), daemon=True)
            self._thread.start()
            weakref.finalize(self, self._calls.put, None)
        future = Future[T]()
        self._calls.put((function, future))
        return future

    def wait(self, function: Callable[[], T], timeout_s: float) -> T:
        """Return what a function returns.

        Args:
            function: what to call.
            timeout_s: longest time, wall time.

        Raises:
            TimeoutError: it did not return in time.
            BaseException: as the function raises.
        """
        future = self.start(function)
        try:
            return future.result(timeout_s)
        except TimeoutError:
            if future.done():  # the function's own
                raise
            raise TimeoutError(f"no answer within {timeout_s:g} s") from None


def _serve(calls: SimpleQueue[tuple[Callable[[], T], Future[T]] | None]) -> None:
    while (call := calls.get()) is not None:
        function, future = call
        try:
            future.set_result(function())
        except BaseException as error:  # noqa: BLE001 (it is raised where the caller waits)
            future.set_exception(error)
        del call, function, future  # or they would live until the next call
