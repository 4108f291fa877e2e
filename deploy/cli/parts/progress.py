"""Progress of a command: a live line on a terminal, a plain line every 3 s elsewhere."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

from rich.cells import cell_len
from rich.progress import BarColumn, Progress, TextColumn
from rich.table import Column
from rich.text import Text

from deploy.run.console import Console

_POLL_S = 0.1
_PLAIN_LINE_S = 3.0
_BAR_WIDTH = 12
_LEAST_DONE, _STEADY = 0.1, 0.2
"""The time left is shown from this share on, while recent and mean speed differ by less."""
_LEAST_RUNS, _LONGER = 8, 1.2
"""With a largest total, the time left is shown from this number on. It counts down, until the
mean cost of all runs gives a shorter time, or one that is longer by this factor."""
_WHOLE = Column(no_wrap=True, overflow="ellipsis")


class CommandProgress:
    """Progress of a command.

    Args:
        console: where it is shown.
        name: what is being done.
        total: how much there is to do.
        unit: of that, such as ``s`` of simulated time, or ``runs``.
    """

    def __init__(self, console: Console, name: str, total: float, unit: str) -> None:
        self._console, self._unit, self._note = console, unit, ""
        self._total, self._done, self._done_before = total, 0.0, 0.0
        self._share, self._is_largest = 0.0, False
        self._end_s = math.inf
        self._is_brief = False
        self._bar = Progress(
            TextColumn("{task.description}", style="bold", markup=False, table_column=_WHOLE),
            BarColumn(bar_width=_BAR_WIDTH),
            TextColumn("{task.fields[line]}", markup=False, table_column=_WHOLE),
            console=console, transient=True, disable=not console.is_terminal,
        )  # fmt: skip
        self._task = self._bar.add_task(name, total=1.0, line="starting")
        self._started_s = self._printed_s = time.monotonic()
        self._marks = [(self._started_s, 0.0)]
        self._is_printed, self._printed_done = True, -1.0
        self._position: Callable[[], float] | None = None
        self._over = threading.Event()
        self._follower = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> CommandProgress:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        if self._position is not None:
            self._follower.join()
            self.update(self._position())
        self._bar.stop()
        if not self._is_printed:
            self._print_plainly()

    def update(self, done: float, *, total: float | None = None, note: str | None = None) -> None:
        """Show how much is done.

        Args:
            done: how much in all.
            total: the largest total that is still possible; as before by default. The total that
                is shown never rises.
            note: what else there is to say; as before by default.
        """
        self._done = done
        if done - self._done_before > self._marks[-1][1]:
            self._marks.append((time.monotonic(), done - self._done_before))
        if total is not None and total != self._total:
            self._total, self._is_largest = max(done, min(total, self._total)), True
        if self._is_largest:
            self._foresee_end()
        self._share = max(self._share, done / self._total if self._total > 0.0 else 0.0)
        self._note = self._note if note is None else note
        self._bar.update(self._task, completed=self._share, line=self._fitting_line())
        self._is_printed = False
        is_time = time.monotonic() - self._printed_s >= _PLAIN_LINE_S
        if is_time and done != self._printed_done:  # the start is printed once
            self._print_plainly()

    def skip_to(self, done: float) -> None:
        """Leave earlier work out of the speed, and start to measure it now."""
        if self._done <= self._done_before:
            self._started_s = time.monotonic()
            self._marks = [(self._started_s, 0.0)]
        self._done_before = done

    def follow(self, position: Callable[[], float], name: str) -> None:
        """Poll the position until the end, or until the next call of this method."""
        is_first, self._position = self._position is None, position
        self._bar.update(self._task, description=name)
        if is_first:
            self._follower.start()

    def say(self, text: str) -> None:
        """Print a line that stays."""
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)

    def _watch(self) -> None:
        while not self._over.wait(_POLL_S):
            if self._position is not None:
                self.update(self._position())

    def _print_plainly(self) -> None:
        self._printed_s, self._is_printed = time.monotonic(), True
        self._printed_done = self._done
        if not self._console.is_terminal:
            self.say(self._line())

    def _fitting_line(self) -> str:
        """Return the line beside name and bar. If it has no room, it replaces both, for good.

        Parts that come and go could not be read. A line that is still too long loses its end.
        """
        name = self._bar.tasks[self._task].description
        line, room = self._line(), self._console.width
        if cell_len(f"{name}  {line}") + _BAR_WIDTH > room:
            self._is_brief = True
        if self._is_brief:
            line, self._bar.columns = self._line(time_left=False), self._bar.columns[-1:]
        text = Text(line)
        text.truncate(room, overflow="ellipsis")
        return text.plain

    def _line(self, *, time_left: bool = True) -> str:
        elapsed_s = max(time.monotonic() - self._started_s, 1e-9)
        speed = (self._done - self._done_before) / elapsed_s
        total = f"at most {self._total:g}" if self._is_largest else f"{self._total:g}"
        line = f"{round(self._done, 2):g} of {total} {self._unit}"
        if speed > 0.0:
            is_time = self._unit == "s"  # simulated seconds per second: the real-time factor
            line += f", speed {speed:.3g}" if is_time else f", {speed:.3g} {self._unit}/s"
            if time_left and self._done < self._total:
                line += self._time_left(speed)
        return f"{line}, {self._note}" if self._note else line

    def _time_left(self, speed: float) -> str:
        if self._is_largest:
            left_s = self._end_s - time.monotonic()
            return f", at most {left_s:.0f} s left" if 0.0 < left_s < math.inf else ""
        recent = self._recent_speed()
        is_steady = recent and abs(recent - speed) < _STEADY * speed
        return f", {(self._total - self._done) / recent:.0f} s left" if is_steady else ""

    def _foresee_end(self) -> None:
        """Foresee the end from the mean cost of a run so far; a little later changes nothing.

        The first run also starts the workers, and counts for nothing.
        """
        own, now_s = self._done - self._done_before, time.monotonic()
        if own < min(_LEAST_RUNS, self._total - self._done_before):
            return
        first_s, first = self._marks[min(1, len(self._marks) - 1)]
        if own <= first:
            return
        left_s = (self._total - self._done) * (now_s - first_s) / (own - first)
        if not self._end_s - now_s <= left_s <= _LONGER * (self._end_s - now_s):
            self._end_s = now_s + left_s

    def _recent_speed(self) -> float:
        """Return the speed over the last half of what is done; 0 while too little is done.

        The first runs of a study may be much shorter, or longer, than those that follow.
        """
        own = self._done - self._done_before
        if own < _LEAST_DONE * (self._total - self._done_before):
            return 0.0
        at_s, then = next(mark for mark in reversed(self._marks) if mark[1] <= 0.5 * own)
        return (own - then) / max(time.monotonic() - at_s, 1e-9)
