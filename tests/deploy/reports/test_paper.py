"""Results for papers: figures with what the report draws, tables as LaTeX, and a citation."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from types import SimpleNamespace

import numpy as np
import plotly.graph_objects as go
import pytest
from plotly.subplots import make_subplots

from deploy.reports.figures.style import band, joint_rows, line, new_figure, palette
from deploy.reports.page import Cards, Page, ReportHead
from deploy.reports.paper.latex import as_latex, latex_text, narrow_parts, write_latex
from deploy.reports.paper.paper import digest_of_results
from deploy.reports.results import Results
from deploy.reports.runs.run_tables import confirmation_tables
from deploy.reports.tables import Cell, Column, Table
from deploy.reports.tables import number as number_text
from deploy.studies.margin.result import MarginResult
from deploy.studies.margin.tables import help_tables
from tests.warm_process import here

pytest.importorskip("matplotlib", reason="the extra papers is not installed")
from matplotlib.figure import Figure
from matplotlib.text import Text

from deploy.reports.paper.paper_figures import WIDTHS_MM, can_be_drawn, write_figure

PAGE = r"""\documentclass[10pt,twocolumn]{article}
\usepackage{booktabs}
\setlength\textwidth{516pt}\setlength\columnsep{12pt}
\begin{document}
"""


def line_figure():
    figure = new_figure(300, "time (s)", "cost of $5 & more")
    figure.add_scatter(x=[0.0, 1.0, 2.0], y=[1.0, 4.0, 2.0], name="a <b>law</b>", mode="lines")
    figure.add_scatter(x=[0.0, 2.0], y=[3.0, 3.0], name="another", mode="markers")
    return figure


def test_a_figure_is_as_wide_as_its_columns_and_the_same_bytes_each_time(tmp_path):
    for columns, width_mm in WIDTHS_MM.items():
        files = [tmp_path / f"{columns}-{n}.svg" for n in (1, 2)]
        for file in files:
            write_figure(line_figure(), file, columns)
        first, second = (file.read_text() for file in files)
        assert first == second
        (width_pt,) = re.findall(r'<svg [^>]*?width="([\d.]+)pt"', first)
        assert float(width_pt) / 72.0 * 25.4 == pytest.approx(width_mm, abs=0.1)


def test_a_pdf_has_its_fonts_and_no_date(tmp_path):
    file = tmp_path / "figure.pdf"
    write_figure(line_figure(), file, 1)
    content = file.read_bytes()
    assert content.startswith(b"%PDF")
    assert b"STIX" in content
    assert b"CreationDate" not in content


@pytest.mark.parametrize(
    ("trace", "is_drawn"),
    [
        (go.Scatter(x=[1], y=[1]), True),
        (go.Bar(x=["a"], y=[1]), True),
        (go.Bar(x=[1], y=["a"], orientation="h"), False),
        (go.Scatter3d(x=[1], y=[1], z=[1]), False),
    ],
)
def test_only_lines_and_columns_in_the_plane_are_drawn(trace, is_drawn):
    assert can_be_drawn(go.Figure([trace])) == is_drawn
    assert not can_be_drawn(np.zeros(3))


def written(figure, tmp_path, monkeypatch, columns=1):
    """A figure as Matplotlib wrote it."""
    kept = []
    save = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda f, *a, **k: (kept.append(f), save(f, *a, **k)))
    write_figure(figure, tmp_path / "figure.svg", columns)
    return kept[0]


def drawn(figure, tmp_path, monkeypatch):
    """The axes of a figure's first row."""
    return written(figure, tmp_path, monkeypatch).axes[0]


@pytest.mark.parametrize("count", [2, 4, 9])
@pytest.mark.parametrize(
    "name", ["law {}", "fixed_time_adaptive with compensation {}", "x" * 45 + "{}"]
)
def test_legend_is_within_the_figure_and_above_the_plot(tmp_path, monkeypatch, count, name):
    figure = new_figure(300)
    for number in range(count):
        figure.add_scatter(x=[0.0, 1.0], y=[0.0, number], name=name.format(number), mode="lines")
    found = written(figure, tmp_path, monkeypatch)
    (legend,) = found.legends
    assert len(legend.get_texts()) == count
    box, plot = legend.get_window_extent(), found.axes[0].get_window_extent()
    assert 0.0 <= box.x0 < box.x1 <= found.bbox.width
    assert plot.y1 <= box.y0 + 2.0  # px: rows of text are rounded in another way on screen
    assert box.y0 < box.y1 <= found.bbox.height
    assert plot.height > 0.3 * 300  # px of 100 per inch


def test_level_far_above_all_values_does_not_flatten_them(tmp_path, monkeypatch):
    figure = new_figure(300)
    figure.add_bar(x=["a", "b"], y=[8.0, 24.0])
    figure.add_hline(1000.0, line_dash="dot")
    figure.add_hline(30.0, line_dash="dot")
    at = drawn(figure, tmp_path, monkeypatch)
    assert 30.0 < at.get_ylim()[1] < 40.0
    assert [line.get_ydata()[0] for line in at.lines] == [30.0]


def test_grid_of_subplots_stays_a_grid_and_fits_on_a_page(tmp_path, monkeypatch):
    figure = make_subplots(rows=3, cols=4, shared_yaxes="rows")
    for row in range(1, 4):
        for column in range(1, 5):
            figure.add_scatter(x=[0, 1], y=[0, row], row=row, col=column, name=str(column))
    found = written(figure, tmp_path, monkeypatch)
    places = [at.get_subplotspec() for at in found.axes]
    assert {(place.rowspan.start, place.colspan.start) for place in places} == {
        (row, column) for row in range(3) for column in range(4)
    }
    for at, place in zip(found.axes, places, strict=True):
        assert max(at.lines[0].get_ydata()) == place.rowspan.start + 1
    assert 25.4 * found.get_figheight() <= 120.0


def test_subplots_of_several_quantities_keep_their_own_titles_and_scales(tmp_path, monkeypatch):
    figure = make_subplots(rows=1, cols=2)
    for column, (title, top) in enumerate((("jump (mm)", 2.0), ("jerk (rad/s³)", 900.0)), 1):
        figure.add_scatter(x=[0, 1], y=[0.0, top], row=1, col=column)
        figure.update_yaxes(title=title, row=1, col=column)
        figure.update_xaxes(title="time (ms)", row=1, col=column)
    found = written(figure, tmp_path, monkeypatch, columns=2)
    left, right = found.axes
    assert [at.get_ylabel() for at in (left, right)] == ["jump (mm)", "jerk (rad/s³)"]
    assert left.get_ylim()[1] < 10.0 < right.get_ylim()[1]
    assert found.get_supxlabel() == "time (ms)"
    figure.update_xaxes(title="length (m)", row=1, col=2)
    found = written(figure, tmp_path, monkeypatch)
    assert [at.get_xlabel() for at in found.axes] == ["time (ms)", "length (m)"]


@pytest.mark.parametrize(
    ("values", "ticks"),
    [([0.9, 4.4], ["1", "2"]), ([0.9, 70.0], ["1", "2", "5", "10", "20", "50"])],
)
def test_a_logarithmic_axis_of_few_decades_has_plain_numbers(tmp_path, monkeypatch, values, ticks):
    """Not 2 × 10⁰."""
    figure = new_figure(300, "round trip (ms)", "mrad")
    figure.add_trace(go.Scatter(x=[0.0, 1.0], y=values))
    at = drawn(figure.update_yaxes(type="log"), tmp_path, monkeypatch)
    low, high = at.get_ylim()
    shown = [tick for tick in at.yaxis.get_major_ticks() if low <= tick.get_loc() <= high]
    assert [tick.label1.get_text() for tick in shown] == ticks
    assert not any(tick.label1.get_text() for tick in at.yaxis.get_minor_ticks())


@pytest.mark.parametrize("columns", [1, 2])
def test_names_below_bars_do_not_overprint(tmp_path, monkeypatch, columns):
    figure = new_figure(300, "link", "mm")
    names = ["no delays", *(f"wifi_campus from {start} s" for start in range(0, 50, 10))]
    figure.add_bar(x=names, y=list(range(6)))
    found = written(figure, tmp_path, monkeypatch, columns)
    labels = found.axes[0].get_xticklabels()
    assert [label.get_text() for label in labels] == names
    assert {label.get_rotation() for label in labels} == {35.0}
    assert found.axes[0].get_window_extent().height > 0.3 * found.bbox.height


def of_seven_joints(names):
    """A figure with a row for each of seven joints, which has a line of each name."""
    figure = make_subplots(rows=7, cols=1, subplot_titles=[f"joint {n}" for n in range(7)])
    for row in range(1, 8):
        for number, name in enumerate(names):
            line = {"color": ("#0072b2", "#d55e00", "#009e73")[number]}
            figure.add_scatter(
                x=[0, 1, 2], y=[0, row, number], row=row, col=1, name=name, mode="lines",
                line=line, showlegend=row == 1,
            )  # fmt: skip
    figure.update_yaxes(title_text="mrad", row=4, col=1)
    return figure


def texts_of(at):
    """All texts of axes that are shown, with their sizes."""
    return [t for t in at.findobj(Text) if t.get_text() and t.get_visible()]


@pytest.mark.parametrize(("columns", "width"), [(1, 2), (2, 4)])
def test_seven_joints_fit_in_three_inches_with_eight_points(tmp_path, monkeypatch, columns, width):
    figure = of_seven_joints(["pid", "smc"])
    found = written(figure, tmp_path, monkeypatch, columns)
    assert found.get_figheight() <= 3.0
    shown = [at for at in found.axes if at.get_visible()]
    places = [(at.get_subplotspec().rowspan.start, at.get_subplotspec().colspan.start)
              for at in shown]  # fmt: skip
    assert places == [divmod(joint, width) for joint in range(7)]
    assert [max(at.lines[0].get_ydata()) for at in shown] == list(range(1, 8))
    assert [at.get_title(loc="left") for at in shown] == [f"joint {n}" for n in range(7)]
    assert {text.get_size() for at in shown for text in texts_of(at)} == {8.0}
    boxes = [at.get_window_extent() for at in shown]
    assert all(box.height > 15.0 for box in boxes)  # px of 100 per inch
    assert not any(one.overlaps(other) for n, one in enumerate(boxes) for other in boxes[n + 1 :])


def of_joints(count):
    """A figure of errors of joints, each in the colour of its joint, and at times outside."""
    names = tuple(f"joint {n}" for n in range(count))
    figure = joint_rows(names, "mrad", "true error")
    times, ones = np.array([0.0, 1.0, 2.0]), np.ones(3)
    for row in range(1, count + 1):
        figure.add_traces(band(times, ones, -ones), rows=row, cols=1)
        figure.add_trace(line(times, 2.0 * ones, palette(row - 1), "true error"), row=row, col=1)
        figure.add_scatter(
            x=times, y=-3.0 * ones, name="outside", mode="lines",
            line={"width": 8, "color": "#c0392b"}, row=row, col=1,
        )  # fmt: skip
        figure.update_yaxes(range=[-3.0, 3.0], row=row)
    return figure


@pytest.mark.parametrize("columns", [1, 2])
@pytest.mark.parametrize("joints", [3, 5, 7])
def test_last_joint_of_each_column_has_the_times_and_the_quantity_is_named(
    tmp_path, monkeypatch, joints, columns
):
    found = written(of_joints(joints), tmp_path, monkeypatch, columns)
    shown = [at for at in found.axes if at.get_visible()]
    by_column = {at.get_subplotspec().colspan.start: at for at in shown}  # the last one of each
    for at in shown:
        has_times = any(label.get_visible() for label in at.get_xticklabels())
        assert has_times == (at in by_column.values())
    assert found._supylabel.get_text() == "true error (mrad)"
    assert found.get_figheight() <= 3.0


@pytest.mark.parametrize("columns", [1, 2])
@pytest.mark.parametrize("joints", [3, 7])
def test_legend_names_each_kind_of_line_once_and_is_of_all_joints(
    tmp_path, monkeypatch, joints, columns
):
    found = written(of_joints(joints), tmp_path, monkeypatch, columns)
    (legend,) = found.legends
    assert [text.get_text() for text in legend.get_texts()] == ["bounds", "true error", "outside"]
    shown = [at for at in found.axes if at.get_visible()]
    errors = [line for at in shown for line in at.lines if line.get_ydata()[0] == 2.0]
    assert len(errors) == joints
    assert {(line.get_color(), line.get_marker()) for line in errors} == {(palette(0), "")}
    strips = [line for at in shown for line in at.lines if line.get_ydata()[0] == -3.0]
    assert all(line.get_linewidth() > 2.0 for line in strips)  # differs in grey, and has no marker
    assert {line.get_marker() for line in strips} == {""}
    box = legend.get_window_extent()
    assert 0.0 <= box.x0 < box.x1 <= found.bbox.width
    assert not any(box.overlaps(at.get_window_extent()) for at in shown)


def test_lines_and_bars_of_equal_colour_in_grey_differ(tmp_path, monkeypatch):
    lines = drawn(of_seven_joints(["pid", "smc", "sliding"]), tmp_path, monkeypatch).lines
    assert len({(line.get_linestyle(), line.get_marker()) for line in lines}) == 3
    reverse = of_seven_joints(["pid", "smc", "sliding"])
    reverse.data = reverse.data[::-1]
    again = drawn(reverse, tmp_path, monkeypatch).lines
    marker = {line.get_color(): line.get_marker() for line in lines}
    assert {line.get_color(): line.get_marker() for line in again} == marker  # of each law
    figure = new_figure(300)
    for name in ("pid", "smc", "sliding"):
        figure.add_bar(x=["a", "b"], y=[1.0, 2.0], name=name)
    bars = drawn(figure, tmp_path, monkeypatch).containers
    assert len({bar.patches[0].get_hatch() for bar in bars}) == 3


def test_lines_with_points_of_laws_differ_in_grey_and_where_they_coincide(tmp_path, monkeypatch):
    """All points but those of one law are hollow, of shapes of their own, so none hides another."""
    figure = new_figure(300)
    for place, name in enumerate(("pid", "smc", "sliding")):
        figure.add_scatter(x=[1, 2], y=[1, 2], name=name, mode="lines+markers", showlegend=False,
                           line={"color": palette(place)}, marker={"symbol": "circle"})  # fmt: skip
        figure.add_scatter(x=[None], y=[None], name=f"{name} alone", mode="lines",
                           line={"color": palette(place)})  # fmt: skip
    found = written(figure, tmp_path, monkeypatch)
    shown = [line for line in found.axes[0].lines if len(line.get_xdata()) == 2]
    assert len({line.get_marker() for line in shown}) == 3
    assert sum(line.get_fillstyle() != "none" for line in shown) == 1
    names = [text.get_text() for text in found.legends[0].get_texts()]
    assert names == ["pid alone", "smc alone", "sliding alone"]  # as the report's legend


@pytest.mark.parametrize("symbols", [None, ["circle", "diamond"]])
def test_points_of_laws_differ_in_grey(tmp_path, monkeypatch, symbols):
    """By their shape, or where that says something else, by how they are filled."""
    figure = new_figure(300)
    for place, name in enumerate(("pid", "smc", "sliding")):
        marker = {"color": palette(place), "symbol": symbols}
        figure.add_scatter(x=[1, 2], y=[1, 2], name=name, mode="markers", marker=marker)
    lines = drawn(figure, tmp_path, monkeypatch).lines
    named = [line for line in lines if not line.get_label().startswith("_")]
    assert [line.get_label() for line in named] == ["pid", "smc", "sliding"]
    assert len({(line.get_marker(), line.get_fillstyle()) for line in named}) == 3
    shapes = {line.get_marker() for line in named}
    assert len(shapes) == (3 if symbols is None else 1)


@pytest.mark.parametrize(
    "symbol", ["line-ew-open", "circle-open", "triangle-up", "triangle-down", "star-diamond-dot"]
)
def test_any_symbol_of_plotly_is_drawn(tmp_path, symbol):
    figure = line_figure().add_scatter(x=[1.0], y=[2.0], mode="markers", marker_symbol=symbol)
    write_figure(figure, tmp_path / "any.svg", 1)
    assert (tmp_path / "any.svg").stat().st_size > 1000


def test_intervals_of_points_are_drawn(tmp_path, monkeypatch):
    figure = new_figure(300)
    half = {"array": [0.5, 0.25], "arrayminus": [0.1, 0.2], "symmetric": False}
    figure.add_scatter(x=[1.0, 2.0], y=["a", "b"], name="friction", mode="markers", error_x=half)
    [bars] = drawn(figure, tmp_path, monkeypatch).collections
    ends = [[float(x) for x, _ in segment] for segment in bars.get_segments()]
    assert ends == [[0.9, 1.5], [1.8, 2.25]]


def test_legend_does_not_repeat_the_titles_of_subplots(tmp_path, monkeypatch):
    figure = make_subplots(rows=2, cols=1, subplot_titles=["elbow", "wrist"])
    for row, name in enumerate(["elbow", "wrist"], 1):
        figure.add_scatter(x=[0, 1], y=[0, row], row=row, col=1, name=name, mode="lines")
    found = written(figure, tmp_path, monkeypatch)
    assert not found.legends
    assert [at.lines[0].get_marker() for at in found.axes] == ["", ""]  # one line each


def test_upright_level_far_from_all_values_is_left_out(tmp_path, monkeypatch):
    figure = new_figure(300)
    figure.add_scatter(x=[0.0, 20.0], y=[0.0, 1.0], mode="lines")
    figure.add_vline(25.0)
    figure.add_vline(1001.0)
    at = drawn(figure, tmp_path, monkeypatch)
    assert [line.get_xdata()[0] for line in at.lines[1:]] == [25.0]
    assert at.get_xlim()[1] < 30.0


def test_wide_table_becomes_tables_of_six_columns_with_short_captions():
    columns = [Column(f"c{number}", is_text=number == 0) for number in range(12)]
    rows = [[f"row {row}", *range(11)] for row in range(2)]
    table = Table("Laws", columns, rows, "A long note. " * 20)
    parts = list(narrow_parts(table))
    assert [[column.heading for column in part.columns] for part in parts] == [
        ["c0", "c1", "c2", "c3", "c4"], ["c0", "c5", "c6", "c7", "c8"], ["c0", "c9", "c10", "c11"],
    ]  # fmt: skip
    assert [list(part.rows[0]) for part in parts] == [
        ["row 0", 0, 1, 2, 3], ["row 0", 4, 5, 6, 7], ["row 0", 8, 9, 10],
    ]  # fmt: skip
    text = as_latex(parts[0], "tab:any")
    assert [part.title for part in parts] == [
        "Laws: c1, c2, c3, c4", "Laws: c5, c6, c7, c8", "Laws: c9, c10, c11",
    ]  # fmt: skip
    assert r"\caption{Laws: c1, c2, c3, c4}" in text
    assert r"\begin{tabular}{lrrrr}" in text


def test_long_table_becomes_tables_that_fit_on_a_page():
    """A longtable would end in an error on a page of two columns."""
    rows = [[f"row {row}", row] for row in range(90)]
    parts = list(narrow_parts(Table("Long", [Column("c0", is_text=True), Column("c1")], rows)))
    assert [part.title for part in parts] == [
        "Long, rows 1 to 40 of 90", "Long, rows 41 to 80 of 90", "Long, rows 81 to 90 of 90",
    ]  # fmt: skip
    assert [row for part in parts for row in part.rows] == rows


@pytest.mark.parametrize("columns", [[], [Column("Law", is_text=True)], [Column("c", brief=None)]])
def test_table_without_columns_or_rows_is_left_out(columns):
    assert not list(narrow_parts(Table("Empty", columns, [[None] * len(columns)])))
    assert not list(narrow_parts(Table("Empty", [Column("Law"), Column("c")], [])))


def test_rows_of_numbers_keep_all_that_tell_them_apart():
    columns = [Column(f"c{number}") for number in range(8)]
    rows = [[1.0, 2.0, *range(6)], [1.0, 3.0, *range(6)]]
    first, second = narrow_parts(Table("Grid", columns, rows))
    assert [row[:2] for row in second.rows] == [[1.0, 2.0], [1.0, 3.0]]
    assert first.title == "Grid: c2, c3, c4"


def test_confirmation_of_several_scenarios_names_them():
    each = {"law": "pid", "physics": "MuJoCo", "runs": 1, "agree": 1, "differ": 0, "too_near": 0,
            "margin_difference": 0.1, "error_difference_rad": 0.1}  # fmt: skip
    both = [[{**each, "scenario": "iiwa"}, {**each, "scenario": "panda"}]]
    first, _ = narrow_parts(confirmation_tables(both)[0])
    assert [row[0] for row in first.rows] == ["iiwa", "panda"]
    assert "iiwa" not in str([*narrow_parts(confirmation_tables([both[0][:1]])[0])])


def test_texts_too_long_for_a_page_go_on_below():
    """Words break after an underscore or a slash, so that no name is wider than its column."""
    columns = [Column("Law", is_text=True), Column("Detail", is_text=True), Column("Time", "s")]
    text = as_latex(Table("Laws", columns, [["fixed_time", "a_b/c " * 30, 1.0]]), "tab:any")
    width_pt = int(re.findall(r"begin\{tabular\}\{lp\{(\d+)pt\}r\}", text)[0])
    assert 300 < width_pt < 516 - 3 * 12
    assert r"fixed\_time & \raggedright a\_\allowbreak b/\allowbreak c" in text
    assert text.count(r"\tabularnewline") == 2
    assert r"\\" not in text


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="pdflatex is not installed")
def test_no_table_is_wider_than_a_page_of_ieee(tmp_path):
    """At lengths that change the kind of table, in letters wider than those of the journal."""
    tables = [
        Table("Wide", [Column("Law", is_text=True), *(Column(f"c{n}") for n in range(count))],
              [[(word + " ") * words, *([word] * count)]])
        for word in ("mmmm", "WWW", "00000", "e_e_e") for words in (1, 2, 5, 9, 40)
        for count in (1, 4, 8)
    ]  # fmt: skip
    parts = [as_latex(part, "tab:any") for table in tables for part in narrow_parts(table)]
    assert {"table", "table*"} <= set(re.findall(r"begin{(.*?)}", " ".join(parts)))
    (tmp_path / "t.tex").write_text(PAGE + "\\clearpage\n".join(parts) + r"\end{document}")
    subprocess.run(["pdflatex", "-interaction=nonstopmode", "t.tex"], cwd=tmp_path,
                   check=True, capture_output=True)  # fmt: skip
    assert "Overfull" not in (tmp_path / "t.log").read_text(encoding="latin-1")


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="pdflatex is not installed")
def test_tables_for_one_column_stay_within_it(tmp_path):
    tables = [
        Table("Wide", [Column("Law", is_text=True), *(Column(f"c{n}") for n in range(8))],
              [[(word + " ") * words, *([word] * 8)]])
        for word in ("mmmm", "00000", "e_e_e") for words in (1, 9, 40)
    ]  # fmt: skip
    page = Page("kind", "name", ReportHead("good", "", []), [], list, None, results=[Cards(tables)])
    text = write_latex(page, tmp_path / "tables.tex", columns=1).read_text()
    assert set(re.findall(r"begin{(table.?)}", text)) == {"table"}
    text = text.replace("\\begin{table}", "\\clearpage\\begin{table}")
    (tmp_path / "t.tex").write_text(PAGE + text + r"\end{document}")
    subprocess.run(["pdflatex", "-interaction=nonstopmode", "t.tex"], cwd=tmp_path,
                   check=True, capture_output=True)  # fmt: skip
    assert "Overfull" not in (tmp_path / "t.log").read_text(encoding="latin-1")


def test_parts_of_a_wide_table_repeat_only_columns_that_tell_rows_apart():
    """What all rows share is in the title."""
    columns = [Column(f"c{number}", is_text=number < 4) for number in range(10)]
    rows = [["smc", each, "given", n, *range(6)] for each in ("none", "smith") for n in "ab"]
    parts = list(narrow_parts(Table("Laws", columns, rows)))
    assert [[column.heading for column in part.columns] for part in parts] == [
        ["c1", "c3", "c4", "c5", "c6"], ["c1", "c3", "c7", "c8", "c9"],
    ]  # fmt: skip
    assert parts[1].rows[1] == ["none", "b", 3, 4, 5]
    assert parts[1].title == "Laws: smc, given: c7, c8, c9"


def test_headings_break_before_names_do_and_names_only_where_that_saves_a_table():
    columns = [Column("Law", is_text=True), Column("Compensation", "", "Compen-\nsation", True),
               *(Column("Largest round trip kept", "ms") for _ in range(4))]  # fmt: skip
    rows = [[name, "without", 1.0, 2.0, 3.0, 4.0] for name in ("smc", "pid")]
    (part,) = narrow_parts(Table("Laws", columns, rows), 252.0)
    text = as_latex(part, "tab:any", 252.0)
    assert r"\begin{tabular}[b]{@{}r@{}}Largest" in text
    assert r"\begin{tabular}[b]{@{}l@{}}Compen-\\sation" in text
    assert r"\begin{tabular}{llrrrr}" in text
    rows = [["fixed_time_adaptive", each, *(123456.0 for _ in range(4))] for each in ("with", "–")]
    rows.append(["pid", "with", 1.0, 2.0, 3.0, 4.0])
    (part,) = narrow_parts(Table("Laws", columns, rows), 252.0)
    assert r"fixed\_\allowbreak time" in as_latex(part, "tab:any", 252.0)


def test_unit_stays_on_one_line_and_row_names_stay_whole_beside_headings_that_can_break():
    columns = [Column("Messages", is_text=True), *(Column("Total variation", "N m/s"),) * 4]
    text = as_latex(Table("Laws", columns, [["lost in a row", 1.0, 2.0, 3.0, 4.0]]), "any", 252.0)
    assert r"Total\\variation\\(N~m/s)" in text
    assert r"\begin{tabular}{lrrrr}" in text
    columns = [Column("Time", is_text=True), *(Column(f"p{n}", "µs") for n in ("50", "99", "99.9"))]
    text = as_latex(Table("Timing", columns, [["Control step", 5.0, 1.0, 1.0]]), "any", 252.0)
    assert r"Time & p50 ($\mu$s) & p99" in text


def test_papers_have_the_columns_of_a_terminal_in_which_something_is_known():
    point, outside = Column("Point", brief=None), Column("Ticks outside", "%", "Out-\nside")
    columns = [Column("Law", is_text=True), point, Column("Kept"), Column("Held"), outside]
    (part,) = narrow_parts(Table("Laws", columns, [["pid", "0001", 1.0, None, 5.0]]))
    assert [column.heading for column in part.columns] == ["Law", "Kept", "Ticks outside"]
    assert r"Law & Kept & Outside (\%) \\" in as_latex(part, "tab:any")


@pytest.mark.parametrize(("letters", "kind"), [(20, "table"), (80, "table*")])
def test_a_table_wider_than_a_column_stands_over_two(letters, kind):
    text = as_latex(Table("Laws", [Column("Law", is_text=True)], [[letters * "x"]]), "tab:any")
    assert rf"\begin{{{kind}}}" in text


def test_commands_that_help_are_in_the_report_alone():
    tried = [{"change": "drive loop", "held": True, "point": "0001", "seed": 1}]
    case = {"arm": "a", "law": "pid", "compensation": None, "drive_feedback": None,
            "running": False, "what_helps": {"value": 8.0, "tried": tried}}  # fmt: skip
    (table,) = help_tables(MarginResult.model_validate({"unit": "ms", "cases": [case]}))
    assert "funnel-hil simulate" in str(table.rows)
    assert "funnel-hil" not in str([part.rows for part in narrow_parts(table)])  # nor commands


@pytest.mark.parametrize("value", [1.5e-5, 6.7e-10, 1234567.0, 2e-300])
def test_numbers_of_a_table_are_letters_that_latex_knows(value):
    assert latex_text(number_text(value)).isascii()


def test_edges_of_bands_are_no_lines(tmp_path, monkeypatch):
    figure = new_figure(300)
    edge = {"mode": "lines", "line": {"width": 0}}
    figure.add_scatter(x=[0, 1], y=[2, 3], **edge)
    figure.add_scatter(x=[0, 1], y=[0, 1], fill="tonexty", fillcolor="rgba(0, 0, 0, 0.2)", **edge)
    at = drawn(figure, tmp_path, monkeypatch)
    assert not at.lines
    assert len(at.collections) == 1


def test_bars_stand_side_by_side_and_those_without_a_value_are_left_out(tmp_path, monkeypatch):
    figure = new_figure(300)
    figure.add_bar(x=["a", "b"], y=[1.0, None], name="one", marker_color=["red", "blue"])
    figure.add_bar(x=["a", "b"], y=[3.0, 2.0], name="two")
    figure.add_hline(2.5, line_dash="dot")
    at = drawn(figure, tmp_path, monkeypatch)
    (first, _), (second, _) = (bars.patches for bars in at.containers)
    assert first.get_x() + first.get_width() == pytest.approx(second.get_x())
    assert first.get_facecolor()[:3] == (1.0, 0.0, 0.0)
    assert [label.get_text() for label in at.get_xticklabels()] == ["a", "b"]
    assert [line.get_ydata()[0] for line in at.lines] == [2.5]


def test_bars_without_height_say_why_and_levels_have_their_names(tmp_path, monkeypatch):
    figure = new_figure(300)
    figure.add_bar(x=["a", "b", "c"], y=[0.0, 0.0, 8.0], text=["none", "0", "8"], name="one",
                   showlegend=False)  # fmt: skip
    figure.add_hline(9.0, line_dash="dot", name="ceiling", showlegend=True)
    found = written(figure, tmp_path, monkeypatch)
    assert [text.get_text() for text in found.axes[0].texts] == ["none", "0"]
    (legend,) = found.legends
    assert [text.get_text() for text in legend.get_texts()] == ["ceiling"]


def test_bars_at_numbers_are_as_wide_as_their_distance(tmp_path, monkeypatch):
    figure = new_figure(300)
    figure.add_bar(x=[0.1, 0.2, 0.3], y=[1.0, 2.0, 3.0])
    figure.update_layout(bargap=0)
    at = drawn(figure, tmp_path, monkeypatch)
    assert [bar.get_width() for bar in at.patches] == pytest.approx([0.1] * 3)


def test_no_letter_of_a_table_is_a_command_of_latex():
    table = Table(
        "A & B", [Column("Law", is_text=True), Column("Share", "%")],
        [[r"\input{/etc/passwd}_x", Cell(0.5)]], "100 % of #1",
    )  # fmt: skip
    text = as_latex(table, "tab:any")
    assert r"\textbackslash{}input\{/etc/passwd\}\_x & 0.5 \\" in text
    assert r"\caption{A \& B}" in text
    assert text.startswith("% 100 % of #1\n")  # a comment
    assert r"Law & Share (\%) \\" in text
    assert latex_text("|e| < 1") == r"\textbar{}e\textbar{} \textless{} 1"
    assert latex_text("τ × 10⁻³") == r"$\tau$ $\times$ 10$^{-}$$^{3}$"


def test_each_table_has_a_label_of_its_title(tmp_path):
    columns = [Column("Law", is_text=True), Column("Share", "%")]
    titles = ["Ways to drive: A_1 & B (°)", "Runs", "Runs"]
    tables = [Table(each, columns, [["pid", 1.0]]) for each in titles]
    page = SimpleNamespace(name="page", conditions={}, tables=tables)
    text = write_latex(page, tmp_path / "tables.tex").read_text()
    labels = [r"\label{tab:ways-to-drive-a-1-b}", r"\label{tab:runs}", r"\label{tab:runs-2}"]
    assert re.findall(r"\\label.*", text) == labels
    assert re.search(r"\\caption{Runs}\n\\label{tab:runs}", text)


def test_digest_of_a_data_sheet_does_not_change_with_its_date():
    def digest(date, margin_ms):
        part = {"margin_ms": margin_ms, "conditions": {"date": date}}
        summary = {"kind": "datasheet", "parts": [part], "conditions": {"date": date}}
        return digest_of_results(Results(summary, None))

    assert digest("today", 4.0) == digest("yesterday", 4.0)
    assert digest("today", 4.0) != digest("today", 5.0)


def test_export_writes_figures_tables_and_a_citation_of_a_run(tmp_path):
    out = tmp_path / "run"
    code, output = here(
        "simulate", "paper_arm", "--set", "duration_s=0.3", "--out", out, "--no-report"
    )
    assert code == 0, output
    code, output = here("export", out, "--figures", "svg", "--latex", "--bibtex")
    assert code == 0, output
    folder = out / "export"
    assert {"error-in-funnel.svg", "torques.svg"} <= {file.name for file in folder.iterdir()}
    assert r"base\_yaw" in (folder / "tables.tex").read_text()
    citation = (folder / "citation.bib").read_text()
    (digest,) = re.findall(r"digest (\w{16})", citation)
    assert digest in (out / "summary.json").read_text()
    manifest = json.loads((out / "manifest.json").read_text())
    manifest["versions"]["funnel-hil"] = "0.0.9"  # an earlier version made the run
    (out / "manifest.json").write_text(json.dumps(manifest))
    assert here("export", out, "--bibtex")[0] == 0
    assert "version = {0.0.9}" in (folder / "citation.bib").read_text()
    recording = out / "run.mcap"
    recording.write_bytes(recording.read_bytes()[:-20_000])
    code, output = here("export", out, "--latex")
    assert code == 1
    assert output.count("The recording is damaged") == 1


def test_an_unknown_format_is_refused(tmp_path):
    code, output = here("export", tmp_path, "--figures", "png")
    assert code == 2
    assert "--figures png: must be pdf, svg" in output
