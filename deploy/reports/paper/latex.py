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
from deploy.reports.tables import ABSENT, NO_BREAK, SOFT_HYPHEN, Table, of_columns, without_shared

_ESCAPES = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "×": r"$\times$", "−": "$-$", "–": "--", "…": r"\dots{}",
    "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}",
    "Σ": r"$\Sigma$", "Δ": r"$\Delta$",
    "τ": r"$\tau$", "µ": r"$\mu$", "≤": r"$\leq$", "≥": r"$\geq$", "°": r"$^\circ$",
    "α": r"$\alpha$", "ε": r"$\varepsilon$",
    "→": r"$\rightarrow$", "∫": r"$\int$", "√": r"$\surd$", "′": r"$'$", "·": r"$\cdot$",
    "⁻": "$^{-}$", "±": r"$\pm$", NO_BREAK: "~",
    **{raised: f"$^{{{digit}}}$" for digit, raised in enumerate("⁰¹²³⁴⁵⁶⁷⁸⁹")},
}  # fmt: skip
_COLUMN_PT, _PAGE_PT = 252.0, 516.0
"""Width of a column and of both, as in IEEE's journals."""
_GAP_PT, _TEXT_SHARE = 8.0, 0.3
"""Between two columns of a table; share of the width that a text, which can break, is left."""
_WORDS, _PIECES = re.compile(r"\S+"), re.compile(r"[^\s_/]*[_/]+|[^\s_/]+")
"""Parts of a text after which a line can end; names have several."""
_SYLLABLES = re.compile(f"[^ {SOFT_HYPHEN}]+{SOFT_HYPHEN}?")
_LETTERS_PT = {2.6: "ijl.,:;'|!()[]·", 3.4: " frtsI/-", 7.1: "mw%@×±→≤≥ΣΔ−…", 8.8: "MW"}
_CAPITAL_PT, _OTHER_PT = 6.7, 4.7
"""Width of letters of 8 pt in Computer Modern, which is wider than Times."""
_WIDTH_PT = {letter: width for width, letters in _LETTERS_PT.items() for letter in letters}
_ROUNDING_PT = 1e-6
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
    out; so is a table without others. What all rows of a split table share is in the title, as is
    what a part has; the first part has the note.
    """
    table = _for_paper(table)
    groups = _column_groups(table, width_pt)
    if len(groups) > 1 and (fewer := without_shared(table)):
        table, groups = fewer, _column_groups(fewer, width_pt)
    heads = _naming_columns(table)
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
    return of_columns(table, kept)


def _naming_columns(table: Table) -> int:
    """Return how many columns, from the first on, it takes to tell rows apart; all text or none."""
    texts = [[cell.text for cell in row] for row in table.cells]
    for count, column in enumerate(table.columns[: _MOST_COLUMNS - 1]):
        is_distinct = len({tuple(row[:count]) for row in texts}) == len(texts)
        if count and (is_distinct or column.is_text != table.columns[0].is_text):
            return count
    return 1


def _column_groups(table: Table, width_pt: float) -> list[list[int]]:
    """Return the other columns by the parts of a table: few parts, of about as many columns."""
    heads = _naming_columns(table)
    tried = (
        _grouped(widths, heads, width_pt, most)
        for widths in _layouts(table, width_pt)
        for most in range(1, _MOST_COLUMNS - heads + 1)
    )
    return min(tried, key=len)


def _grouped(widths: Sequence[float], heads: int, width_pt: float, most: int) -> list[list[int]]:
    groups = list[list[int]]()
    room = 0.0
    for index in range(heads, len(widths)):
        if not groups or len(groups[-1]) == most or widths[index] > room:
            groups.append([])
            room = width_pt - sum(widths[:heads])
        groups[-1].append(index)
        room -= widths[index]
    return groups


def as_latex(table: Table, label: str, width_pt: float = _PAGE_PT) -> str:
    """Return a table with rules of booktabs, numbers to the right; its note is a comment.

    Args:
        table: one that fits on a page.
        label: to refer to it by.
        width_pt: its largest width.
    """
    whole = sum(_layouts(table, width_pt)[0])
    kind = "table*" if min(whole, width_pt) > _COLUMN_PT else "table"
    widths = _fitting(table, width_pt)
    breaks = [
        _GAP_PT + widest > width for widest, width in zip(_widest_pt(table), widths, strict=True)
    ]
    sides = ["l" if column.is_text else "r" for column in table.columns]
    kinds = "".join(
        f"p{{{width - _GAP_PT:.0f}pt}}" if broken else side
        for width, broken, side in zip(widths, breaks, sides, strict=True)
    )
    heads = [column.breakable_title for column in table.columns]
    headings = [_heading(*each) for each in zip(heads, widths, sides, strict=True)]
    end = r" \tabularnewline" if any(breaks) else r" \\"
    rows = ([_cell(*each) for each in zip((c.text for c in row), breaks, strict=True)]
            for row in table.cells)  # fmt: skip
    body = [" & ".join(line) + end for line in [headings, *rows]]
    note = [f"% {line}" for line in table.note.splitlines()]
    begin = [rf"\begin{{{kind}}}", r"\centering", rf"\caption{{{latex_text(table.title)}}}",
             rf"\label{{{label}}}", rf"\footnotesize\setlength\tabcolsep{{{_GAP_PT / 2:g}pt}}",
             rf"\begin{{tabular}}{{{kinds}}}"]  # fmt: skip
    rules = [r"\toprule", body[0], r"\midrule", *body[1:], r"\bottomrule"]
    return "\n".join([*note, *begin, *rules, r"\end{tabular}", rf"\end{{{kind}}}", ""])


def _cell(text: str, is_broken: bool) -> str:
    """Return a cell; in a column of a fixed width its words go on below, names after a _ or a /."""
    if not is_broken:
        return latex_text(text)
    words = latex_text(text).replace(r"\_", r"\_\allowbreak ").replace("/", r"/\allowbreak ")
    return rf"\raggedright {words}"


def _heading(text: str, width_pt: float, side: str) -> str:
    """Return a heading, on several lines where it is wider than its column."""
    lines = [""]
    for word in _SYLLABLES.findall(text):
        is_inside = lines[-1].endswith(SOFT_HYPHEN)
        longer = (lines[-1].rstrip(SOFT_HYPHEN) + (word if is_inside else f" {word}")).strip()
        if lines[-1] and _width_pt(longer) > width_pt - _GAP_PT + _ROUNDING_PT:
            lines.append(word)
        else:
            lines[-1] = longer
    shown = r"\\".join(latex_text(line.replace(SOFT_HYPHEN, "-")) for line in lines)
    stack = rf"\begin{{tabular}}[b]{{@{{}}{side}@{{}}}}{shown}\end{{tabular}}"
    return stack if len(lines) > 1 else shown


def _fitting(table: Table, width_pt: float) -> list[float]:
    """Return the widths of a table's columns: first headings break, then texts, then names."""
    whole, stacked, broken, least = _layouts(table, width_pt)
    for widths in (whole, stacked):
        if sum(widths) <= width_pt:
            return widths
    texts = [low if column.is_text else high
             for column, low, high in zip(table.columns, broken, whole, strict=True)]  # fmt: skip
    if sum(texts) <= width_pt:
        return _cut(whole, texts, width_pt)
    return _cut(_cut(stacked, broken, width_pt), least, width_pt)


def _layouts(table: Table, width_pt: float) -> list[list[float]]:
    """Return widths of all columns with their gaps, of four kinds, each narrower.

    Nothing breaks; headings do; texts do where they are wider than a share of the table; and names
    do after a _ or a /.
    """
    found: list[list[float]] = [[], [], [], []]
    for index, (column, widest) in enumerate(zip(table.columns, _widest_pt(table), strict=True)):
        heading = max(map(_width_pt, _SYLLABLES.findall(column.breakable_title)), default=0.0)
        cells = [row[index].text for row in table.cells] if column.is_text else []
        share_pt = _TEXT_SHARE * width_pt
        words, pieces = (
            max((_broken_pt(cell, parts, share_pt) for cell in cells), default=widest)
            for parts in (_WORDS, _PIECES)
        )
        contents = (max(widest, _width_pt(column.brief_title)), widest, words, pieces)
        for widths, content in zip(found, contents, strict=True):
            widths.append(_GAP_PT + max(heading, content))
    return found


def _broken_pt(text: str, parts: re.Pattern[str], share_pt: float) -> float:
    """Return the width that a text needs which can break; one of several words has its share."""
    longest = max(map(_width_pt, parts.findall(text)), default=0.0)
    return max(longest, min(_width_pt(text), share_pt)) if " " in text else longest


def _widest_pt(table: Table) -> list[float]:
    cells = table.cells
    return [max((_width_pt(row[n].text) for row in cells), default=0.0)
            for n in range(len(table.columns))]  # fmt: skip


def _cut(full: Sequence[float], least: Sequence[float], width_pt: float) -> list[float]:
    """Return widths of which the largest are cut until they fit, none to less than its least."""
    widths = list(full)
    for longest in range(int(width_pt), 0, -1):
        if sum(widths) <= width_pt:
            break
        widths = [max(low, min(high, longest)) for high, low in zip(full, least, strict=True)]
    return widths


def _width_pt(text: str) -> float:
    return sum(
        _WIDTH_PT.get(letter, _CAPITAL_PT if letter.isupper() else _OTHER_PT) for letter in text
    )


def latex_text(text: str) -> str:
    """Return a text in which no letter is a command of LaTeX."""
    return "".join(_ESCAPES.get(letter, letter) for letter in text)
