"""What of a link can be too much for a law."""

from __future__ import annotations

from dataclasses import dataclass

from deploy.study.definition import override


@dataclass(frozen=True)
class Quantity:
    """Something of the link that can be too much.

    Attributes:
        title: what it is called.
        unit: of its values.
        key: scenario key of each direction.
        share: what part of a value each direction gets.
        resolution: to which the margin is found.
        first: the first value tried.
        limit: the largest value tried.
    """

    title: str
    unit: str
    key: str
    share: float
    resolution: float
    first: float
    limit: float

    def overrides(self, value: float) -> list[str]:
        """What to set for a value."""
        return [
            override(f"link.{direction}.{self.key}", self.share * value)
            for direction in ("uplink", "downlink")
        ]


QUANTITIES = {
    "delay": Quantity("round trip", "ms", "delay_ms", 0.5, 0.5, 1.0, 128.0),
    "jitter": Quantity("jitter each way", "ms", "jitter_ms", 1.0, 0.5, 1.0, 32.0),
    "loss": Quantity("loss each way", "", "loss", 1.0, 0.005, 0.01, 0.9),
}
