"""Whether a control cycle fits on the bus: the arithmetic of the frames it takes."""

from __future__ import annotations

from bus_schema.can.frame_timing import longest_classical_bits
from bus_schema.configuration import ConfigurationError
from bus_schema.link.can_configuration import CanConfiguration

_RATES_HZ = (10_000, 8000, 5000, 4000, 2500, 2000, 1000, 800, 500, 400, 250, 200, 125, 100)
_LARGEST_SHARE = 0.95
"""Of the period: the rest is for heartbeats, status words and emergencies."""

_FRAMES: dict[str, tuple[int, tuple[int, ...]]] = {
    # data bytes of the frame that all drives share, and of those that each takes
    "cia402": (0, (8, 4)),
    "cansimple": (-1, (0, 8, 4)),
}
_NAMES = {
    "cia402": "SYNC + {n} × (TPDO 8 bytes + RPDO 4 bytes)",
    "cansimple": "{n} × (request + encoder estimates 8 bytes + torque 4 bytes)",
}


def cycle_bits(configuration: CanConfiguration, joints: int) -> int:
    """Most bits that the frames of one cycle can have, stuff bits included."""
    shared, each = _FRAMES[configuration.protocol]
    bits = joints * sum(longest_classical_bits(data_bytes) for data_bytes in each)
    return bits + (longest_classical_bits(shared) if shared >= 0 else 0)


def check_cycle_fits(configuration: CanConfiguration, joints: int, rate_hz: float) -> None:
    """Refuse a rate at which the frames of a cycle do not fit into its period.

    Raises:
        ConfigurationError: with the arithmetic, and the nearest rate that fits.
    """
    bits = cycle_bits(configuration, joints)
    needed_us = 1e6 * bits / configuration.bitrate
    period_us = 1e6 / rate_hz
    if needed_us <= _LARGEST_SHARE * period_us:
        return
    limit_hz = _LARGEST_SHARE * 1e6 / needed_us
    fitting = next((rate for rate in _RATES_HZ if rate <= limit_hz), int(limit_hz))
    frames = _NAMES[configuration.protocol].format(n=joints)
    raise ConfigurationError(
        "rate_hz", rate_hz,
        f"a cycle of {joints} drives takes {frames} = up to {bits} bits with stuffing ="
        f" {needed_us:.0f} µs at {configuration.bitrate // 1000} kbit/s, and of the period of"
        f" {period_us:.0f} µs {_LARGEST_SHARE:.0%} may be used; the nearest rate that fits is"
        f" {fitting} Hz (at most {limit_hz:.0f})",
    )  # fmt: skip
