"""Figures of margins over uncertain plants."""

from __future__ import annotations

from collections.abc import Sequence

import plotly.graph_objects as go

from deploy.reports.figures import style

_EFFECT_PX, _FRAME_PX = 26, 110


def effects(bars: Sequence[tuple[str, float]], chance_level: float) -> go.Figure | None:
    """One bar for each quantity, the first on top.

    Args:
        bars: names and effects, from −1 to 1.
        chance_level: size of what may be chance.
    """
    if not bars:
        return None
    height_px = _FRAME_PX + _EFFECT_PX * len(bars)
    figure = style.new_figure(height_px, "effect")
    sizes = [effect for _, effect in bars]
    beyond = [abs(effect) > chance_level for effect in sizes]
    figure.add_bar(
        y=[style.plain(name) for name, _ in bars], x=sizes, orientation="h",
        marker={"color": [style.palette(0) if known else "#b8c4cc" for known in beyond]},
        text=[f"{effect:+.2f}" for effect in sizes], textposition="outside", cliponaxis=False,
        hovertemplate="%{y}: %{x:+.2f}<extra></extra>",
    )  # fmt: skip
    figure.add_vrect(
        x0=-chance_level, x1=chance_level, fillcolor=style.BAND, line_width=0, layer="below"
    )
    figure.update_xaxes(range=[-1.1, 1.1])
    return figure.update_yaxes(autorange="reversed", automargin=True)
