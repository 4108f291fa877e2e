"""A picture of measured and predicted torques of an arm that was identified from its log.

    python -m scripts.experiments.identified_torques PICTURE.svg --robot FILE LOG… [--test LOG]
        [--link-side] [--seconds S]

It shows the first seconds that were not fitted, a row for each joint: the measured torque, that of
the identified arm, and that of the robot's file with friction and rotors estimated. `identify`
itself writes the same, to zoom in, into its report. A picture holds the values of the log: ask its
owner before you publish it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from bus_schema.arrays import Vector
from bus_schema.robot_description import load_robot
from deploy.measure.identify.identification import Wishes, identify
from deploy.measure.identify.identified import Identified
from deploy.measure.identify.quality import predicted_before
from deploy.scenario.referenced_files import find_urdf

_WIDTH, _ROW, _LEFT, _TOP = 760, 78, 60, 26
_POINTS = 500
_LINES = (("measured", "#999", 3.0), ("robot's file", "#c33", 0.8), ("identified", "#06c", 1.1))


def picture(found: Identified, seconds: float) -> str:
    """Return an SVG of the first held-out motion."""
    trial, joints = found.held_out[0], found.robot.joint_names
    times_s = trial.times_s - trial.times_s[0]
    shown = np.flatnonzero(times_s <= seconds)[:: max(1, int((times_s <= seconds).sum() / _POINTS))]
    curves = (trial.torque * found.fit.constants, predicted_before(found.fit, trial),
              found.fit.predicted(trial))  # fmt: skip
    height = _TOP + _ROW * len(joints) + 18
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{_WIDTH}" height="{height}"'
        ' font-family="sans-serif" font-size="11">',
        '<rect width="100%" height="100%" fill="white"/>',
    ]
    for place, (label, colour, _) in enumerate(_LINES):
        parts.append(f'<text x="{_LEFT + 110 * place}" y="16" fill="{colour}">{label}</text>')
    for joint, (name, error) in enumerate(zip(joints, found.errors(), strict=True)):
        own = [curve[shown, joint] for curve in curves]
        low, high = float(np.min(own)), float(np.max(own))
        top = _TOP + _ROW * joint
        parts += [
            f'<text x="{_LEFT + 4}" y="{top + 10}">{name}: error {100 * error:.1f} %</text>',
            f'<text x="4" y="{top + 24}">{high:.3g} N m</text>',
            f'<text x="4" y="{top + _ROW - 8}">{low:.3g}</text>',
        ]
        for values, (_, colour, width) in zip(own, _LINES, strict=True):
            points = _points(times_s[shown] / seconds, (values - low) / (high - low), top)
            style = f'fill="none" stroke="{colour}" stroke-width="{width}"'
            parts.append(f'<polyline points="{points}" {style}/>')
    parts.append(f'<text x="{_WIDTH - 90}" y="{height - 5}">{seconds:g} s</text>')
    return "\n".join([*parts, "</svg>\n"])


def _points(across: Vector, up: Vector, top: int) -> str:
    x = _LEFT + (_WIDTH - _LEFT - 8) * across
    y = top + _ROW - 8 - (_ROW - 22) * up
    return " ".join(f"{a:.0f},{b:.1f}" for a, b in zip(x, y, strict=True))


def main() -> None:
    """Identify, and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture", type=Path)
    parser.add_argument("logs", type=Path, nargs="+")
    parser.add_argument("--robot", required=True)
    parser.add_argument("--test", type=Path, action="append", default=[])
    parser.add_argument("--link-side", action="store_true")
    parser.add_argument("--seconds", type=float, default=10.0)
    given = parser.parse_args()
    robot = load_robot(find_urdf(given.robot, Path.cwd()))
    found = identify(given.logs, given.test, None, robot, Wishes(link_side=given.link_side))
    given.picture.write_text(picture(found, given.seconds), encoding="utf-8")
    print(", ".join(f"{100 * each:.1f} %" for each in found.errors()))


if __name__ == "__main__":
    main()
