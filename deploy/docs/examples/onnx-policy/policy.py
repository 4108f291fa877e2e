"""A law that asks policy.onnx for targets of the drives."""

from pathlib import Path

import numpy as np
import onnxruntime

from funnel_hil import Diagnostics

NETWORK = Path(__file__).with_name("policy.onnx")


def observation(reference_position, reference_velocity, error):
    """Return the network's input, shape (3 · joints,)."""
    return np.concatenate([reference_position, reference_velocity, error], axis=-1)


class Policy:
    def __init__(self, model):
        self.diagnostics = Diagnostics(model.joints)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self.session = onnxruntime.InferenceSession(
            NETWORK, options, providers=["CPUExecutionProvider"]
        )

    def reset(self):
        pass

    def torque(self, tracking):
        return np.zeros_like(tracking.error)  # the drive loops make the torque

    def target(self, tracking):
        reference = tracking.reference_position, tracking.reference_velocity
        seen = observation(*reference, tracking.error).astype(np.float32)
        (correction,) = self.session.run(None, {"observation": seen[np.newaxis]})
        return np.array([reference[0] + correction[0], reference[1]])
