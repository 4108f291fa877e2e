"""The looks that all figures have in common."""

import json

import plotly.graph_objects as go
import plotly.io as pio
import pytest

from deploy.reports.figures.style import figure_json, new_figure, template


def keys_of(table, before=()):
    """All dotted keys of a nested table, with their values."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from keys_of(value, (*before, key))
        else:
            yield ".".join((*before, key)), value


def test_the_template_is_what_plotly_makes_of_it():
    """It is written as it is, so Plotly has to take all of it, and understand it so."""
    assert go.layout.Template(template()).to_plotly_json() == template()


def test_the_template_is_plotlys_own_on_white_where_it_is_not_ours():
    plotlys = dict(keys_of(pio.templates["plotly_white"].to_plotly_json()))
    ours = dict(keys_of(template()))
    changed = {key for key, value in ours.items() if plotlys.get(key) != value}
    assert plotlys["layout.plot_bgcolor"] == ours["layout.plot_bgcolor"] == "white"
    assert {key.split(".")[1] for key in changed} == {
        "margin", "font", "hoverlabel", "legend", "xaxis", "yaxis",
    }  # fmt: skip


@pytest.mark.parametrize("make", [lambda: new_figure(300), lambda: go.Figure(layout_height=300)])
def test_a_figure_of_ours_or_of_others_is_written_with_the_template(make):
    layout = json.loads(figure_json(make()))["layout"]
    assert (layout["height"], layout["template"]) == (300, template())


def test_a_figure_of_ours_is_made_without_the_large_template():
    assert len(new_figure(300).to_json()) < 200 < len(go.Figure().to_json())
