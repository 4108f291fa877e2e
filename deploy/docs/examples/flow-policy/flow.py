"""A flow policy that continues its last chunk: real-time chunking by guidance.

Demonstrators followed a trajectory, but for smooth deviations of 10 mrad. Of such Gaussian chunks
the field that a flow policy learns is known in closed form, so nothing is trained here. Each chunk
begins with new noise: without guidance it leaves the one before.
"""

import numpy as np

from funnel_hil import Diagnostics

ACTIONS, PERIOD_S, STEPS = 16, 0.04, 10
DEVIATION_RAD, MEMORY_S = 0.01, 0.3
STRONGEST = 5.0
"""Largest weight of the guidance, β in arXiv 2506.07339."""
CENTRE_RAD = np.array([0.0, -1.2, 1.4, -1.8, -1.57, 0.0])
AMPLITUDE_RAD = np.array([0.5, 0.3, 0.4, 0.4, 0.5, 0.6])
FREQUENCY_RAD_S = np.array([0.8, 0.6, 0.7, 0.9, 1.0, 1.1])
LEAD_S = 0.03
AHEAD_S = PERIOD_S * np.arange(ACTIONS)[:, np.newaxis]
COVARIANCE = np.exp(-0.5 * ((AHEAD_S - AHEAD_S.T) / MEMORY_S) ** 2)
"""Of the deviations of a chunk, in units of their variance."""


def mean_of(time_s):
    """The demonstrated trajectory, rad, shape (actions, joints)."""
    return CENTRE_RAD + AMPLITUDE_RAD * np.cos(FREQUENCY_RAD_S * (time_s + LEAD_S + AHEAD_S))


def denoiser(tau):
    """Matrix that takes a sample at flow time tau to the chunk that the policy expects at 1."""
    noisy = tau**2 * COVARIANCE + (1.0 - tau) ** 2 * np.eye(ACTIONS)
    return tau * np.linalg.solve(noisy, COVARIANCE)


def strength(tau):
    """Weight of the guidance at flow time tau (equation 2 of the paper)."""
    if tau == 0.0:
        return STRONGEST
    left = 1.0 - tau
    return min(STRONGEST, left / tau * (left**2 + tau**2) / left**2)


def guided(velocity, expected, gradient, prefix, weights, tau):
    """Velocity of the flow that also moves the expected chunk to a prefix."""
    error = np.zeros_like(expected)
    error[: len(prefix)] = prefix - expected[: len(prefix)]
    return velocity + strength(tau) * gradient.T @ (weights[:, np.newaxis] * error)


class Policy:
    def __init__(self, model, seed=1):
        self.diagnostics, self.seed = Diagnostics(model.joints), seed
        self.reset()

    def reset(self):
        self.random, self.guidance = np.random.default_rng(self.seed), None

    def torque(self, tracking):
        return np.zeros_like(tracking.error)

    def guide(self, prefix, weights, delay_steps):  # noqa: ARG002 (the weights say it)
        """Receive what is left of the chunk in force, and how much each action counts."""
        self.guidance = prefix[:, 0], weights

    def target(self, tracking):
        mean = mean_of(tracking.time_s)
        sample, guidance = self.random.standard_normal(mean.shape), self.guidance
        self.guidance = None
        for tau in np.arange(STEPS) / STEPS:
            gradient = denoiser(tau)
            expected = gradient @ sample
            velocity = (expected - sample) / (1.0 - tau)
            if guidance is not None:
                prefix, weights = guidance
                deviation = (prefix - mean[: len(prefix)]) / DEVIATION_RAD
                velocity = guided(velocity, expected, gradient, deviation, weights, tau)
            sample = sample + velocity / STEPS
        position = mean + DEVIATION_RAD * sample
        return np.stack([position, np.gradient(position, PERIOD_S, axis=0)], axis=1)
