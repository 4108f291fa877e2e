"""The section of a run's report on what delay compensation learned of the arm."""

import numpy as np
import pytest

from deploy.reports.figures import learned
from deploy.reports.html import write_page
from deploy.reports.runs.run_pages import run_page
from deploy.run.execute import JudgedRun
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup

ON = "controller.delay_compensation.enabled=true"
KEYS = {"inertia": "inertia_factor", "payload": "payload_kg", "lag": "lag_ms",
        "coulomb": "coulomb_nm", "viscous": "viscous_nm_s"}  # fmt: skip


def run_of(*overrides):
    delay = ["duration_s=1", "link.uplink.delay_ms=5", "link.downlink.delay_ms=5"]
    return simulate(load_setup("paper_arm", [*delay, *overrides])).data()


@pytest.fixture(scope="module")
def run():
    return run_of(ON, "plant.actuator.lag_ms=2",
                  "faults=[{kind: payload_picked_up, payload_kg: 2, at_s: 0.5}]")  # fmt: skip


def drawn(run, name):
    return learned.learned_over_time(run, KEYS[name])


@pytest.mark.parametrize("name", ["inertia", "payload", "lag"])
def test_belief_is_drawn_beside_the_truth(run, name):
    truth, believed = drawn(run, name).data  # the truth lies below
    field, factor = {"inertia": ("inertia_factor", 1.0), "payload": ("payload_kg", 1.0),
                     "lag": ("actuator_lag_s", 1e3)}[name]  # fmt: skip
    values = factor * run.tables["control_status"][field]
    np.testing.assert_array_equal(believed.y, values)
    assert truth.line.width > believed.line.width
    assert list(truth.y) == {"inertia": [1.0 / 0.9] * 2, "payload": [0.0, 2.0, 2.0],
                             "lag": [2.0] * 2}[name]  # fmt: skip
    lowest, highest = drawn(run, name).layout.yaxis.range
    assert lowest < min(*values, *truth.y)
    assert highest > max(*values, *truth.y)


def test_friction_has_a_row_for_each_joint(run):
    for name, truth in (("coulomb", [8.0, 6.0, 4.0]), ("viscous", [10.0, 8.0, 5.0])):
        figure = drawn(run, name)
        assert len(figure.data) == 6
        assert [trace.y[0] for trace in figure.data if trace.name == "truth"] == truth


def test_table_has_each_number_with_the_truth(run):
    table = learned.learned_values(run)
    assert len(table.rows) == 3 + 2 * 3
    assert [row[2] for row in table.rows] == pytest.approx(
        [1.0 / 0.9, 2.0, 2.0, 8.0, 6.0, 4.0, 10.0, 8.0, 5.0]
    )


def test_page_has_the_section_only_where_something_was_learned(run, tmp_path):
    path = tmp_path / "report.html"
    write_page(path, run_page(JudgedRun("", run)))
    page = path.read_text()
    assert "<h2>What was learned</h2>" in page
    assert all(f'id="learned-{name}"' in page for name in (*KEYS, "values"))
    assert "Coulomb friction (N m), elbow" in page
    without = run_of("duration_s=0.1")
    write_page(path, run_page(JudgedRun("", without)))
    assert "What was learned" not in path.read_text()


def test_what_was_not_to_be_learned_is_not_drawn():
    run = run_of(ON, "duration_s=0.1", "controller.delay_compensation.identify_model=false")
    assert [name for name in KEYS if drawn(run, name) is not None] == ["coulomb"]
    assert len(learned.learned_values(run).rows) == 3
    run = run_of(ON, "duration_s=0.1", "controller.delay_compensation.learn_friction=false")
    assert [name for name in KEYS if drawn(run, name) is None] == ["coulomb"]
