"""Files of an identified arm: URDF, scenario, ranges from the posterior, and summary."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np

from bus_schema.arrays import Matrix, Vector
from bus_schema.foreign_text import shortened
from bus_schema.recording.atomic_files import write_json, write_whole
from bus_schema.robot_description import load_robot
from bus_schema.urdf.checks import joint_ends
from deploy.measure.identify.base_parameters import Interval, base_values, link_masses
from deploy.measure.identify.identified import Identified
from deploy.measure.identify.problem import bodies_of
from deploy.measure.identify.regression import (
    COULOMB,
    LOAD,
    ROTOR,
    STRIBECK,
    STRIBECK_VELOCITY_RAD_S,
    TERMS,
    VISCOUS,
)
from deploy.scenario.starter import ESTIMATED, starter_scenario
from deploy.scenario.yaml_files import ScenarioError, to_yaml

URDF, BEFORE, SCENARIO = "robot.urdf", "before.urdf", "scenario.yaml"
RANGES = "uncertainty.yaml"
KIND = "identify"
_DRAWS, _SEED = 200, 1
_UNSEEN = math.log(2.0)
"""Rotors that no log shows are drawn between half of their estimates and twice these."""
_RANGES_COMMENT = """\
# Draws from what the log says of this robot, so that friction, rotors and masses belong together.
# controller.model_scale stands for the masses: the arm keeps its file, and the nominal model errs.
"""


def check_is_free(folder: Path) -> None:
    """Refuse a folder where a result would replace a file of the user.

    Raises:
        ScenarioError: there is a file of that name.
    """
    for name in (URDF, BEFORE, SCENARIO, RANGES):
        if (folder / name).exists():
            raise ScenarioError(f"--out {folder}: {name} is there, and no result of identify")


def write_results(found: Identified, folder: Path) -> dict[str, Any]:
    """Write all files except the report into an existing folder; return the summary.

    Raises:
        OSError: a file cannot be written.
    """
    write_whole(folder / URDF, identified_urdf(found))
    write_whole(folder / BEFORE, found.robot.portable_urdf())
    write_whole(folder / SCENARIO, to_yaml(_scenario(found, folder)))
    write_whole(folder / RANGES, _RANGES_COMMENT + to_yaml(_ranges(found)))
    summary = {**summary_of(found, folder.name), "files": [URDF, BEFORE, RANGES]}
    write_json(folder / "summary.json", summary)
    return summary


def identified_urdf(found: Identified) -> str:
    """Return the robot's file with the identified inertials.

    Each goes to the link that a joint moves; links fixed to it have none, as it contains theirs.
    """
    root = ET.fromstring(found.robot.portable_urdf())
    links = {link.get("name", ""): link for link in root.findall("link")}
    ends = {joint.get("name", ""): joint_ends(joint) for joint in root.findall("joint")}
    moved_by = {ends[name][1]: name for name in found.model.body_joints}
    bodies = dict(zip(found.model.body_joints, found.fit.parameters.reshape(-1, 10), strict=True))
    parents = {child: parent for parent, child in ends.values()}
    for name, link in links.items():
        carrier = name
        while carrier not in moved_by and carrier in parents:
            carrier = parents[carrier]
        if carrier not in moved_by:
            continue  # fixed to the base
        for old in link.findall("inertial"):
            link.remove(old)
        if carrier == name:
            link.insert(0, _inertial(bodies[moved_by[name]]))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _inertial(parameters: Vector) -> ET.Element:
    """Return a body as URDF writes it: about its centre of mass."""
    mass, centre = float(parameters[0]), parameters[1:4] / parameters[0]
    xx, xy, yy, xz, yz, zz = parameters[4:]
    about_joint = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    tensor = about_joint - mass * ((centre @ centre) * np.eye(3) - np.outer(centre, centre))
    element = ET.Element("inertial")
    ET.SubElement(element, "origin", xyz=" ".join(f"{c:.9g}" for c in centre), rpy="0 0 0")
    ET.SubElement(element, "mass", value=f"{mass:.9g}")
    names = (("ixx", 0, 0), ("ixy", 0, 1), ("ixz", 0, 2), ("iyy", 1, 1), ("iyz", 1, 2),
             ("izz", 2, 2))  # fmt: skip
    ET.SubElement(element, "inertia", {name: f"{tensor[i, j]:.9g}" for name, i, j in names})
    return element


def _joint_values(found: Identified, terms: Matrix) -> dict[str, list[float]]:
    """Return keys of a scenario's plant with values per joint; all at least 0."""
    has_rotor = found.fit.has_term[:, ROTOR]
    rotors = np.where(has_rotor, terms[:, ROTOR], found.fit.prior.terms[:, ROTOR])
    load = terms[:, LOAD]
    values = {
        "plant.friction.coulomb_nm": terms[:, COULOMB],
        "plant.friction.viscous_nm_s": terms[:, VISCOUS],
        "plant.actuator.rotor_inertia_kg_m2": rotors,
    }
    if terms[:, STRIBECK].any():
        values["plant.friction.stribeck_nm"] = terms[:, STRIBECK]
    if load.any():  # the plant's share is of the actuator's torque, friction included
        values["plant.friction.load_share"] = load / (1.0 + load)
    return {key: [float(f"{max(v, 0.0):.5g}") for v in value] for key, value in values.items()}


def _scenario(found: Identified, folder: Path) -> dict[str, Any]:
    """Return a first scenario of the identified arm, which must be written already."""
    values = starter_scenario(load_robot(folder / URDF))
    values["name"] = "identified"
    values["robot"]["urdf"] = URDF
    if found.robot.held:
        values["robot"]["joints"] = list(found.robot.joint_names)
    logs = ", ".join([*found.logs[0], *found.logs[1]])
    estimated = np.array(found.robot.joint_names)[~found.fit.has_term[:, ROTOR]]
    unseen = f"; rotor inertia {ESTIMATED} of {', '.join(estimated)}" if estimated.size else ""
    values["robot"]["drive_data"] = shortened(f"identified from {logs}") + unseen
    of_plant = _joint_values(found, found.fit.terms)
    friction: dict[str, Any] = {
        key.rpartition(".")[2]: value for key, value in of_plant.items() if "friction" in key
    }
    friction["smoothing_velocity_rad_s"] = found.fit.smoothing_rad_s.tolist()
    if "stribeck_nm" in friction:
        friction["stribeck_velocity_rad_s"] = STRIBECK_VELOCITY_RAD_S
    values["plant"]["friction"] = friction
    actuator = values["plant"]["actuator"]
    actuator["rotor_inertia_kg_m2"] = of_plant["plant.actuator.rotor_inertia_kg_m2"]
    ahead_s, sd_s = found.fit.delay_s
    if ahead_s > 3.0 * sd_s and ahead_s > 1e-3:
        actuator["lag_ms"] = float(f"{1e3 * ahead_s:.3g}")
    if found.dead_time_s is not None and found.dead_time_s[0] > 1e-4:
        values["link"] = {"downlink": {"delay_ms": float(f"{1e3 * found.dead_time_s[0]:.3g}")}}
    return values


def _ranges(found: Identified) -> dict[str, Any]:
    """Return draws from the posterior as an uncertainty section."""
    fit = found.fit
    random, size = np.random.default_rng(_SEED), fit.bodies.size
    mean = np.concatenate([fit.bodies.ravel(), fit.terms[fit.has_term], fit.delay_s[:1]])
    drawn = random.multivariate_normal(mean, fit.covariance, _DRAWS, method="eigh")
    regressors = np.concatenate([trial.bodies for trial in found.training]).reshape(-1, size)
    own = regressors @ fit.parameters
    scales, rows = list[list[float]](), list[dict[str, list[float]]]()
    for each in drawn:
        terms = np.zeros(fit.terms.shape)
        terms[fit.has_term] = each[size:-1]
        values = _joint_values(found, terms)
        key = "plant.actuator.rotor_inertia_kg_m2"
        factors = np.exp(random.uniform(-_UNSEEN, _UNSEEN, len(terms)))
        factors[fit.has_term[:, ROTOR]] = 1.0
        values[key] = [float(f"{v:.5g}") for v in np.array(values[key]) * factors]
        rows.append(values)
        truth = regressors @ bodies_of(each[:size])[0]
        scales.append([float(f"{own @ own / (own @ truth):.5g}")])
    keys = _joint_values(found, fit.terms)
    per_joint = {
        key: {"distribution": "row", "per": "joint", "rows": [row[key] for row in rows]}
        for key in keys
    }
    return {**per_joint, "controller.model_scale": {"distribution": "row", "rows": scales}}


def summary_of(found: Identified, name: str) -> dict[str, Any]:
    """Return all numbers: joints, bodies, base parameters, and what was not seen."""
    errors, before = found.errors(), found.errors(before=True)
    joints = []
    for joint, joint_name in enumerate(found.robot.joint_names):
        entry: dict[str, Any] = {
            "name": joint_name,
            "relative_error_held_out": float(errors[joint]),
            "relative_error_before": float(before[joint]),
            "smoothing_velocity_rad_s": float(found.fit.smoothing_rad_s[joint]),
        }
        for term, key in enumerate(TERMS):
            if found.fit.has_term[joint, term] or term == ROTOR:
                entry[key] = _plain(found.term(joint, term))
        if found.constants is not None:
            half = float(found.constants.shown_half[joint])
            value = float(found.constants.nm_per_a[joint])
            entry["nm_per_a"] = {"value": value, "half_95": None if math.isnan(half) else half}
        joints.append(entry)
    base = zip(found.group.names, base_values(found.fit, found.group), strict=True)
    return {
        "kind": KIND, "name": name, "completed": True, "robot": found.robot.path.name,
        "logs": found.logs[0], "tests": found.logs[1],
        "duration_s": float(sum(len(t.times_s) * np.median(np.diff(t.times_s))
                                for t in found.training)),
        "cutoff_hz": found.training[0].samples.cutoff_hz,
        "joints": joints,
        "base_parameters": [{"name": name, **_plain(each)} for name, each in base],
        "bodies": [
            {"joint": each, "mass_kg": mass.value, "mass_half_95": mass.half,
             "mass_before_kg": mass.before, "mass_seen": mass.seen,
             "centre_m": (p[1:4] / p[0]).tolist()}
            for each, p, mass in zip(found.model.body_joints,
                                     found.fit.parameters.reshape(-1, 10),
                                     link_masses(found.fit), strict=True)
        ],
        "torque_ahead_ms": _milliseconds((found.fit.delay_s[0], 1.96 * found.fit.delay_s[1])),
        "dead_time_ms": _milliseconds(found.dead_time_s),
        "payload": _payload(found),
        "not_seen": found.not_seen, "notes": found.notes, "warnings": found.warnings,
        "intervals": found.interval,
    }  # fmt: skip


def _plain(value: Interval) -> dict[str, Any]:
    half = None if math.isnan(value.half) else value.half
    return {"value": value.value, "half_95": half, "before": value.before, "seen": value.seen}


def _milliseconds(value: tuple[float, float] | None) -> dict[str, float] | None:
    return value and {"value": 1e3 * value[0], "half_95": 1e3 * value[1]}


def _payload(found: Identified) -> dict[str, Any] | None:
    if found.payload is None:
        return None
    (kg, half), centre, constants = found.payload
    return {
        "kg": kg, "half_95": half, "centre_m": centre.tolist(),
        "nm_per_a_by_payload": None if constants is None else
        [None if math.isnan(each) else each for each in constants.tolist()],
    }  # fmt: skip
