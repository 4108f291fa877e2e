"""The run's clock on the bus: a command with its stamp answers the newest state."""

from __future__ import annotations

from rosbags.typesys import Stores, get_typestore

from bus_schema.messages.record import Record
from bus_schema.messages.topics import CLOCK, JOINT_COMMANDS, JOINT_STATES, layout
from bus_schema.messages.types import CLOCK as CLOCK_TYPE
from bus_schema.messages.types import type_hash
from bus_schema.zenoh.session import Delivery, ZenohSession
from deploy.run.network.more_topics import with_clock
from plant_emulator.command_gate import CommandGate
from tests.bus_schema.zenoh.zenoh_pair import HANG_S, JOINTS, fresh_link, plant_on, state, status
from tests.waiting import await_true

ROS = get_typestore(Stores.ROS2_JAZZY)


class TopicBasedHardware:
    """Stamps commands as joint_state_topic_hardware_interface does: with its node's time."""

    def __init__(self, endpoint: str) -> None:
        self.now_ns = 0
        self._session = ZenohSession([], [endpoint], low_latency=False)
        self._command = Record(layout(JOINT_COMMANDS, JOINTS))
        self._commands = self._session.publisher(JOINT_COMMANDS.key_expression(0))
        self._session.subscribe(CLOCK.key_expression(0), self._on_clock)
        self._session.subscribe(JOINT_STATES.key_expression(0), self._on_state)
        self.states = 0

    def _on_clock(self, delivery: Delivery) -> None:
        time = ROS.deserialize_cdr(delivery.payload, CLOCK_TYPE).clock
        self.now_ns = time.sec * 1_000_000_000 + time.nanosec

    def _on_state(self, _delivery: Delivery) -> None:
        self.states += 1

    def write(self) -> None:
        self._command.stamp_ns = self.now_ns
        self._commands.put(self._command.payload(), b"")

    def close(self) -> None:
        self._session.close()


def test_command_stamped_with_the_clock_answers_the_newest_state() -> None:
    assert type_hash(CLOCK_TYPE) == ROS.hash_rihs01(CLOCK_TYPE)
    link = fresh_link().model_copy(update={"publish_clock": True})
    with plant_on(link) as plant:
        hardware = TopicBasedHardware(link.plant_endpoint)
        clocked = with_clock(plant)
        await_true(plant._states.has_subscribers)

        def is_received() -> bool:
            clocked.send_state(state(0), status())
            return hardware.states > 0

        await_true(is_received)
        gate = CommandGate(JOINTS)
        for stamp_ns in (1_000_000, 1_500_000_000, 2_000_000_123):
            clocked.send_state(state(stamp_ns), status())
            await_true(lambda now=stamp_ns: hardware.now_ns == now)
            hardware.write()
            assert clocked.await_command(HANG_S)
            admitted = [gate.admit(arrival, stamp_ns) for arrival in clocked.take_commands()]
            assert [command.stamp_ns for command in admitted if command] == [stamp_ns]
        assert not gate.rejections.counts
        hardware.close()
