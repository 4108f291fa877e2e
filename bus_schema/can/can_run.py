"""What both sides of a run over CAN must know of it."""

from __future__ import annotations

from dataclasses import dataclass

from bus_schema.can.budget import check_cycle_fits
from bus_schema.configuration import ConfigurationError
from bus_schema.link.channel_configuration import ChannelConfiguration
from bus_schema.link.configuration import LinkConfiguration
from bus_schema.runtime.clock import TickGrid


@dataclass(frozen=True)
class CanRun:
    """What a run over CAN is like.

    Attributes:
        joint_names: names of the joints, in the order of the drives.
        link: section ``link`` of the scenario.
        grid: its ticks.
        ticks: how many there are.
        lockstep: virtual time, made by the cycles themselves.
    """

    joint_names: tuple[str, ...]
    link: LinkConfiguration
    grid: TickGrid
    ticks: int
    lockstep: bool

    def check(self) -> None:
        """Check what concerns the bus alone.

        Raises:
            ConfigurationError: a cycle does not fit on the bus, or messages are to be impaired.
        """
        joints, rate_hz = len(self.joint_names), 1e9 / self.grid.period_ns
        check_cycle_fits(self.link.can, joints, rate_hz)
        unheard_of = {"uplink": ChannelConfiguration(), "downlink": ChannelConfiguration(),
                      "playout_ms": 0.0}  # fmt: skip
        for name, default in unheard_of.items():
            given = getattr(self.link, name)
            if given != default:
                shown = given.model_dump(exclude_defaults=True) if name != "playout_ms" else given
                raise ConfigurationError(
                    f"link.{name}", shown,
                    "must be left out with link.kind = can: what a CAN bus does to frames is up to"
                    " link.can.bitrate and link.can.faults",
                )  # fmt: skip
