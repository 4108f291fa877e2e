"""Sections ``link.uplink`` and ``link.downlink`` of a scenario: delay and loss per direction.

Parameters have the meaning of Linux's netem; definitions of our own are given here.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from bus_schema.configuration import NonNegative, Number, Positive, StrictModel, Whole

Probability = Annotated[Number, Field(ge=0, le=1)]
Distribution = Literal["uniform", "normal", "pareto", "empirical"]
PatternShape = Literal["square", "sawtooth", "falling", "random", "walk"]


class BurstLossConfiguration(StrictModel):
    """Gilbert–Elliott loss: a chain of a good and a bad state that takes one step per message.

    Either the chain is given, or its effect: ``mean_loss`` and ``mean_burst`` define a chain that
    loses everything in its bad state and nothing in its good one.

    Attributes:
        p: probability of going from good to bad.
        r: probability of going from bad to good; 1 / r is the mean stay in the bad state.
        loss_in_bad: share lost in the bad state (netem's 1-h).
        loss_in_good: share lost in the good state (netem's 1-k).
        mean_loss: share of all messages that are lost.
        mean_burst: mean number of messages lost one after the other, at least 1.
    """

    p: Probability | None = None
    r: Annotated[Number, Field(gt=0, le=1)] | None = None
    loss_in_bad: Probability = 1.0
    loss_in_good: Probability = 0.0
    mean_loss: Annotated[Number, Field(ge=0, lt=1)] | None = None
    mean_burst: Annotated[Number, Field(ge=1)] | None = None

    @model_validator(mode="after")
    def _check_form(self) -> BurstLossConfiguration:
        chain, means = (self.p, self.r), (self.mean_loss, self.mean_burst)
        given = [None not in pair for pair in (chain, means)]
        if sum(given) != 1 or any(value is not None for value in (chain if given[1] else means)):
            raise ValueError("p and r, or mean_loss and mean_burst")
        if given[1] and (self.loss_in_bad, self.loss_in_good) != (1.0, 0.0):
            raise ValueError("without loss_in_bad and loss_in_good if it has mean_loss")
        if self.chain[0] > 1.0:
            raise ValueError("a mean_loss of at most mean_burst / (mean_burst + 1)")
        return self

    @property
    def chain(self) -> tuple[float, float, float, float]:
        """p, r, loss in the bad state, loss in the good state."""
        if self.p is not None and self.r is not None:
            return self.p, self.r, self.loss_in_bad, self.loss_in_good
        loss, burst = self.mean_loss or 0.0, self.mean_burst or 1.0
        return loss / (1.0 - loss) / burst, 1.0 / burst, 1.0, 0.0


class ChangeableConditions(StrictModel):
    """Conditions that a schedule can change; None leaves a condition as it was."""

    delay_ms: NonNegative | None = None
    jitter_ms: NonNegative | None = None
    correlation: Probability | None = None
    loss: Probability | None = None
    burst_loss: BurstLossConfiguration | None = None
    duplicate: Probability | None = None
    rate_kbit_s: Positive | None = None


class Step(ChangeableConditions):
    """A sudden change."""

    kind: Literal["step"]
    at_s: NonNegative

    @property
    def end_s(self) -> float:
        return self.at_s


class Ramp(ChangeableConditions):
    """A gradual change, linear in time (for a rate: in the time that a bit takes)."""

    kind: Literal["ramp"]
    at_s: NonNegative
    for_s: Positive

    @property
    def end_s(self) -> float:
        return self.at_s + self.for_s


class Outage(StrictModel):
    """A period in which everything sent is lost; it may overlap a ramp."""

    kind: Literal["outage"]
    at_s: NonNegative
    for_s: Positive


ScheduleEntry = Annotated[Step | Ramp | Outage, Field(discriminator="kind")]


class TraceConfiguration(StrictModel):
    """A measured network, replayed in time order.

    Attributes:
        file: CSV or Parquet with columns ``time_s`` and ``delay_ms`` (empty: lost), and perhaps
            ``lost`` and ``size``; a path as for `distribution_file`, or the name of a shipped
            trace. With ``round_trip_ms``, each direction takes half, and both play together.
        start_s: time in the trace at which a run begins; by default drawn from the scenario's seed.
        loop: begin again at the end, where the trace resembles its end; otherwise the run must not
            last longer, and `start_s` is given.
        interpolation: ``hold`` gives a message the delay of the last one in the trace that was
            sent before it, ``linear`` one between those of its neighbours.
        scale: factor on the delays of the trace.
        offset_ms: added to them.
    """

    file: str
    start_s: NonNegative | None = None
    loop: bool = True
    interpolation: Literal["hold", "linear"] = "hold"
    scale: NonNegative = 1.0
    offset_ms: Number = 0.0

    @field_validator("loop")
    @classmethod
    def _check_loop(cls, loop: bool, info: ValidationInfo) -> bool:
        if not loop and "start_s" in info.data and info.data["start_s"] is None:
            raise ValueError("true unless start_s is given")
        return loop


class PatternConfiguration(StrictModel):
    """Pattern of a direction's delay over the run's time; ``delay_ms`` is the largest one.

    Attributes:
        shape: ``square``: the smallest delay, then the largest for the last part of a period;
            ``sawtooth``: rises from the smallest to the largest, then drops; ``falling``: the
            reverse; ``random``: another delay in each period; ``walk``: linear between random ones.
        period_ms: length of a period.
        duty: share of a period that has the largest delay, for ``square``.
        phase_ms: time in the first period at which the run begins.
        least_ms: the smallest delay, or ``delay_ms`` if that is smaller.
        seed: seed of ``random`` and ``walk``; the scenario's seed does not change a pattern.
    """

    shape: PatternShape
    period_ms: Annotated[Number, Field(ge=1e-3)]
    duty: Annotated[Number, Field(gt=0, lt=1)] = 0.5
    phase_ms: NonNegative = 0.0
    least_ms: NonNegative = 0.0
    seed: Annotated[Whole, Field(ge=0)] = 1

    @model_validator(mode="after")
    def _check_effect(self) -> PatternConfiguration:
        """Refuse values without effect."""
        if self.shape != "square" and self.duty != 0.5:
            raise ValueError("without duty unless shape is 'square'")
        if self.shape not in ("random", "walk") and self.seed != 1:
            raise ValueError("without seed unless shape is 'random' or 'walk'")
        return self


class ChannelConfiguration(StrictModel):
    """One direction of the link: plant to controller, or controller to plant.

    Attributes:
        delay_ms: delay of every message; the largest one if there is a `pattern`.
        pattern: how this delay varies, between ``least_ms`` and ``delay_ms``.
        distribution: how jitter is distributed. ``uniform``: ± jitter_ms; ``normal`` and
            ``pareto`` (of shape 3, shifted to mean zero): standard deviation jitter_ms;
            ``empirical``: a delay drawn from `distribution_file`. A negative sum is no delay.
        distribution_file: delays in ms, in a column ``delay_ms`` or one per line; a path from the
            scenario file, or from the current folder where a command sets it.
        trace: a measured network, whose delays and losses come on top of the others.
        jitter_ms: scale of the distribution.
        correlation: correlation of the jitter of neighbouring messages.
        loss: probability that a message is lost, independent of the others.
        burst_loss: loss in bursts.
        duplicate: probability that a message arrives twice; the copy has its own delay.
        reorder: let messages overtake each other; otherwise one waits for those sent before it.
        rate_kbit_s: bandwidth for payloads; messages are transmitted one after the other.
        schedule: changes on the run's clock, in the order of ``at_s``.
    """

    delay_ms: NonNegative = 0.0
    pattern: PatternConfiguration | None = None
    distribution: Distribution = "uniform"
    distribution_file: Annotated[str | None, Field(validate_default=True)] = None
    trace: TraceConfiguration | None = None
    jitter_ms: NonNegative = 0.0
    correlation: Probability = 0.0
    loss: Probability = 0.0
    burst_loss: BurstLossConfiguration | None = None
    duplicate: Probability = 0.0
    reorder: bool = False
    rate_kbit_s: Positive | None = None
    schedule: tuple[ScheduleEntry, ...] = ()

    @property
    def delay_ns(self) -> int:
        return round(self.delay_ms * 1e6)

    @property
    def is_constant(self) -> bool:
        """Whether this direction does nothing but delay all messages equally."""
        return not (
            self.jitter_ms or self.loss or self.burst_loss or self.duplicate or self.rate_kbit_s
            or self.schedule or self.distribution == "empirical" or self.trace
            or self.pattern
        )  # fmt: skip

    @property
    def has_duplicates(self) -> bool:
        """Whether messages arrive twice, at any time of the run."""
        steps = (entry for entry in self.schedule if not isinstance(entry, Outage))
        return any(each.duplicate for each in (self, *steps))

    @field_validator("distribution_file")
    @classmethod
    def _check_file(cls, file: str | None, info: ValidationInfo) -> str | None:
        is_empirical = info.data.get("distribution") == "empirical"
        if is_empirical and file is None:
            raise ValueError("a file of delays in ms if distribution is 'empirical'")
        if file is not None and "distribution" in info.data and not is_empirical:
            raise ValueError("left out unless distribution is 'empirical'")
        return file

    @field_validator("jitter_ms")
    @classmethod
    def _check_jitter(cls, jitter_ms: float, info: ValidationInfo) -> float:
        if jitter_ms and info.data.get("distribution") == "empirical":
            raise ValueError(
                "left at 0 if distribution is 'empirical': the file includes the jitter"
            )
        return jitter_ms

    @field_validator("schedule")
    @classmethod
    def _check_schedule(
        cls, schedule: tuple[ScheduleEntry, ...], info: ValidationInfo
    ) -> tuple[ScheduleEntry, ...]:
        previous_s, changed_until_s = -1.0, 0.0
        for entry in schedule:
            if entry.at_s <= previous_s:
                raise ValueError(f"in increasing order of at_s; {entry.at_s} follows {previous_s}")
            previous_s = entry.at_s
            if isinstance(entry, Outage):
                continue
            if entry.at_s < changed_until_s:
                raise ValueError(f"without a change before the ramp ends at {changed_until_s} s")
            if entry.jitter_ms is not None and info.data.get("distribution") == "empirical":
                raise ValueError("without jitter_ms if distribution is 'empirical'")
            changed_until_s = entry.end_s
        return schedule
