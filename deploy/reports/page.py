"""Pages of results: tables, verdict, conditions and figures, listed once.

`terminal.print_page` and `html.write_page` render them. The figures are imported only for HTML.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Generic, Literal, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from bus_schema.arrays import Vector
from deploy.reports.tables import Table

if TYPE_CHECKING:
    import plotly.graph_objects as go

T = TypeVar("T")
"""Subject of a report: a run, or several."""


class Fact(NamedTuple):
    """A labelled value at the top of a report; `hint` says more of it."""

    label: str
    value: str
    hint: str = ""


@dataclass(frozen=True)
class Picture:
    """A picture of the arm at a time of a run."""

    time_s: float
    png: bytes

    @property
    def source(self) -> str:
        return f"data:image/png;base64,{base64.b64encode(self.png).decode()}"


@dataclass(frozen=True)
class Motion:
    """A figure in space whose first traces move along a run.

    Attributes:
        figure: as it is at the first of the times.
        times_s: rising, shape (frames,).
        points: of each trace at each time, shape (frames, traces, points, 3), m.
    """

    figure: go.Figure
    times_s: Vector
    points: NDArray[np.float64]

    def frames(self) -> dict[str, Any]:
        """Times and points for the page, ready for JSON."""
        _, traces, points, _ = self.points.shape
        arrays = {"times": typed_array(self.times_s), "points": typed_array(self.points.ravel())}
        return {"traces": traces, "points_of_each": points, **arrays}


Content: TypeAlias = "go.Figure | Sequence[Picture] | Motion | Table"


@dataclass(frozen=True)
class Panel(Generic[T]):
    """A figure of a report.

    Attributes:
        section: title of the section that it stands in.
        id: of its HTML element, and the only one of this name in a page.
        title: of the figure.
        draw: gives the figure, pictures, a motion or a table; None where there is nothing to draw.
        caption: what to look for in it.
        is_clickable: whether its points carry, as `customdata`, a text to be shown on a click.
        is_over_time: whether its horizontal axis is the time of a run, on which the page shows the
            instant that is looked at.
        is_drawn_beside: whether `draw` begins what another process does, and gives a function that
            waits for that and does the rest once the other panels are drawn.
        is_folded: whether its section stands among what a page has folded.
        notes: further sentences of the caption, by the name of the line or shade that they explain.
    """

    section: str
    id: str
    title: str
    draw: Callable[[T], Content | Callable[[], Content] | None]
    caption: str
    is_clickable: bool = False
    is_over_time: bool = False
    is_drawn_beside: bool = False
    is_folded: bool = False
    notes: Mapping[str, str] = field(default_factory=dict)

    def caption_of(self, content: Any) -> str:
        """Return the caption of what was drawn, without a word on what is not there."""
        shapes = getattr(content, "layout", {"shapes": ()})["shapes"]
        names = {each.name for each in (*getattr(content, "data", ()), *shapes)}
        explained = [note for name, note in self.notes.items() if name in names]
        return " ".join([self.caption, *explained])


class Cards(NamedTuple):
    """Tables beside each other: ``three`` narrow ones, or ``stacked`` over all of the width."""

    tables: Sequence[Table]
    layout: str = ""


@dataclass(frozen=True)
class Page(Generic[T]):
    """Results as a terminal and an HTML file show them.

    Every report has the same order: headline, first section of figures, reasons, tables, other
    figures, and folded what is only read where something is odd.

    Attributes:
        kind: kind of the results.
        name: of the results, which begins the title.
        verdict: headline and reasons.
        facts: labelled values beside the conditions, in HTML only.
        panels: returns the figures in order; it imports what draws them. Those of the first
            section answer the question of the page.
        subject: argument of the panels' `draw`.
        conditions: conditions of the results.
        heading: first line in a terminal.
        results: tables.
        folded: title and tables that a report has folded.
        lines: sentences that only a terminal shows, below its tables and verdict.
        points: description, file and command of points of a study that can be run again.
        points_title: title of these points.
        points_note: what a reader must know to run one.
        end_s: end of the runs whose figures over time share an instant; None without a run.
        footer: what a reader may look for next.
        footer_code: the name or number that ends the footer.
        shares_library: whether other reports use the library of the figures, too.
        quoted: returns the table for documents; None for none.
    """

    kind: str
    name: str
    verdict: ReportHead
    facts: Sequence[Fact]
    panels: Callable[[], Iterable[Panel[T]]]
    subject: T
    conditions: Mapping[str, str] = field(default_factory=dict)
    heading: str = ""
    results: Sequence[Cards] = ()
    folded: tuple[str, Sequence[Cards]] = ("Timing", ())
    lines: Sequence[str] = ()
    points: Sequence[tuple[str, str, str]] = ()
    points_title: str = "Every point, with the command that repeats it"
    points_note: str = ""
    end_s: float | None = None
    footer: str = ""
    footer_code: str = ""
    shares_library: bool = False
    quoted: Callable[[], Table] | None = None

    @property
    def tables(self) -> list[Table]:
        """All tables in order."""
        return [*self.open_tables, *_tables(self.folded[1])]

    @property
    def open_tables(self) -> list[Table]:
        """All tables that are not folded, in order."""
        return _tables(self.results)


def _tables(groups: Iterable[Cards]) -> list[Table]:
    return [table for cards in groups for table in cards.tables]


Level = Literal["good", "bad", "mixed", "broken"]


@dataclass(frozen=True)
class ReportHead:
    """The top of a report.

    Attributes:
        level: ``good``, ``bad`` (bounds not kept), ``mixed`` (kept by some laws only) or ``broken``
            (no run to judge as a whole).
        headline: the verdict.
        reasons: what it rests on, a sentence each.
        faults: what went wrong, causes before what followed from them.
        printed: the reasons that a terminal shows, where its tables hold the others; None for all.
    """

    level: Level
    headline: str
    reasons: Sequence[str]
    faults: Sequence[str] = ()
    printed: Sequence[str] | None = None


def level_of(kept: int, total: int) -> Level:
    """The level of so many runs or points that kept their bounds."""
    return "good" if kept == total else "mixed" if kept else "bad"


def typed_array(values: NDArray[Any]) -> dict[str, str]:
    """Return numbers as plotly.js has them in one dimension, with the seven digits that show."""
    with np.errstate(over="ignore"):  # of a run that diverged: what is too large is not drawn
        data = np.ascontiguousarray(values, dtype="<f4").tobytes()
    return {"dtype": "f4", "bdata": base64.b64encode(data).decode()}
