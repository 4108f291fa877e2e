"""The looks that all figures have in common."""

import json

import plotly.graph_objects as go
import plotly.io as pio
import pytest

from deploy.reports.figure_json import figure_json, no_template, template


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


def test_a_figure_gets_the_template_when_it_is_written_and_not_before():
    with no_template():
        figure = go.Figure(layout={"height": 300})
    assert figure.to_plotly_json() == {"data": [], "layout": {"height": 300}}
    written = json.loads(figure_json(figure))
    assert written["layout"] == {"height": 300, "template": template()}


def test_figures_of_others_keep_their_template():
    before = pio.templates.default
    with pytest.raises(ZeroDivisionError), no_template():
        raise ZeroDivisionError
    assert pio.templates.default == before == "plotly"
    assert go.Figure().layout.template.layout.to_plotly_json()
