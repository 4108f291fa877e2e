"""A moving picture of an arm on a Wi-Fi network, without help and with it.

Help is delay compensation and a drive loop.

    python -m scripts.experiments.moving_picture PICTURE.svg

Both runs have the same law, arm and window of the network. The picture is an SVG that moves by
itself in a browser: the arm (grey: its reference), its worst joint's error in the funnel, and the
delay from a state until its command acts.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.messages import topics
from controller.funnel import performance_function
from controller.manipulator_model import ManipulatorModel
from deploy.judge.metrics import summarise
from deploy.judge.run_data import RunData
from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup

LAW, NETWORK, END_S, FRAMES = "fixed_time_adaptive", "wifi_crowded", 8.0, 161
_WIDTH, _HEIGHT, _HALF, _PLOT, _TOP = 860, 520, 430, 110, 300
_PLAYS_S = 10.0
_RED, _GREEN, _GREY, _BLUE = "#b3401a", "#00704f", "#9aa5b1", "#0072b2"


def run_on_network(*, is_helped: bool) -> RunData:
    """Return a run of the arm on the network."""
    setup = load_setup(
        "paper_arm",
        [
            f"controller.law={LAW}", f"duration_s={END_S}",
            f"link.uplink.trace.file={NETWORK}", f"link.downlink.trace.file={NETWORK}",
            f"controller.delay_compensation.enabled={str(is_helped).lower()}",
            f"controller.drive_feedback.enabled={str(is_helped).lower()}",
        ],
    )  # fmt: skip
    return simulate(setup).data()


def picture(runs: dict[str, RunData]) -> str:
    """Return the SVG of runs by their title."""
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}"'
        ' font-family="sans-serif" font-size="13">',
        '<rect width="100%" height="100%" fill="white"/>',
    ]
    for number, (title, run) in enumerate(runs.items()):
        parts += [f'<g transform="translate({_HALF * number} 0)">', *_half(title, run), "</g>"]
    return "\n".join([*parts, "</svg>\n"])


def _half(title: str, run: RunData) -> list[str]:
    bounds = summarise(run)["bounds"]
    colour = _GREEN if bounds["kept"] else _RED
    lost_s = bounds["first_violation_s"]
    verdict = "keeps its bounds" if lost_s is None else f"leaves its bounds at {lost_s:.1f} s"
    errors, times_s = run.true_errors_rad, run.times_s(topics.PLANT_TRUTH)
    joint = int(np.argmax(np.abs(errors[times_s > 1.0]).max(axis=0)))
    funnel = run.setup.funnel
    ends = [
        np.array([
            performance_function(t, start[joint], funnel.final_rad[joint], funnel.rate_per_s)[0]
            for t in times_s.tolist()
        ])
        for start in (funnel.initial_upper_rad, funnel.initial_lower_rad)
    ]  # fmt: skip
    status = run.tables[topics.PLANT_STATUS.name]
    shown = np.linspace(0, len(times_s) - 1, 600).astype(int)
    name = run.setup.robot.joint_names[joint]
    x = times_s[shown] / END_S
    final = 3.0 * float(funnel.final_rad[joint])
    place, delay_place = (_TOP, final, -final), (_TOP + _PLOT + 26, 200.0, 0.0)
    delay_ms = 1e-6 * status["command_delay_ns"].astype(float)
    delays = np.interp(times_s[shown], run.times_s(topics.PLANT_STATUS), delay_ms)
    curve = f'fill="none" stroke="{colour}" stroke-width="1.8"'
    edge = f'fill="none" stroke="{_BLUE}" stroke-dasharray="3 3"'
    return [
        f'<text x="20" y="24" font-weight="bold">{title}</text>',
        f'<text x="20" y="44" fill="{colour}" font-weight="bold">{verdict}</text>',
        *_arms(run, times_s, colour),
        f'<text x="20" y="{_TOP - 6}">error of {name}, and its bounds (±10 mrad at the end)</text>',
        *(f'<polyline points="{_points(x, end[shown], place)}" {edge}/>'
          for end in (ends[0], -ends[1])),
        f'<polyline points="{_points(x, errors[shown, joint], place)}" {curve}/>',
        f'<text x="20" y="{delay_place[0] - 6}">delay until a command acts, 0 to 200 ms</text>',
        f'<polyline points="{_points(x, delays, delay_place)}" fill="none" stroke="#1f2933"/>',
        f'<line y1="{_TOP}" y2="{_TOP + 2 * _PLOT + 26 - 40}" stroke="black" opacity=".5">',
        *(f'<animate attributeName="{end}" values="20;{_HALF - 20}" dur="{_PLAYS_S}s"'
          ' repeatCount="indefinite"/>' for end in ("x1", "x2")),
        "</line>",
    ]  # fmt: skip


def _points(x: Vector, y: Vector, place: tuple[float, float, float]) -> str:
    """Return the points of a curve; values beyond the ends of its place stay at them."""
    top, high, low = place
    height = _PLOT if top == _TOP else _PLOT - 40
    across = 20 + x * (_HALF - 40)
    down = top + height * (high - np.clip(y, low, high)) / (high - low)
    return " ".join(f"{a:.0f},{b:.1f}" for a, b in zip(across, down, strict=True))


def _arms(run: RunData, times_s: Vector, colour: str) -> list[str]:
    """Return the arm and, behind it, the arm on its reference; seen from the side."""
    setup, model = run.setup, ManipulatorModel(run.setup.robot)
    frames = np.linspace(0, len(times_s) - 1, FRAMES).astype(int)
    truth = run.tables[topics.PLANT_TRUTH.name]["position"]
    now = np.empty((3, setup.robot.joints))
    shapes: dict[str, list[str]] = {"reference": [], "true": []}
    for frame in frames.tolist():
        setup.reference.evaluate(float(times_s[frame]), *now)
        for name, position in (("reference", now[0]), ("true", truth[frame])):
            shapes[name].append(_side_view(model, position))
    drawn = []
    for name, stroke in (("reference", _GREY), ("true", colour)):
        width = 9 if name == "reference" else 6
        drawn += [
            f'<polyline points="{shapes[name][0]}" fill="none" stroke="{stroke}"'
            f' stroke-width="{width}" stroke-linejoin="round" stroke-linecap="round">',
            f'<animate attributeName="points" values="{";".join(shapes[name])}"'
            f' dur="{_PLAYS_S}s" repeatCount="indefinite"/></polyline>',
        ]
    return drawn


def _side_view(model: ManipulatorModel, position: Any) -> str:
    """Return the arm as points: forwards to the right (with some of sideways), up is up."""
    bones = model.skeleton(position)
    path = np.concatenate([bones[:1, 0], bones[:, 1]])
    x, y, z = path.T
    across, down = 110 + 170 * (x + 0.35 * y), 270 - 170 * z
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(across, down, strict=True))


if __name__ == "__main__":
    found = {
        f"{LAW} on {NETWORK}": run_on_network(is_helped=False),
        "the same with compensation and a drive loop": run_on_network(is_helped=True),
    }
    Path(sys.argv[1]).write_text(picture(found), encoding="utf-8")
