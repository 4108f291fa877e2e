"""Files of a result for a paper: figures, tables as LaTeX, and a citation with its digest."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from bus_schema.errors import InputError, needs_extra
from deploy.judge.conditions import conditions_line
from deploy.reports.page import Page
from deploy.reports.results import Results
from deploy.reports.tables import ABSENT, Column, Table

FORMATS = ("pdf", "svg")
_ESCAPES = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "×": r"$\times$", "−": "$-$", "–": "--", "…": r"\dots{}",
    "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}",
    "Σ": r"$\Sigma$", "Δ": r"$\Delta$",
    "τ": r"$\tau$", "µ": r"$\mu$", "≤": r"$\leq$", "≥": r"$\geq$", "°": r"$^\circ$",
    "α": r"$\alpha$", "ε": r"$\varepsilon$",
    "→": r"$\rightarrow$", "∫": r"$\int$", "√": r"$\surd$", "′": r"$'$", "·": r"$\cdot$",
    "⁻": "$^{-}$", "±": r"$\pm$",
    **{raised: f"$^{{{digit}}}$" for digit, raised in enumerate("⁰¹²³⁴⁵⁶⁷⁸⁹")},
}  # fmt: skip
_LETTERS_OF_A_COLUMN = 58
"""Of 8 pt in 88 mm; a wider table stands over both columns of a page."""
_MOST_COLUMNS, _MOST_ROWS_OF_A_FLOAT = 6, 40
"""A wider table is split; a longer one may break over pages, which needs a page of one column."""


def write_figures(
    page: Page[Any], folder: Path, formats: Sequence[str], columns: int
) -> Iterator[Path]:
    """Write every figure of a page that is in the plane; yield the files.

    Raises:
        InputError: Matplotlib is not installed.
    """
    try:
        from deploy.reports.paper.paper_figures import can_be_drawn, write_figure  # an extra
    except ImportError as error:
        raise InputError(f"--figures: {needs_extra('matplotlib', 'papers')}") from error
    for panel in page.panels():
        drawn: Any = panel.draw(page.subject)
        figure = drawn() if callable(drawn) else drawn
        if not can_be_drawn(figure):
            continue
        for each in formats:
            file = folder / f"{panel.id}.{each}"
            write_figure(figure, file, columns)
            yield file


def write_latex(page: Page[Any], file: Path) -> Path:
    """Write all tables of a page, for the packages booktabs and, if long, longtable."""
    conditions = " ".join(conditions_line(page.conditions).splitlines())
    head = f"% {page.name}\n% {conditions}\n"
    parts = [as_latex(part) for table in page.tables for part in narrow_parts(table)]
    file.write_text(head + "\n".join(parts), encoding="utf-8")
    return file


def narrow_parts(table: Table) -> Iterator[Table]:
    """Yield a table as parts with few columns; each repeats the first ones, which name rows.

    Columns that only reports have, such as commands, and those where nothing is known are left
    out. The first part has the note.
    """
    table = _for_paper(table)
    heads = _naming_columns(table)
    step = _MOST_COLUMNS - heads
    for first in range(heads, max(heads + 1, len(table.columns)), step):
        chosen = [*range(heads), *range(first, first + step)]
        columns = [table.columns[index] for index in chosen if index < len(table.columns)]
        rows = [[row[index] for index in chosen if index < len(row)] for row in table.rows]
        note = table.note if first == heads else ""
        yield replace(table, columns=columns, rows=rows, note=note)


def _for_paper(table: Table) -> Table:
    """Return a table with the columns that a terminal has too, and in which something is known."""
    known = [any(row[n].text != ABSENT for row in table.cells) for n in range(len(table.columns))]
    kept = [n for n, column in enumerate(table.columns) if known[n] and column.brief is not None]
    kept = kept if table.rows else [*range(len(table.columns))]
    rows = [[row[n] for n in kept] for row in table.rows]
    return replace(table, columns=[table.columns[n] for n in kept], rows=rows)


def _naming_columns(table: Table) -> int:
    """Return how many columns of text, from the first on, it takes to tell rows apart."""
    texts = [[cell.text for cell in row] for row in table.cells]
    for count, column in enumerate(table.columns[: _MOST_COLUMNS - 1]):
        is_distinct = len({tuple(row[:count]) for row in texts}) == len(texts)
        if count and (is_distinct or not column.is_text):
            return count
    return 1


def as_latex(table: Table) -> str:
    """Return a table with rules of booktabs, numbers to the right; its note is a comment."""
    sides = "".join("l" if column.is_text else "r" for column in table.columns)
    heads = [_heading(column) for column in table.columns]
    lines = [heads, *([cell.text for cell in row] for row in table.cells)]
    body = [" & ".join(map(latex_text, line)) + r" \\" for line in lines]
    note = [f"% {line}" for line in table.note.splitlines()]
    caption = rf"\caption{{{latex_text(table.title)}}}"
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    kind = "table*" if sum(widths) + 2 * len(widths) > _LETTERS_OF_A_COLUMN else "table"
    if len(table.rows) > _MOST_ROWS_OF_A_FLOAT:
        begin = [rf"\begin{{longtable}}{{{sides}}}", rf"{caption} \\"]
        head, end = [r"\endhead"], [r"\end{longtable}"]
    else:
        begin = [rf"\begin{{{kind}}}", r"\centering", caption, r"\footnotesize",
                 rf"\begin{{tabular}}{{{sides}}}"]  # fmt: skip
        head, end = [], [r"\end{tabular}", rf"\end{{{kind}}}"]
    rules = [r"\toprule", body[0], r"\midrule", *head, *body[1:], r"\bottomrule"]
    return "\n".join([*note, *begin, *rules, *end, ""])


def _heading(column: Column) -> str:
    """Return the short heading of a column, where it has one, with its unit."""
    broken = (column.brief or column.heading).replace("-\n", "").replace(".\n", ".")
    brief = " ".join(broken.split())
    return f"{brief} ({column.unit})" if column.unit else brief


def latex_text(text: str) -> str:
    """Return a text in which no letter is a command of LaTeX."""
    return "".join(_ESCAPES.get(letter, letter) for letter in text)


def write_bibtex(results: Results, page: Page[Any], file: Path) -> Path:
    """Write a citation: the version that made the results, their year, and their digest."""
    digest = digest_of_results(results)
    entry = {
        "title": "{funnel-hil}: a hardware-in-the-loop test bench for prescribed-performance and"
        " fixed-time robot control",
        "author": "{the funnel-hil authors}",
        "version": page.conditions.get("version", "").removeprefix("funnel-hil "),
        "year": page.conditions.get("date", "")[:4],
        "note": latex_text(f"results of {page.name}, digest {digest}"),
    }
    fields = ",\n".join(f"  {key} = {{{value}}}" for key, value in entry.items() if value)
    file.write_text(f"@software{{funnel_hil_{digest[:8]},\n{fields}\n}}\n", encoding="utf-8")
    return file


def digest_of_results(results: Results) -> str:
    """Return the digest of a run, or one of the summary of a study without date and host."""
    own = results.summary.get("digest")
    if isinstance(own, str):
        return own[:16]
    kept = json.loads(json.dumps(results.summary), object_hook=_without_conditions)
    return hashlib.sha256(json.dumps(kept, sort_keys=True).encode()).hexdigest()[:16]


def _without_conditions(part: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in part.items() if key != "conditions"}
