"""The report of an identified arm: errors, torques, friction, parameters before and after."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go

from deploy.measure.identify.identified import Identified
from deploy.measure.identify.quality import predicted_before
from deploy.measure.identify.regression import (
    COULOMB,
    LOAD,
    ROTOR,
    STRIBECK,
    STRIBECK_VELOCITY_RAD_S,
    TERMS,
    VISCOUS,
)
from deploy.reports.figures import style
from deploy.reports.html import write_page
from deploy.reports.page import Cards, Fact, Page, Panel, ReportHead
from deploy.reports.tables import Cell, Column, Table, Value, number

_MOST_POINTS = 800
_LEAST_SHOWN = 0.02
_HEADINGS = {
    COULOMB: ("Coulomb", "N m"), VISCOUS: ("Viscous", "N m s/rad"), ROTOR: ("Rotor", "kg m²"),
    STRIBECK: ("Stribeck", "N m"), LOAD: ("Per load", ""),
}  # fmt: skip
_GOOD, _SHOWN_TERMS = 0.25, (COULOMB, VISCOUS, ROTOR, STRIBECK, LOAD)


def write_identify_report(found: Identified, summary: Mapping[str, Any], path: Path) -> None:
    """Write the report of an identified arm.

    Raises:
        OSError: it cannot be written.
    """
    errors = found.errors()
    worst = int(np.argmax(errors))
    head = ReportHead(
        "good" if errors.max() < _GOOD and not found.warnings else "mixed",
        f"Held-out error {100 * np.median(errors):.1f} % (median of the joints)",
        [
            *(f"Warning: {each}." for each in found.warnings),
            f"The largest is {100 * errors[worst]:.1f} %, of {found.robot.joint_names[worst]}."
            " Errors are RMS over the RMS of the measured torque, on data that were not fitted.",
            *(f"Not seen: {each}." for each in found.not_seen),
        ],
    )
    facts = [
        Fact("Robot", found.robot.path.name),
        Fact("Fitted", f"{', '.join(found.logs[0])} ({summary['duration_s']:.0f} s)"),
        Fact("Tested on", ", ".join(found.logs[1]) or "the end of each log"),
        Fact("Filter", f"{summary['cutoff_hz']:.1f} Hz", "without phase, on data and model alike"),
        *_more_facts(found, summary),
    ]
    notes = Table("Notes", [Column("Note", is_text=True)], [[each] for each in found.notes])
    page = Page(
        "identification", found.robot.path.stem, head, facts, lambda: PANELS, found,
        results=[Cards([error_table(found), joint_table(found)], "stacked"),
                 Cards([notes] if found.notes else [], "stacked"),
                 Cards([_mass_table(summary), _base_table(summary)], "stacked")],
    )  # fmt: skip
    write_page(path, page)


def _more_facts(found: Identified, summary: Mapping[str, Any]) -> list[Fact]:
    facts = []
    for key, label in (
        ("torque_ahead_ms", "Torque ahead of motion"),
        ("dead_time_ms", "Dead time"),
    ):
        if (value := summary[key]) is not None:
            facts.append(Fact(label, f"{value['value']:.1f} ± {value['half_95']:.1f} ms"))
    if found.payload is not None:
        kg, half = found.payload.kg
        facts.append(Fact("Payload", f"{kg:.2f} ± {half:.2f} kg"))
    return facts


def error_table(found: Identified) -> Table:
    """Return the errors on held-out data, of the file as it was and of the identified arm."""
    errors, before = found.errors(), found.errors(before=True)
    rows: list[list[Cell | Value]] = [
        [name, 100 * float(before[j]), 100 * float(errors[j])]
        for j, name in enumerate(found.robot.joint_names)
    ]
    columns = [Column("Joint", is_text=True), Column("File and estimates", "%"),
               Column("Identified", "%")]  # fmt: skip
    return Table("Error of the torque on held-out data", columns, rows)


def joint_table(found: Identified) -> Table:
    """Return friction and rotors of each joint with intervals."""
    shown = [t for t in _SHOWN_TERMS if found.fit.has_term[:, t].any() or t == ROTOR]
    columns = [Column("Joint", is_text=True), *(Column(*_HEADINGS[t]) for t in shown)]
    if found.constants is not None:
        columns.append(Column("Constant", "N m/A"))
    if by_payload := found.payload is not None and found.payload.nm_per_a is not None:
        columns.append(Column("by payload", "N m/A"))
    rows = []
    for joint, name in enumerate(found.robot.joint_names):
        row: list[Cell | Value] = [name]
        for term in shown:
            value = found.term(joint, term)
            known = found.fit.has_term[joint, term]
            if not known and term != ROTOR:
                row.append("–")
            else:
                row.append(_interval(value.value, value.half) + ("" if value.seen else " *"))
        if found.constants is not None:
            row.append(
                _interval(found.constants.nm_per_a[joint], found.constants.shown_half[joint])
            )
        if by_payload and found.payload is not None and found.payload.nm_per_a is not None:
            row.append(_interval(found.payload.nm_per_a[joint], math.nan))
        rows.append(row)
    note = f"* the log does not show it, or only together with its estimate; ± is {found.interval}."
    return Table("Friction and rotors", columns, rows, note)


def _interval(value: float, half: float) -> str:
    if math.isnan(value):
        return "–"
    return number(float(value)) + ("" if math.isnan(half) else f" ± {number(float(half))}")


def _mass_table(summary: Mapping[str, Any]) -> Table:
    half = f"± ({summary['intervals']})"
    columns = [Column("Moved by", is_text=True), Column("File", "kg"), Column("Identified", "kg"),
               Column(half, "kg"), Column("From the log", is_text=True)]  # fmt: skip
    rows = [[each["joint"], each["mass_before_kg"], each["mass_kg"], each["mass_half_95"],
             "yes" if each["mass_seen"] else "no"] for each in summary["bodies"]]  # fmt: skip
    note = (
        "No: torques show this mass only together with others, in the base parameters; its interval"
        " is what the file and the base parameters leave open."
    )
    return Table("Masses of the links", columns, rows, note)


def _base_table(summary: Mapping[str, Any]) -> Table:
    half = f"± ({summary['intervals']})"
    columns = [Column("First parameter", is_text=True), Column("File"), Column("Identified"),
               Column(half), Column("From the log", is_text=True)]  # fmt: skip
    rows = [[each["name"], each["before"], each["value"], each["half_95"],
             "yes" if each["seen"] else "no"] for each in summary["base_parameters"]]  # fmt: skip
    note = "The combinations of masses (kg), first moments (kg m) and inertias (kg m²) that act."
    return Table("Base parameters", columns, rows, note)


def _torques(found: Identified) -> go.Figure:
    """Return measured and predicted torques of the first held-out motion."""
    trial, names = found.held_out[0], found.robot.joint_names
    figure = style.joint_rows(names, "N m")
    measured = trial.torque * found.fit.constants
    lines = (
        ("measured", measured, dict(style.SHOULD_BE)),
        ("identified", found.fit.predicted(trial), None),
        ("file", predicted_before(found.fit, trial), {**style.DOTTED, "color": style.ALARM}),
    )  # fmt: skip
    for joint in range(len(names)):
        for label, values, look in lines:
            line = look or {"color": style.palette(joint), "width": 1.4}
            x, y = style.decimate(trial.times_s - trial.times_s[0], values[:, joint], _MOST_POINTS)
            figure.add_trace(
                go.Scatter(x=x, y=y, name=label, mode="lines", line=line,
                           showlegend=joint == 0, legendgroup=label),
                row=joint + 1, col=1,
            )  # fmt: skip
    style.put_legend_on_top(figure, 1)
    return figure


def _friction(found: Identified) -> go.Figure:
    """Return what is left of the measured torque without bodies and rotors, over the speed."""
    names, fit = found.robot.joint_names, found.fit
    figure = style.joint_rows(names, "N m")
    for joint in range(len(names)):
        points: list[Any] = []
        for trial in found.held_out:
            own = trial.joint_columns(fit.smoothing_rad_s, fit.parameters)[:, joint]
            left = trial.torque[:, joint] * fit.constants[joint]
            left = left - trial.bodies[:, joint] @ fit.parameters
            terms = fit.terms[joint].copy()
            terms[[COULOMB, VISCOUS, STRIBECK]] = 0.0
            points.append(np.column_stack(
                [trial.samples.velocity[trial.kept][:, joint], left - own @ terms]
            ))  # fmt: skip
        every = np.concatenate(points)
        every = every[:: max(1, len(every) // _MOST_POINTS)]
        speed = np.linspace(every[:, 0].min(), every[:, 0].max(), 201)
        dry = fit.terms[joint, COULOMB] + fit.terms[joint, STRIBECK] * np.exp(
            -((speed / STRIBECK_VELOCITY_RAD_S) ** 2)
        )
        curve = dry * np.tanh(speed / fit.smoothing_rad_s[joint])
        curve = curve + fit.terms[joint, VISCOUS] * speed
        dots = {"color": style.MUTED, "size": 3, "opacity": 0.5}
        figure.add_trace(
            go.Scatter(x=every[:, 0], y=every[:, 1], mode="markers", marker=dots, name="data"),
            row=joint + 1, col=1,
        )  # fmt: skip
        figure.add_trace(
            style.line(speed, curve, style.palette(joint), "friction", 2.0), row=joint + 1, col=1
        )
    figure.update_xaxes(title_text="speed (rad/s)", row=len(names))
    return figure


def _changes(found: Identified) -> go.Figure:
    """Return friction and rotors over their values before, with intervals, on a log axis."""
    names = found.robot.joint_names
    figure = style.new_figure(100 + 44 * len(names), "identified / file or estimate", legend=True)
    for index, term in enumerate((COULOMB, VISCOUS, ROTOR)):
        values = [found.term(joint, term) for joint in range(len(names))]
        shown = [(n, v) for n, v in zip(names, values, strict=True) if v.before > 0.0 and v.seen]
        ratio = [max(v.value / v.before, _LEAST_SHOWN) for _, v in shown]
        half = [v.half / v.before for _, v in shown]
        low = [min(h, r - 0.5 * _LEAST_SHOWN) for h, r in zip(half, ratio, strict=True)]
        figure.add_scatter(
            x=ratio, y=[n for n, _ in shown], mode="markers", name=TERMS[term],
            marker={"color": style.palette(index), "size": 9},
            error_x={"type": "data", "array": half, "arrayminus": low, "symmetric": False},
        )  # fmt: skip
    figure.update_xaxes(type="log")
    figure.update_yaxes(autorange="reversed", type="category", automargin=True)
    figure.add_vline(x=1.0, line=style.DOTTED)
    return figure


PANELS = (
    Panel("Torques", "torques", "Measured and predicted torque on held-out data", _torques,
          "The identified line should lie on the grey one; the dotted red line is the robot's file"
          " with estimated friction and rotors."),
    Panel("Friction", "friction", "Friction over speed on held-out data", _friction,
          "Points: measured torque without the torque of masses and rotors. Line: the friction of"
          " the scenario."),
    Panel("Before and after", "changes", "Friction and rotors over their values before", _changes,
          "1: as the file or the estimate for arms without data. Bars are the tables' intervals."),
)  # fmt: skip
