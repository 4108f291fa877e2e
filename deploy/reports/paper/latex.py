"""Tables of a result as LaTeX, each within a column or the width of an IEEE page."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from deploy.judge.conditions import conditions_line
from deploy.reports.page import Page
from deploy.reports.tables import ABSENT, Table

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
_COLUMN_PT, _PAGE_PT = 252.0, 516.0
"""Width of a column and of both, as in IEEE's journals."""
_GAP_PT, _TEXT_PT = 12.0, 150.0
"""Between two columns of a table; what a column of text, which can break, needs at least."""
_LETTERS_PT = {2.6: "ijl.,:;'|!()[]·", 3.4: " frtsI/-", 7.1: "mw%@×±→≤≥ΣΔ−…", 8.8: "MW"}
_CAPITAL_PT, _OTHER_PT = 6.7, 4.7
"""Width of letters of 8 pt in Computer Modern, which is wider than Times."""
_WIDTH_PT = {letter: width for width, letters in _LETTERS_PT.items() for letter in letters}
_MOST_COLUMNS, _MOST_ROWS = 6, 40
"""A larger table is split; so many rows fit on a page."""


def write_latex(page: Page[Any], file: Path, columns: int = 2) -> Path:
    """Write all tables of a page, for the package booktabs.

    Args:
        page: the page.
        file: the file to write.
        columns: of the paper that a table may be as wide as, 1 or 2.
    """
    width_pt = _PAGE_PT if columns > 1 else _COLUMN_PT
    conditions = " ".join(conditions_line(page.conditions).splitlines())
    head = f"% {page.name}\n% {conditions}\n"
    parts = [part for table in page.tables for part in narrow_parts(table, width_pt)]
    texts = [as_latex(*part, width_pt) for part in zip(parts, _labels(parts), strict=True)]
    file.write_text(head + "\n".join(texts), encoding="utf-8")
    return file


def _labels(tables: Sequence[Table]) -> Iterator[str]:
    """Yield the titles in small letters, digits and hyphens; a second one alike has a number."""
    seen = Counter[str]()
    for table in tables:
        name = "-".join(re.findall("[a-z0-9]+", table.title.lower()))
        seen[name] += 1
        yield f"tab:{name}" + f"-{seen[name]}" * (seen[name] > 1)


def narrow_parts(table: Table, width_pt: float = _PAGE_PT) -> Iterator[Table]:
    """Yield a table as parts with few columns and rows; each repeats the columns that name rows.

    Columns that only reports have, such as commands, and those where nothing is known are left
    out; so is a table without others. The title of a part says what is in it; the first part has
    the note.
    """
    table = _for_paper(table)
    heads = _naming_columns(table)
    groups = _column_groups(table, heads, width_pt)
    for group in groups:
        columns = [table.columns[index] for index in [*range(heads), *group]]
        named = ", ".join(column.brief_title for column in columns[heads:])
        title = f"{table.title}: {named}" if len(groups) > 1 else table.title
        for first in range(0, len(table.rows), _MOST_ROWS):
            rows = table.rows[first : first + _MOST_ROWS]
            place = f", rows {first + 1} to {first + len(rows)} of {len(table.rows)}"
            yield replace(
                table,
                title=title + place * (len(rows) < len(table.rows)),
                columns=columns,
                rows=[[row[index] for index in [*range(heads), *group]] for row in rows],
                note=table.note if group is groups[0] and not first else "",
            )


def _for_paper(table: Table) -> Table:
    """Return a table with the columns that a terminal has too, and in which something is known."""
    known = [any(row[n].text != ABSENT for row in table.cells) for n in range(len(table.columns))]
    kept = [n for n, column in enumerate(table.columns) if known[n] and column.brief is not None]
    rows = [[row[n] for n in kept] for row in table.rows]
    return replace(table, columns=[table.columns[n] for n in kept], rows=rows)


def _naming_columns(table: Table) -> int:
    """Return how many columns, from the first on, it takes to tell rows apart; all text or none."""
    texts = [[cell.text for cell in row] for row in table.cells]
    for count, column in enumerate(table.columns[: _MOST_COLUMNS - 1]):
        is_distinct = len({tuple(row[:count]) for row in texts}) == len(texts)
        if count and (is_distinct or column.is_text != table.columns[0].is_text):
            return count
    return 1


def _column_groups(table: Table, heads: int, width_pt: float) -> list[list[int]]:
    """Return the other columns by the parts of a table: as many as there is room for."""
    widths = _widths_pt(table)
    groups = list[list[int]]()
    room = 0.0
    for index in range(heads, len(widths)):
        needed = min(widths[index], _TEXT_PT if table.columns[index].is_text else width_pt)
        if not groups or len(groups[-1]) == _MOST_COLUMNS - heads or needed > room:
            groups.append([])
            room = width_pt - sum(widths[:heads])
        groups[-1].append(index)
        room -= needed
    return groups


def as_latex(table: Table, label: str, width_pt: float = _PAGE_PT) -> str:
    """Return a table with rules of booktabs, numbers to the right; its note is a comment.

    Args:
        table: one that fits on a page.
        label: to refer to it by.
        width_pt: its largest width.
    """
    heads = [column.brief_title for column in table.columns]
    lines = [heads, *([cell.text for cell in row] for row in table.cells)]
    widths = _widths_pt(table)
    kind = "table*" if min(sum(widths), width_pt) > _COLUMN_PT else "table"
    longest = _longest_pt(widths, width_pt)
    breaks = [width > longest for width in widths]
    sides = "".join(
        f"p{{{longest - _GAP_PT:.0f}pt}}" if broken else "l" if column.is_text else "r"
        for column, broken in zip(table.columns, breaks, strict=True)
    )
    end = r" \tabularnewline" if any(breaks) else r" \\"
    body = [" & ".join(map(_cell, line, breaks)) + end for line in lines]
    note = [f"% {line}" for line in table.note.splitlines()]
    begin = [rf"\begin{{{kind}}}", r"\centering", rf"\caption{{{latex_text(table.title)}}}",
             rf"\label{{{label}}}", r"\footnotesize", rf"\begin{{tabular}}{{{sides}}}"]  # fmt: skip
    rules = [r"\toprule", body[0], r"\midrule", *body[1:], r"\bottomrule"]
    return "\n".join([*note, *begin, *rules, r"\end{tabular}", rf"\end{{{kind}}}", ""])


def _cell(text: str, is_broken: bool) -> str:
    """Return a cell; in a column of a fixed width its words go on below, names after a _ or a /."""
    if not is_broken:
        return latex_text(text)
    words = latex_text(text).replace(r"\_", r"\_\allowbreak ").replace("/", r"/\allowbreak ")
    return rf"\raggedright {words}"


def _widths_pt(table: Table) -> list[float]:
    """Return how wide the columns of a table are, each with its gap."""
    texts = [[column.brief_title, *(row[index].text for row in table.cells)]
             for index, column in enumerate(table.columns)]  # fmt: skip
    return [_GAP_PT + max(map(_width_pt, column)) for column in texts]


def _width_pt(text: str) -> float:
    return sum(
        _WIDTH_PT.get(letter, _CAPITAL_PT if letter.isupper() else _OTHER_PT) for letter in text
    )


def _longest_pt(widths: Sequence[float], width_pt: float) -> float:
    """Return the width to which the widest columns must be cut to fit into a width."""
    room = width_pt
    for place, width in enumerate(sorted(widths)):
        if width > (share := room / (len(widths) - place)):
            return share
        room -= width
    return width_pt


def latex_text(text: str) -> str:
    """Return a text in which no letter is a command of LaTeX."""
    return "".join(_ESCAPES.get(letter, letter) for letter in text)
