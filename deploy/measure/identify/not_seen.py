"""Parameters that logs do not show, and motions that would."""

from __future__ import annotations

import math

import numpy as np

from deploy.measure.identify.base_parameters import link_masses
from deploy.measure.identify.identified import Identified
from deploy.measure.identify.regression import COULOMB, ROTOR, TERMS, VISCOUS
from deploy.measure.identify.signals import moves


def not_seen(found: Identified) -> list[str]:
    """Return a sentence for each parameter that the logs do not show."""
    sentences = list[str]()
    moving = np.any([moves(each.samples.velocity) for each in found.training], axis=0)
    for joint, name in enumerate(found.robot.joint_names):
        if not moving[joint]:
            sentences.append(f"all of {name}: move it faster than 0.05 rad/s in both directions")
            continue
        fastest = max(float(np.abs(t.samples.velocity[:, joint]).max()) for t in found.training)
        advice = {
            COULOMB: "move it slowly in both directions",
            ROTOR: "accelerate it more",
        }
        for term in (COULOMB, VISCOUS, ROTOR):
            if found.fit.has_term[joint, term] and not found.term(joint, term).seen:
                hint = advice.get(term, f"move it faster than {2.0 * fastest:.2g} rad/s")
                if term == ROTOR and found.group.of_rotor[joint].any():
                    hint = "no motion tells it from the inertia of the link, which is believed"
                sentences.append(f"{TERMS[term]} of {name}: {hint}")
        if found.constants is not None and math.isnan(found.constants.half[joint]):
            sentences.append(f"current constant of {name}: taken from the nearest joint")
        if not found.fit.has_term[joint, ROTOR]:
            sentences.append(f"rotor of {name}: its torques do not show it, it is an estimate")
    masses = zip(found.model.body_joints, link_masses(found.fit), strict=True)
    if alone := [name for name, mass in masses if not mass.seen]:
        sentences.append(
            f"mass of the link of {', '.join(alone)} alone: torques show it together with others"
        )
    sentences.append("elasticity of the gears: needs motion near their resonance")
    return sentences
