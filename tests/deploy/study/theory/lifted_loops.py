"""Sampled loops with a constant delay as one transition matrix, without the product's methods."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import expm

from deploy.study.theory.linear_law import LinearLaw
from deploy.study.theory.linear_plant import LinearPlant
from deploy.study.theory.sampled_loop import SampledLoop

GROWS = 1e-7
"""Per period: what grows more slowly is neither stable nor unstable in a test."""


@dataclass(frozen=True)
class LiftedLoop:
    """ẋ = A x + B u, y = C x, sampled with period h; s' = a s + b y, u = c s + d y."""

    plant: tuple[Any, Any, Any]
    law: tuple[Any, Any, Any, Any]
    period_s: float

    def roots(self, delay_s: float) -> Any:
        """Eigenvalues of the transition from (x, s, past torques) over a period."""
        _, inputs, outputs = self.plant
        a, b, c, d = self.law
        whole = int(delay_s // self.period_s)
        late_s = delay_s - whole * self.period_s
        step, held = self._over(self.period_s)
        new = self._over(self.period_s - late_s)[1]
        (states, joints), own = inputs.shape, len(a)
        size = states + own + (whole + 1) * joints
        row = np.eye(size)
        torque = np.zeros((joints, size))
        torque[:, :states], torque[:, states : states + own] = d @ outputs, c
        past = [torque, *np.split(row[states + own :], whole + 1)]
        total = np.zeros((size, size))
        total[:states, :states] = step
        total[:states] += new @ past[whole] + (held - new) @ past[whole + 1]
        total[states : states + own, :states] = b @ outputs
        total[states : states + own, states : states + own] = a
        total[states + own :] = np.vstack(past[:-1])
        return np.linalg.eigvals(total)

    def is_stable(self, delay_s: float) -> bool | None:
        """Whether all roots are inside the unit circle; None if it is too close to call."""
        beyond = abs(self.roots(delay_s)).max() - 1.0
        # A joint that nothing drives back, or an integral, may have a root at 1.
        return None if abs(beyond) < GROWS else bool(beyond < 0.0)

    def _over(self, time_s: float) -> tuple[Any, Any]:
        dynamics, inputs, _ = self.plant
        states, joints = inputs.shape
        both = np.zeros((states + joints, states + joints))
        both[:states, :states], both[:states, states:] = dynamics, inputs
        moved = expm(both * time_s)
        return moved[:states, :states], moved[:states, states:]


def random_loop(seed: int) -> tuple[SampledLoop, LiftedLoop]:
    """A loop by chance: rigid or with gears, gravity and friction, under one of four laws."""
    random = np.random.default_rng(seed)
    joints, period_s = int(random.integers(1, 4)), float(random.choice([1e-3, 2e-3, 4e-3, 1e-2]))
    dynamics, inputs, outputs, inertia = _plant(random, joints)
    moved = np.diag(inertia)
    speed, ratio = random.uniform(2.0, 30.0, joints), random.uniform(0.1, 1.2, joints)
    gains = -np.hstack([np.diag(moved * speed**2), np.diag(2.0 * ratio * speed * moved)])
    law, lifted = _law(random, gains, speed, period_s)
    plant = LinearPlant(dynamics, inputs, outputs, inertia)
    return (
        SampledLoop(plant, law, period_s),
        LiftedLoop((dynamics, inputs, outputs), lifted, period_s),
    )


def _plant(random, joints):
    root = random.normal(size=(joints, joints))
    links = root @ root.T / joints + 0.3 * np.eye(joints)
    gravity = np.diag(random.normal(size=joints) * 5.0) * (random.random() < 0.5)
    friction = np.diag(random.uniform(0.0, 5.0, joints)) * (random.random() < 0.5)
    none, seen = np.zeros((joints, joints)), 0
    if (kind := random.integers(0, 3)) == 0:
        inertia, stiffness, damping, total = links, gravity, friction, links
    else:
        rotors = random.uniform(0.05, 0.5, joints)
        reduced = rotors * np.diag(links) / (rotors + np.diag(links))
        resonance = 2.0 * np.pi * random.uniform(10.0, 300.0, joints)
        ratio = 10.0 ** random.uniform(-3.0, -1.0, joints)
        gear, damper = np.diag(reduced * resonance**2), np.diag(2 * ratio * resonance * reduced)
        inertia = np.block([[np.diag(rotors), none], [none, links]])
        stiffness = np.block([[gear, -gear], [-gear, gear + gravity]])
        damping = np.block([[damper + friction, -damper], [-damper, damper]])
        total, seen = links + np.diag(rotors), joints * int(kind == 2)
    masses = len(inertia)
    dynamics = np.zeros((2 * masses, 2 * masses))
    dynamics[:masses, masses:] = np.eye(masses)
    dynamics[masses:] = -np.linalg.solve(inertia, np.hstack([stiffness, damping]))
    inputs = np.vstack([np.zeros((masses, joints)), np.linalg.inv(inertia)[:, :joints]])
    rows = [*range(seen, seen + joints), *range(masses + seen, masses + seen + joints)]
    return dynamics, inputs, np.eye(2 * masses)[rows], total


def _law(random, gains, speed, period_s):
    """The law as the product has it, and as matrices."""
    joints, none = len(gains), np.zeros_like(gains)
    one = np.eye(joints)
    kind = random.integers(0, 4)
    if kind == 0:
        law = LinearLaw(gains[None], np.zeros(0))
        return law, (np.zeros((0, 0)), np.zeros((0, 2 * joints)), np.zeros((joints, 0)), gains)
    if kind == 1:  # an integral of the position
        share = np.diag(random.uniform(0.0, 0.3) * speed * period_s)
        summed = share @ np.where(np.arange(2 * joints) < joints, gains, 0.0)
        law = LinearLaw(np.array([gains + summed, -gains]), np.array([-1.0]))
        return law, (one, summed, one, gains + summed)
    if kind == 2:  # half of the damping from a rate of some ticks before
        late = int(random.integers(2, 12))
        half = 0.5 * np.where(np.arange(2 * joints) < joints, 0.0, gains)
        taps = np.array([gains - half, *[none] * (late - 1), half])
        shift = np.kron(np.eye(late, k=-1), np.eye(2 * joints))
        into = np.eye(late * 2 * joints, 2 * joints)
        out = np.kron(np.eye(1, late, late - 1), half)
        return LinearLaw(taps, np.zeros(0)), (shift, into, out, gains - half)
    keeps = random.uniform(0.2, 0.95)  # a filter
    law = LinearLaw((1.0 - keeps) * gains[None], np.array([-keeps]))
    direct = (1.0 - keeps) * gains
    return law, (keeps * one, keeps * direct, one, direct)
