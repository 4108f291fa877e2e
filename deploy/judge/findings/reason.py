"""Reasons why a run leaves its funnel, in words."""

from __future__ import annotations

from enum import StrEnum


class Reason(StrEnum):
    """Reason why a run left its funnel, or does not hold although it kept it.

    Attributes:
        words: how the error left the funnel, as the end of a sentence about it.
        meaning: when a run has this reason, for the documentation.
    """

    words: str
    meaning: str

    def __new__(cls, name: str, words: str = "", meaning: str = "") -> Reason:
        """Create a member whose value is its name in rows and summaries."""
        member = str.__new__(cls, name)
        member._value_ = name
        member.words, member.meaning = words, meaning
        return member

    START = (
        "start", "before any command acted",
        "no command had acted yet: brakes held the arm while the reference moved",
    )  # fmt: skip
    INJECTED = (
        "injected fault", "after the injected fault",
        "a fault of the scenario had begun, and had not ended more than a second before",
    )  # fmt: skip
    STOPPED = (
        "reflex", "after the robot stopped by its reflex",
        "the robot's own controller had stopped the arm",
    )  # fmt: skip
    UNSTABLE = (
        "unstable", "as an error of an unstable loop grew",
        "the error grew exponentially without a delay, or without swinging, which no delay causes:"
        " look at signs and gains of the law",
    )  # fmt: skip
    GROWING = (
        "growing", "as an oscillation grew",
        "an oscillation grew: the delay is too long for the gains",
    )  # fmt: skip
    SWINGING = (
        "oscillation", "as it oscillated",
        "an error swung by half of its bound or more, faster than the reference, without growing:"
        " the delay is too long for the gains, or they are too high",
    )  # fmt: skip
    VIBRATION = (
        "vibration", "as its torque swung between its limits",
        "the torque swung from one limit to the other and back",
    )  # fmt: skip
    LATE = (
        "late command", "after a command that was much later than usual",
        "shortly before, a command in force was much older than usual",
    )  # fmt: skip
    JITTER = (
        "jitter", "as targets arrived irregularly",
        "targets reached the robot at uneven times, and the error swung faster than a loop around"
        " the robot does: a play-out (`link.playout_ms`) or a longer lookahead smooths them",
    )  # fmt: skip
    RAN_OUT = (
        "chunk ran out", "with nothing left to send",
        "the law's chunk had no row left, and the next one was not there yet: answers take too"
        " long for their length",
    )  # fmt: skip
    JUMPED = (
        "jump", "after a jump of its target between two chunks",
        "shortly before, a new chunk moved the joint's target by half of its bound or more",
    )  # fmt: skip
    OLD_ANSWER = (
        "old answer", "while an answer acted that was much older than usual",
        "shortly before, the observation behind the law's answer was much older than usual",
    )  # fmt: skip
    SATURATED = (
        "saturated", "with torques at their limits",
        "torques were at their limits for most of the time before, or the joint's own against the"
        " error for most of its rise: the arm or the motion is too heavy for its motors",
    )  # fmt: skip
    LAG = (
        "lag", "behind the reference, in proportion to its speed",
        "the arm moved as its reference did a constant time before: the error is proportional to"
        " the reference's speed",
    )  # fmt: skip
    OWN_LAG = (
        "robot's lag", "by the robot's own lag",
        "the robot's own controller follows late, and its lag explains most of the error. It is"
        " half to twice the lag found, or explains half or more of a slow error, or leaves the"
        " bounds by itself where a command came late. A law of torques has this lag as a delay in"
        " its loop, and loses within four times that lag. Read the reference ahead by it"
        " (`controller.preview_ms`), or make the robot's own loop faster",
    )  # fmt: skip
    GRAVITY = (
        "no gravity term", "under its weight, for which the law has no term",
        "a slow error in the direction of the joint's weight, larger than friction, disturbance and"
        " payload explain. The joint could hold the weight, but the law does not know it: compare"
        " the same law with a gravity term",
    )  # fmt: skip
    DELAY = (
        "delay", "sooner than the law could act, over a delay",
        "a slow error. Half of it or more arose after the state that the command in force answers,"
        " or it was there within two delays of the first command",
    )  # fmt: skip
    DELAY_OR_MODEL = (
        "delay or model", "slowly, as by friction or an error of the model over a delay",
        "a slow error, 5 % of which or more arose after the state that the command in force"
        " answers: a shorter delay or a better model makes it smaller",
    )  # fmt: skip
    SLOW = (
        "friction or model", "slowly, as by friction or an error of the model",
        "any other slow error, next to none of which is due to the delay",
    )  # fmt: skip
