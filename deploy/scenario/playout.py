"""Play-out: commands act on arrival, after a fixed time, or when they say so."""

from __future__ import annotations

import math

from bus_schema.configuration import ConfigurationError
from bus_schema.link.channel_configuration import ChannelConfiguration
from bus_schema.link.configuration import AUTO, LinkConfiguration
from bus_schema.runtime.clock import TickGrid
from controller.compensation.command_timeline import (
    GROWS_BY,
    LONGEST_HORIZON_NS,
    PIECES,
    HorizonSettings,
)
from controller.compensation.configuration import LONGEST_HORIZON_MS
from deploy.scenario.checked_scenario import CheckedScenario
from deploy.scenario.held_arm import held_arm_ceiling_ms
from plant_emulator.channel.delay_range import (
    configured_delays_ns,
    largest_delay_ns,
    loses,
    loses_in_a_row,
    round_trip_ns,
    spare_at_start_ns,
)

EXPECTED = "controller.delay_compensation.expected_round_trip_ms"
"""Key that sets an automatic play-out time, from the start of a run."""
_IN_TIME, _IN_TIME_AT_START = 0.995, 0.75
"""Shares of the commands that arrive before they have to act."""
_OF_CEILING_AT_START, _OF_CEILING = 0.15, 0.4
"""Shares of the time that the arm can be held at its start, for a horizon at first and later.

Until the first command acts, the arm is held: with 40 % the three-joint arm loses a tenth of its
bound at the start, with 15 % a twenty-fifth. And an arm that can be held for long is slow enough to
be foreseen for long: it withstands rare late commands better than a longer horizon.
"""
_BRIDGE_MS = 200.0
"""Bridge of commands that may come late. A longer one follows a wrong model too far."""
_EASILY_HELD_NS = 200_000_000
"""That time of an arm that never leaves its bounds while it is held."""
_GROWS_BY_ON_NETWORK = 0.3
"""Growth of the horizon where delays vary at random: a burst may come soon."""


def resolved_link(setup: CheckedScenario) -> LinkConfiguration:
    """Return the section ``link`` with the play-out time that applies.

    Raises:
        ConfigurationError: it is ``auto``, but no command can say when it acts; or it is longer
            than what delay compensation predicts.
    """
    scenario = setup.scenario
    link = scenario.link
    controller = scenario.controller
    brings_status = setup.link_kind.brings_plant_status
    may_be_automatic = (
        controller.delay_compensation.enabled and controller.process is None and brings_status
    )
    if link.playout_ms is None:
        return link.model_copy(update={"playout_ms": AUTO if may_be_automatic else 0.0})
    if link.plays_automatically and not may_be_automatic:
        allowed = "a time in ms, unless controller.delay_compensation.enabled is true"
        if not brings_status:
            allowed = f"a time in ms with link.kind {link.kind}"
        elif controller.process is not None:
            allowed = "a time in ms with controller.process: its commands do not say when they act"
        raise ConfigurationError("link.playout_ms", AUTO, allowed)
    if controller.delay_compensation.enabled and link.playout_ns > LONGEST_HORIZON_NS:
        allowed = f"must be at most {LONGEST_HORIZON_MS:g} with delay compensation"
        raise ConfigurationError("link.playout_ms", link.playout_ms, allowed)
    return link


def horizon_settings(setup: CheckedScenario, link: LinkConfiguration) -> HorizonSettings:
    """Return how the controller chooses the time from a state until its command acts.

    Args:
        setup: the scenario.
        link: its section ``link`` by `resolved_link`.
    """
    of_link, actuator = _of_link(setup, link), setup.scenario.plant.actuator
    actuator_ns = actuator.delay_steps(1e-9 * _grain_ns(setup)) * _grain_ns(setup)
    return of_link._replace(
        row_ticks=_row_ticks(setup, link, of_link),
        most_ns=min(of_link.most_ns + actuator_ns, LONGEST_HORIZON_NS),
        least_ns=of_link.least_ns + actuator_ns,
        first_ns=of_link.first_ns + actuator_ns,
        wanted_ns=of_link.wanted_ns + actuator_ns,
        actuator_ns=actuator_ns,
    )


def _grain_ns(setup: CheckedScenario) -> int:
    """Return the length of a physics step."""
    return setup.grid.period_ns // setup.grid.substeps


def _of_link(setup: CheckedScenario, link: LinkConfiguration) -> HorizonSettings:
    """Return these settings without the actuators' dead time."""
    expected_ms = setup.scenario.controller.delay_compensation.expected_round_trip_ms
    expected_ns = None if expected_ms is None else round(expected_ms * 1e6)
    if not link.plays_automatically:
        first_ns = link.emulated_round_trip_ns if expected_ns is None else expected_ns
        period_ns = setup.grid.period_ns
        return HorizonSettings(least_ns=link.playout_ns, first_ns=first_ns, tick_ns=period_ns)
    if expected_ns is None:
        first_ns, wanted_ns, grows_by = _emulated(setup, link)
    else:
        first_ns, wanted_ns, grows_by = expected_ns, expected_ns, GROWS_BY
    return HorizonSettings(
        first_ns=first_ns,
        wanted_ns=wanted_ns,
        most_ns=max(wanted_ns, _bearable_ns(setup, _OF_CEILING)),
        grows_by=grows_by,
        is_announced=True,
        reserve_ns=setup.grid.period_ns,
        tick_ns=setup.grid.period_ns,
        substeps=setup.grid.substeps,
    )


def playout_range_ns(
    link: LinkConfiguration, horizon: HorizonSettings, grid: TickGrid
) -> tuple[int, int]:
    """Return the time from a state until its torque acts, at the start of a run and later, ns.

    It has both values only where it is chosen automatically, for delays that vary. A command that
    comes late acts later.
    """
    if not link.plays_automatically:
        return link.playout_ns, link.playout_ns
    first_ns, later_ns = map(grid.next_substep_ns, (horizon.first_ns, horizon.wanted_ns))
    return min(first_ns, LONGEST_HORIZON_NS), min(later_ns, LONGEST_HORIZON_NS)


def levels(link: LinkConfiguration, horizon: HorizonSettings, grid: TickGrid) -> bool:
    """Whether every message of a run arrives before the play-out lets it act, at any time."""
    sides = link.uplink, link.downlink
    up_ns, down_ns = map(largest_delay_ns, sides)
    is_resent = link.transport == "tcp" and any(map(loses, sides))
    if up_ns is None or down_ns is None or is_resent:
        return False
    first_ns, later_ns = playout_range_ns(link, horizon, grid)
    spare_ns = 0
    if later_ns > first_ns:
        spare_ns = spare_at_start_ns(sides, GROWS_BY)
    return min(first_ns + spare_ns, later_ns) >= up_ns + down_ns


def _may_be_late(setup: CheckedScenario, link: LinkConfiguration, horizon: HorizonSettings) -> bool:
    """Whether commands may come too late, or several in a row not at all."""
    sides = link.uplink, link.downlink
    is_emulated = any(side != ChannelConfiguration() for side in sides)
    expected_ms = setup.scenario.controller.delay_compensation.expected_round_trip_ms
    if expected_ms is not None and not is_emulated:
        return True  # the delay of a real link, which may vary
    is_cut = any(fault.kind == "link_cut" for fault in setup.scenario.faults)
    return is_cut or any(map(loses_in_a_row, sides)) or not levels(link, horizon, setup.grid)


def _row_ticks(setup: CheckedScenario, link: LinkConfiguration, horizon: HorizonSettings) -> int:
    """Return how many ticks lie between two rows of a command; 0 without a bridge.

    Raises:
        ConfigurationError: there is a bridge, but commands cannot have rows.
    """
    compensation = setup.scenario.controller.delay_compensation
    given, bridge_ms = compensation.bridge_ms, 0.0
    if isinstance(given, float):
        bridge_ms = given
    elif horizon.is_announced and compensation.learns_model and _may_be_late(setup, link, horizon):
        bridge_ms = min(_BRIDGE_MS, setup.scenario.plant.command_timeout_ms)
        piece_ms = 1e-6 * PIECES * setup.grid.period_ns
        bridge_ms -= bridge_ms % piece_ms  # to whole ticks, and not beyond the time-out
    if bridge_ms and not horizon.is_announced:
        allowed = (
            f"must be 0 unless delay_compensation.enabled is true, with link.playout_ms {AUTO}"
        )
        key = "controller.delay_compensation.bridge_ms"
        raise ConfigurationError(key, bridge_ms, allowed, ["link.playout_ms"])
    return math.ceil(1e6 * bridge_ms / (PIECES * setup.grid.period_ns))


def _emulated(setup: CheckedScenario, link: LinkConfiguration) -> tuple[int, int, float]:
    """Return the horizon at the start, the one to reach, and how fast, for the emulated link.

    At the start, what the link's schedule adds later counts only where the horizon does not grow to
    it in time.
    """
    up_ns, down_ns = configured_delays_ns(link.uplink), configured_delays_ns(link.downlink)
    usual_ns, longest_ns = (
        round_trip_ns(up_ns, down_ns, share) for share in (_IN_TIME_AT_START, _IN_TIME)
    )
    spare_ns = spare_at_start_ns((link.uplink, link.downlink), GROWS_BY)
    if usual_ns == longest_ns:
        return longest_ns - spare_ns, longest_ns, GROWS_BY
    wanted_ns = min(longest_ns, max(usual_ns, _bearable_ns(setup, _OF_CEILING)))
    first_ns = max(usual_ns - spare_ns, _bearable_ns(setup, _OF_CEILING_AT_START))
    return min(wanted_ns - spare_ns, first_ns), wanted_ns, _GROWS_BY_ON_NETWORK


def _bearable_ns(setup: CheckedScenario, share: float) -> int:
    """Return a share of the time for which the arm can be held at its start."""
    ceiling_ms = held_arm_ceiling_ms(setup)
    return round(share * (_EASILY_HELD_NS if ceiling_ms is None else 1e6 * ceiling_ms))
