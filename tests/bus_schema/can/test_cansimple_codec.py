"""Units on the wire of CANSimple: turns there, radians here."""

import math
import struct

import numpy as np

from bus_schema.can.cansimple.codec import CanSimpleCodec, Command, identifier
from bus_schema.can.frame import CanFrame


def test_turns_and_turns_per_second_become_radians():
    position, velocity = np.zeros((2, 2))
    answer = CanFrame(identifier(5, Command.GET_ENCODER_ESTIMATES), struct.pack("<ff", 0.25, -2.0))
    assert CanSimpleCodec((4, 5)).read_state(answer, position, velocity) == 1
    assert position.tolist() == [0.0, 0.5 * math.pi]
    assert velocity.tolist() == [0.0, -4.0 * math.pi]
