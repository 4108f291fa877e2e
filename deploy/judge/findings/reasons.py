"""Reasons why a run does not hold, with their words: everything that names one reads them here."""

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
    UNSTABLE = (
        "unstable", "as an error of an unstable loop grew",
        "the error grew exponentially without a delay, or without swinging, which no delay causes:"
        " look at signs and gains of the law",
    )  # fmt: skip
    GROWING = (
        "growing", "as an oscillation grew",
        "an oscillation grew: the delay is too long for the gains",
    )  # fmt: skip
    VIBRATION = (
        "vibration", "as its torque swung between its limits",
        "the torque swung from one limit to the other and back",
    )  # fmt: skip
    LATE = (
        "late command", "after a command that was much later than usual",
        "shortly before, a command in force was much older than usual",
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
        "torques were at their limits for most of the time before",
    )  # fmt: skip
    LAG = (
        "lag", "behind the reference, in proportion to its speed",
        "the error was proportional to the reference's speed: the arm follows a constant time"
        " behind",
    )  # fmt: skip
    SLOW = (
        "friction or model", "slowly, as by friction or an error of the model",
        "anything else, a slow error",
    )  # fmt: skip
