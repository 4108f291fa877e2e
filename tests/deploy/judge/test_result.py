"""Declarations of figures: what is added by one declaration reaches summary, rows and reference."""

from typing import Annotated

import pytest

from deploy.judge.metrics import RunResult, judge
from deploy.judge.result.section import Column, Section, figures
from deploy.judge.run_rows import COLUMNS, row
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup


class Thermal(Section):
    """Heat.

    Attributes:
        peak_k: highest temperature
        mean_k: mean of each joint
        shares: shares of time by band
    """

    peak_k: Annotated[float | None, Column(of_any_part=True)]
    mean_k: Annotated[list[float | None], Column()]
    shares: Annotated[dict[str, float], Column("share_{}", entries=("low", "high"))]
    spots: int = 0


class Heated(Section):
    """A result."""

    only_sometimes = frozenset({"note"})
    motor: Annotated[Thermal | None, Column("motor_{}")]
    hot: Annotated[list[Thermal], Column(kind="bool")]
    note: str | None = None


def columns_of(section):
    return {name: each.kind for each in figures(section) for name in each.columns}


def test_declared_column_has_the_name_of_its_part_and_the_type_of_its_figure():
    assert columns_of(Heated) == {
        "motor_peak_k": "double", "motor_mean_k": "list<double>",
        "motor_share_low": "double", "motor_share_high": "double", "hot": "bool",
    }  # fmt: skip


def test_figures_are_named_by_their_keys_in_the_summary():
    paths = [".".join(each.path) for each in figures(Heated)]
    assert paths[:5] == ["motor", "motor.peak_k", "motor.mean_k", "motor.shares", "motor.spots"]
    assert "hot[].peak_k" in paths


def test_figure_that_exists_only_sometimes_is_left_out_where_nothing_measured_it():
    assert Heated(motor=None, hot=[]).model_dump() == {"motor": None, "hot": []}
    assert Heated(motor=None, hot=[], note="odd").model_dump()["note"] == "odd"


@pytest.fixture(scope="module")
def result():
    return judge(simulate(load_setup("paper_arm", ["duration_s=0.1"])).data())


def test_result_can_be_read_from_its_summary(result):
    assert RunResult(**result.model_dump()) == result


def test_row_has_a_value_for_each_column(result):
    values = row(result, 1)
    assert values.keys() == COLUMNS.keys()
    assert values["uplink_sent"] == result.transport.uplink.sent == 100
    assert values["tip_rms_mm"] == result.tip_error_mm.rms
    assert values["settling_bound_s"] == [result.tracking.settling_bound_s] * 3


def test_values_of_a_result_never_change(result):
    with pytest.raises(ValueError, match="frozen"):
        result.ticks = 0
