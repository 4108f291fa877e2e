"""A kind of fault is a class and a line of the table: kinds from outside, in whole scenarios."""

from typing import Literal

import numpy as np
import pytest

from bus_schema.configuration import ConfigurationError
from bus_schema.messages import topics
from bus_schema.messages.run_event import EventKind
from deploy.runs.judging.metrics import summarise
from deploy.runs.simulate import simulate
from deploy.scenario.scenario import load_setup
from deploy.scenario.yaml_files import ScenarioError
from plant_emulator.faults import kinds
from plant_emulator.faults.arm_faults import EncoderFault, EncoderReading
from plant_emulator.faults.channel_faults import ChannelFault
from plant_emulator.faults.message_faults import MessageFault


class EncoderReversed(EncoderFault):
    kind: Literal["encoder_reversed"]

    def faulty_reading(self, encoder):
        return EncoderReading(-encoder.reading.position_rad, -encoder.reading.velocity_rad_s)

    def check(self, key, context):
        super().check(key, context)
        if self.for_s is None:
            raise ConfigurationError(f"{key}.for_s", self.for_s, "how long it is reversed")


class LinkLossy(ChannelFault):
    kind: Literal["link_lossy"]
    loss: float

    def changed(self, conditions):
        return conditions._replace(loss=self.loss)


class TorqueStuck(MessageFault):
    kind: Literal["torque_stuck"]
    torque_nm: float

    def acts_on(self):
        return "downlink"

    def changed(self, messages, editor):
        return tuple(
            editor.with_torque(each, self.torque_nm, joints=slice(None)) for each in messages
        )


@pytest.fixture(autouse=True)
def more_kinds(monkeypatch):
    more = [EncoderReversed, LinkLossy, TorqueStuck]
    monkeypatch.setattr(kinds, "FAULT_KINDS", [*kinds.FAULT_KINDS, *more])


def run(fault):
    return simulate(load_setup("paper_arm", ["duration_s=0.2", f"faults=[{fault}]"])).data()


def test_fault_of_the_arm_from_outside():
    data = run("{kind: encoder_reversed, joint: elbow, at_s: 0.1, for_s: 0.05}")
    seen = data.tables[topics.JOINT_STATES.name]["position"][:200]
    true = data.tables[topics.PLANT_TRUTH.name]["position"][:200]
    sign = np.ones((200, 3))
    sign[100:150, 2] = -1.0
    np.testing.assert_array_equal(seen, sign * true)
    told = [event.detail for event in data.events if event.kind == EventKind.INJECTED]
    assert told == [
        "encoder_reversed, joint elbow: begins", "encoder_reversed, joint elbow: is over"
    ]  # fmt: skip


def test_fault_of_the_link_from_outside():
    data = run("{kind: link_lossy, direction: uplink, loss: 1, at_s: 0.1, for_s: 0.02}")
    assert summarise(data)["transport"]["uplink"]["lost"] == 20


def test_fault_of_messages_from_outside():
    data = run("{kind: torque_stuck, torque_nm: 1.5, at_s: 0.1, for_s: 0.05}")
    torque = data.tables[topics.PLANT_TRUTH.name]["torque"]
    assert (torque[101:150] == 1.5).all()
    assert not (torque[:100] == 1.5).any()


@pytest.mark.parametrize(
    ("fault", "told"),
    [
        ("{kind: encoder_reversed, joint: knee, at_s: 0.1, for_s: 1}", "faults.0.joint = 'knee'"),
        ("{kind: encoder_reversed, joint: elbow, at_s: 0.1}", "faults.0.for_s = null: how long"),
        ("{kind: link_lossy, direction: uplink, at_s: 0.1}", "faults.0.link_lossy.loss: is miss"),
        ("{kind: torque_loose, at_s: 0.1}", "must be one of .*'encoder_reversed', 'link_lossy'"),
    ],
)
def test_fault_from_outside_is_checked_like_any_other(fault, told):
    with pytest.raises(ScenarioError, match=told):
        run(fault)
