"""A ROS 2 node as controller: PD torques around the reference, which the plant publishes."""

import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState


def stamp_of(message):
    return message.header.stamp.sec, message.header.stamp.nanosec


class Controller(Node):
    def __init__(self):
        super().__init__("my_controller")
        self.references, self.unanswered = {}, {}  # by stamp
        self.commands = self.create_publisher(JointState, "joint_commands", 10)
        self.create_subscription(JointState, "joint_reference", self.on_reference, 10)
        self.create_subscription(JointState, "joint_states", self.on_state, 10)

    def on_reference(self, reference):
        self.keep(self.references, reference)
        self.answer(stamp_of(reference))

    def on_state(self, state):
        self.keep(self.unanswered, state)
        self.answer(stamp_of(state))

    def keep(self, messages, message):
        messages[stamp_of(message)] = message
        if len(messages) > 1000:
            del messages[next(iter(messages))]  # the oldest

    def answer(self, stamp):
        """Whichever of a state and its reference comes first waits for the other."""
        if stamp not in self.references or stamp not in self.unanswered:
            return
        state, reference = self.unanswered.pop(stamp), self.references[stamp]
        command = JointState(name=state.name)
        command.header.stamp = state.header.stamp  # which state it answers
        command.effort = [
            4000.0 * (q_d - q) + 300.0 * (v_d - v)
            for q_d, q, v_d, v in zip(
                reference.position, state.position, reference.velocity, state.velocity, strict=True
            )
        ]
        self.commands.publish(command)


rclpy.init()
rclpy.spin(Controller())
