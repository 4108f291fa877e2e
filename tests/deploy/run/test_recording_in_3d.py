"""A recording holds what a 3-D view of it needs, as other people's readers decode it."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from deploy.run.simulate import simulate
from deploy.scenario.scenario import load_setup

DURATION_S = 0.5


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    simulate(load_setup("iiwa", [f"duration_s={DURATION_S}"])).write_log(path)
    return path


def test_first_comes_the_arm_and_then_where_its_links_are(file: Path) -> None:
    found: defaultdict[str, list[Any]] = defaultdict(list)
    qos = {}
    with file.open("rb") as opened:
        for _, channel, message, decoded in make_reader(
            opened, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages(log_time_order=False):
            if not found:
                assert channel.topic == "/robot_description"
            found[channel.topic].append((message.log_time, decoded))
            (qos[channel.topic],) = yaml.safe_load(channel.metadata["offered_qos_profiles"])
    ((_, description),) = found["/robot_description"]
    assert description.data.startswith("<robot")
    for latched in ("/robot_description", "/tf_static"):
        assert (qos[latched]["durability"], qos[latched]["depth"]) == ("transient_local", 1)
    assert (qos["/tf"]["durability"], qos["/tf"]["depth"]) == ("volatile", 100)
    times = [time for time, _ in found["/tf"]]
    assert 0.8 * 60 * DURATION_S <= len(times) <= 60 * DURATION_S
    states = dict(found["/joint_states"])
    for time, decoded in found["/tf"]:
        assert time in states  # at the instant of a state
        assert {t.header.stamp.nanosec for t in decoded.transforms} == {time}
    moved = [
        each.transform.rotation.w
        for _, decoded in found["/tf"]
        for each in decoded.transforms
        if each.child_frame_id == "lbr_iiwa_link_1"
    ]
    angle = 2.0 * np.arccos(moved[-1])
    assert angle == pytest.approx(abs(states[times[-1]].position[0]), abs=1e-6)
