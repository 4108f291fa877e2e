from __future__ import annotations

import io

import pytest
from rich.console import Console

from deploy.reports.tables import Cell, Column, Table, as_markdown, number, percent, short_names
from deploy.reports.terminal import print_table

TABLE = Table(
    "Margins of [two] laws",
    [
        Column("Law", is_text=True),
        Column("Smallest margin", "%", "Margin"),
        Column("Found in reports only", brief=None),
    ],
    [["[bold]pid", Cell(None, "bad"), "one"], ["smc", Cell(34.167, "best"), "two"]],
)


def printed(table, width=80, **options):
    console = Console(file=io.StringIO(), width=width, **options)
    print_table(console, table)
    return console.file.getvalue()


def test_a_terminal_shows_the_columns_that_have_room_there():
    text = printed(TABLE)
    lines = [line.split() for line in text.splitlines() if line.strip()]
    assert lines[0] == ["Margins", "of", "[two]", "laws"]
    assert lines[1:3] == [["Margin"], ["Law", "%"]]
    assert lines[-2:] == [["[bold]pid", "–"], ["smc", "34.2"]]
    assert "Found" not in text


def test_a_terminal_colours_what_is_judged():
    colourful = printed(TABLE, force_terminal=True, color_system="standard")
    assert "\x1b[1;31m" in colourful
    assert "\x1b[1;31m" not in printed(TABLE)


@pytest.mark.parametrize("is_terminal", [False, True])
def test_numbers_are_whole_in_a_terminal_that_is_too_narrow(is_terminal):
    columns = [Column("Law", is_text=True), *(Column(f"{each} ms") for each in (32, 64, 96, 128))]
    table = Table("Plants kept", columns, [["fixed_time_adaptive", *["14 of 14"] * 3, "111.5 ms"]])
    text = printed(table, 30, force_terminal=is_terminal, no_color=True)
    assert text.split().count("14") == 6
    assert "111.5" in text.split()


@pytest.mark.parametrize("width", [80, 200])
def test_a_wide_table_stays_within_a_terminal(width):
    names = [f"a_rather_long_joint_name_{index}" for index in range(7)]
    table = Table(
        "RMS error", [Column("Law", is_text=True), *map(Column, names)],
        [["fixed_time_model_based", *range(1000, 1007)]],
    )  # fmt: skip
    text = printed(table, width)
    assert max(map(len, text.splitlines())) <= width
    assert "fixed_time_model_based" in text
    assert "…" not in text


@pytest.mark.parametrize("is_terminal", [False, True])
def test_headings_break_between_words_only(is_terminal):
    heading, name = "Largest inference_time", "a_rather_long_joint_name"
    columns = [Column("Merge", is_text=True), *[Column(heading, "ms")] * 3, *[Column(name)] * 5]
    table = Table("Merges", columns, [["temporal_ensemble", *[1.0] * 8]])
    text = printed(table, 80, force_terminal=is_terminal, color_system=None)
    parts = {"Largest", "inference_", "time", "ms", "Merge", "a_rather_", "long_", "joint_",
             "name", "a_", "rather_", "long_joint_", "Merges"}  # fmt: skip
    head = text.split("─")[0]
    assert set(head.split()) <= parts
    assert head.split().count("inference_") == 3


def test_names_stay_on_a_line_of_a_narrow_terminal_and_are_whole_in_a_wide_one():
    law = "my_own_package.my_control_laws:MyGreatController"
    table = Table(
        "Margins", [Column("Law", is_text=True), *(Column(f"Column {at}") for at in range(6))],
        [[law, *range(1000, 1006)], ["pid", *range(6)]],
    )  # fmt: skip
    narrow = printed(table, 80, force_terminal=True, color_system=None)
    (line,) = [line for line in narrow.splitlines() if "1,000" in line]
    assert line.split()[0] == "my_own_packa…tController"
    assert max(map(len, narrow.splitlines())) <= 80
    assert law in printed(table, 200, force_terminal=True, color_system=None)


def test_a_document_has_every_column():
    assert as_markdown(TABLE).splitlines() == [
        "| Law | Smallest margin (%) | Found in reports only |",
        "| --- | --- | --- |",
        "| [bold]pid | – | one |",
        "| smc | 34.2 | two |",
    ]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"),
        (0, "0"),
        (3, "3"),
        (0.01234, "0.0123"),
        (999.6, "1,000"),
        (94355.4, "94,355"),
        (6.61e-5, "6.61 × 10⁻⁵"),
        (-2e-12, "-2 × 10⁻¹²"),
    ],
)
def test_numbers_have_three_digits_or_all_before_the_point(value, text):
    assert number(value) == text


def test_all_deadlines_are_met_only_if_every_single_one_was():
    assert percent(1.0) == "100 %"
    assert percent(1.0 - 1e-9) == "99.999 %"


@pytest.mark.parametrize(
    ("names", "short"),
    [
        (["lbr_iiwa_joint_1", "lbr_iiwa_joint_2"], ["…joint_1", "…joint_2"]),
        (["panda_joint1", "panda_joint2"], ["…joint1", "…joint2"]),
        (["base_yaw", "shoulder", "elbow"], ["base_yaw", "shoulder", "elbow"]),
        (["left_arm", "left_arm"], ["…arm", "…arm"]),
        (["a_b", "a_b_c"], ["…b", "…b_c"]),
        (["_1", "_2"], ["_1", "_2"]),
        (["only_one"], ["only_one"]),
        ([], []),
    ],
)
def test_names_are_shortened_to_the_part_that_differs(names, short):
    assert short_names(names) == short


def wide_table(arms):
    """A table of two rows for each arm, with 16 columns of numbers of five digits."""
    columns = [Column("Arm", is_text=True), Column("Merge", is_text=True)]
    columns += [Column(f"c{n}") for n in range(16)]
    rows = [[arm, merge, *map(float, range(10000, 10016))]
            for arm in arms for merge in ("replace", "weighted")]  # fmt: skip
    return Table("Merges", columns, rows)


@pytest.mark.parametrize("arms", [["ur5e_motors"], ["ur5e_motors", "panda_motors"]])
def test_columns_without_room_follow_below_with_the_names_of_rows(arms):
    text = printed(wide_table(arms))
    assert max(map(len, text.splitlines())) <= 80
    words = text.split()
    assert all(words.count(f"{number:,}") == 2 * len(arms) for number in range(10000, 10016))
    assert words.count("weighted") % len(arms) == 0 < words.count("weighted") - len(arms)


def test_what_all_rows_of_a_wide_table_share_is_in_its_title():
    assert printed(wide_table(["ur5e_motors"])).startswith("Merges: ur5e_motors\n")
    assert printed(wide_table(["a", "b"])).startswith("Merges\n")
    assert printed(wide_table(["ur5e_motors"]), 200).startswith("Merges\n")
