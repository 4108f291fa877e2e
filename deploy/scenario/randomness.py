"""Whether chance has a part in a scenario: only then does another seed give another run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bus_schema.link.channel_configuration import ChangeableConditions, ChannelConfiguration
from deploy.scenario.setup import Setup
from plant_emulator.configuration import NoiseTerm, PlantConfiguration


def seeds_that_differ(setup: Setup, seeds: Sequence[int]) -> list[int]:
    """Of these seeds, those that give runs of their own: all, or the first."""
    return list(seeds) if is_random(setup) else list(seeds[:1])


def is_random(setup: Setup) -> bool:
    """Whether a scenario draws random numbers; where that is not certain, it counts as if.

    A law of one's own is given no seed.
    """
    scenario, link = setup.scenario, setup.scenario.link
    return (
        setup.link_kind.draws_random_numbers
        or bool(scenario.faults)
        or _draws(link.uplink)
        or _draws(link.downlink)
        or _is_noisy(scenario.plant)
    )


def _draws(channel: ChannelConfiguration) -> bool:
    stages: list[ChannelConfiguration | ChangeableConditions] = [channel]
    stages += [entry for entry in channel.schedule if isinstance(entry, ChangeableConditions)]
    return channel.distribution == "empirical" or any(
        stage.jitter_ms or stage.loss or stage.burst_loss or stage.duplicate for stage in stages
    )


def _is_noisy(plant: PlantConfiguration) -> bool:
    encoders = (plant.encoder, plant.drive_feedback.encoder)
    return any(np.any(encoder.velocity_noise_rad_s) for encoder in encoders) or any(
        isinstance(term, NoiseTerm) for term in plant.disturbance.terms
    )
