"""Sentences on a robot that has a controller of its own: how far behind it is, and its stops."""

from __future__ import annotations

from shlex import quote

from bus_schema.link.channel_configuration import ChannelConfiguration, Outage
from deploy.judge.findings.loss import is_mostly
from deploy.judge.findings.loss_reason import Reason
from deploy.judge.findings.remedies import FASTER, remedy_of
from deploy.judge.metrics import RunResult
from deploy.judge.motion.robot_lag import RobotLag, uncovered_lag_of
from deploy.judge.run_data import ROBOT_SERVER, RunData
from deploy.reports.runs.run_numbers import worst_lag_ms
from deploy.reports.tables import number

_OVER_TCP = {"servoj", "speedj"}
"""Interfaces of robots whose clients send commands over TCP."""
_MOST = 0.85
"""Of the tip's error; the rest of its square is less than a third."""


def sentences_on_the_robot(run: RunData, result: RunResult) -> list[str]:
    """Return how far a robot that takes targets is behind and why, and its own stops."""
    sentences = []
    for each in result.reflexes:
        of_joint = "" if each.joint is None else f" of {each.joint}"
        reflex = f"{each.kind}{of_joint}"
        sentences.append(f"The robot stopped at {each.time_s:.3f} s by its reflex {reflex}.")
    server = result.robot_server or {}
    if (first_s := server.get("first_target_s")) is not None:  # older recordings lack it
        until = f"from {first_s:.3f} to {server['last_target_s']:.3f} s"
        sentences.append(f"The client gave targets {until}; errors count from the first one on.")
    lag, parts = worst_lag_ms(result), result.robot_lag
    if lag is None or parts is None:
        return sentences
    joint = run.setup.robot.joint_names[result.lag_ms.index(lag)]
    way = "behind" if lag >= 0.0 else "ahead of"
    own_ms = 1e3 * uncovered_lag_of(run)
    is_own = lag > 0.0 and is_mostly(own_ms, lag)
    own = f"; the robot's own lag is {own_ms:.0f} ms" if is_own else ""
    tip = (
        ""
        if parts.tip_rms_mm is None
        else f", which alone is {number(parts.tip_rms_mm)} mm at the tip (RMS)"
    )
    sentences.append(
        f"Joints were {way} their reference by {number(abs(lag))} ms at most ({joint}){tip}{own}."
    )
    if is_own and result.loss is None:
        sentences += helps(Reason.OWN_LAG, run)
    return [*sentences, *_on_the_preview(parts), *_on_losses(run, result, parts)]


def helps(reason: Reason, run: RunData) -> list[str]:
    """Return what helps against a reason, as a sentence, where that is known."""
    remedy = remedy_of(reason, run.controller)
    if reason == Reason.OWN_LAG and run.setup.scenario.controller.preview_ms == 0.0:
        remedy = FASTER  # somebody wants no preview, as for teleoperation
    return [f"{remedy[0].upper()}{remedy[1:]}."] if remedy else []


def _on_the_preview(parts: RobotLag) -> list[str]:
    """Return how far ahead the controller reads, what for, and the lag of a source that cannot."""
    if not parts.preview_ms:
        return []
    own = f", {parts.own_ms:.0f} ms of it for the robot's own lag" if parts.own_ms else ""
    said = f"The controller read the reference {parts.preview_ms:.0f} ms ahead{own}."
    without_ms = parts.without_preview_ms
    late = "follow less closely" if without_ms is None else f"be {without_ms:.0f} ms behind"
    return [
        f"{said} With a source that cannot be read ahead, as in teleoperation, joints would {late}"
        " (controller.preview_ms: 0)."
    ]


def _on_losses(run: RunData, result: RunResult, parts: RobotLag) -> list[str]:
    """Return the part of lost messages in the tip's error, and how to tell what is unknown."""
    ways = (result.transport.uplink, result.transport.downlink)
    lost = sum((each.lost or 0) + (each.resent or 0) for each in ways)
    without, late_ms, late_mm = _without_losses(run), parts.late_ms, parts.late_tip_rms_mm
    if not lost or late_ms == 0.0:
        return []
    said = []
    if late_ms is not None:
        at_tip = "" if late_mm is None else f", about {number(late_mm)} mm at the tip (RMS)"
        messages = "1 message" if lost == 1 else f"{lost:,} messages"
        said.append(
            f"With {messages} lost, commands in force were {number(late_ms)} ms older on average"
            f" than without losses{at_tip}."
        )
    is_lag = (parts.tip_rms_mm or 0.0) >= _MOST * (result.tip_error_mm.rms or 0.0)
    if without and (late_mm is None or not is_lag):
        said.append(f"The same command with {without} shows which part of the error losses cause.")
    scenario, is_simulated = run.setup.scenario, run.link != ROBOT_SERVER
    is_udp = is_simulated and scenario.link.transport == "udp"
    if is_udp and scenario.plant.interface.kind in _OVER_TCP:
        said.append(
            "This link drops what is lost. Clients of such robots use TCP, which sends it again, so"
            " that all behind it is late: --set link.transport=tcp."
        )
    return said


def _without_losses(run: RunData) -> str:
    """Return the options that turn off the losses of the scenario's link; empty for others."""
    link = run.setup.scenario.link

    def of_way(name: str, way: ChannelConfiguration) -> list[str]:
        has_outages = bool(way.schedule) and all(isinstance(e, Outage) for e in way.schedule)
        keys = {"loss=0": way.loss, "burst_loss=null": way.burst_loss, "schedule=[]": has_outages}
        return [f"--set {quote(f'link.{name}.{key}')}" for key, is_set in keys.items() if is_set]

    return " ".join([*of_way("uplink", link.uplink), *of_way("downlink", link.downlink)])
