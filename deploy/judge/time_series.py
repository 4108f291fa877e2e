"""Values of a run over time, as flat columns for tables of other programs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bus_schema.messages import topics
from bus_schema.messages.topics import Topic
from controller.reference import sample_positions
from deploy.judge.run_data import RunData, stamps_s

Columns = dict[str, NDArray[np.generic]]
"""Arrays of shape (rows,) by name."""

TRACKING = "tracking"
"""The series without a topic: the judged values, on the plant's ticks."""
_TOPICS: dict[str, Topic] = {
    topic.name: topic
    for topic in topics.TOPICS
    if topic not in (topics.RUN_EVENTS, topics.JOINT_REFERENCE)  # `tracking` has the reference
}
SERIES = (TRACKING, *_TOPICS)
"""All series, by name."""


def series(run: RunData, name: str = TRACKING) -> Columns:
    """Return one of `SERIES`: ``time_s``, and columns of values, ``<field>.<joint>`` per joint.

    ``tracking`` has the values behind the verdict, at every tick of the plant: ``position`` and
    ``velocity`` (true values), ``reference``, ``error``, ``upper_bound`` and ``lower_bound`` (the
    ends of the funnel, the lower one negative), in rad and rad/s. The others have the fields of
    their messages, with the units of ``bus_schema/messages/msg``.

    Raises:
        KeyError: there is no such series.
    """
    return _tracking(run) if name == TRACKING else _of_topic(run, _TOPICS[name])


def _tracking(run: RunData) -> Columns:
    truth, joints = run.tables[topics.PLANT_TRUTH.name], run.setup.robot.joint_names
    times_s = stamps_s(truth)
    upper, lower = run.setup.funnel.bounds(times_s)
    by_joint = {
        "reference": sample_positions(run.setup.reference, times_s, len(joints)),
        "position": truth["position"],
        "velocity": truth["velocity"],
        "error": run.true_errors_rad,
        "upper_bound": upper,
        "lower_bound": lower,
    }
    columns: Columns = {"time_s": times_s}
    for field, values in by_joint.items():
        columns |= _columns(field, values, joints)
    return columns


def _of_topic(run: RunData, topic: Topic) -> Columns:
    table, joints = run.tables[topic.name], run.setup.robot.joint_names
    columns: Columns = {"time_s": stamps_s(table)}
    for field in table.dtype.names or ():
        if not field.startswith("header."):
            columns |= _columns(field, table[field], joints)
    return columns


def _columns(field: str, values: NDArray[np.generic], joints: tuple[str, ...]) -> Columns:
    """Return a field's columns: one, or one for each joint or element."""
    if values.ndim == 1:
        return {field: values}
    names = joints if values.shape[1] == len(joints) else map(str, range(values.shape[1]))
    return {f"{field}.{name}": values[:, i] for i, name in enumerate(names)}
