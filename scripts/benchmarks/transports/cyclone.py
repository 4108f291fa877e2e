"""CycloneDDS through its Python binding, reliable, on the loopback interface.

Its binding takes and gives sequences of bytes as Python objects, which is part of what it costs.
"""

import os
from dataclasses import dataclass

from scripts.benchmarks.echo import Messages, TryingTransport

os.environ["CYCLONEDDS_URI"] = """<CycloneDDS><Domain>
<General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex>
<Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""  # read when it is imported

from cyclonedds.core import (
    InstanceState,
    Policy,
    Qos,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import sequence, uint8
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

_QOS = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(10))


@dataclass
class Payload(IdlStruct, typename="Payload"):  # type: ignore[misc, call-arg]
    """Bytes."""

    data: sequence[uint8]


class _Inbox:
    """Waits for samples of a topic."""

    def __init__(self, participant: DomainParticipant, topic: Topic[Payload]) -> None:
        self._reader = DataReader(participant, topic, qos=_QOS)
        anything = SampleState.Any | ViewState.Any | InstanceState.Any
        self._arrived = WaitSet(participant)
        self._arrived.attach(ReadCondition(self._reader, anything))

    def take(self, timeout_s: float) -> bool:
        """Take all there is; whether anything came in time."""
        self._arrived.wait(duration(microseconds=round(1e6 * timeout_s)))
        return bool(self._reader.take(10))


class Near(TryingTransport):
    """The end that asks."""

    def __init__(self, messages: Messages) -> None:
        self._messages = messages
        domain = 60 + os.getpid() % 100
        self.address = str(domain)
        self._participant = DomainParticipant(domain)
        self._status, self._state = (
            DataWriter(self._participant, Topic(self._participant, name, Payload), qos=_QOS)
            for name in ("status", "state")
        )
        self._inbox = _Inbox(self._participant, Topic(self._participant, "command", Payload))

    def _send(self) -> None:
        self._status.write(Payload(self._messages.status))
        self._state.write(Payload(self._messages.state))

    def _took(self, timeout_s: float) -> bool:
        return self._inbox.take(timeout_s)

    @staticmethod
    def answer(address: str, messages: Messages) -> None:
        """Answer every state."""
        participant = DomainParticipant(int(address))
        command = DataWriter(participant, Topic(participant, "command", Payload), qos=_QOS)
        status = _Inbox(participant, Topic(participant, "status", Payload))
        state = _Inbox(participant, Topic(participant, "state", Payload))
        while True:
            if state.take(1.0):
                status.take(0.0)
                command.write(Payload(messages.command))
