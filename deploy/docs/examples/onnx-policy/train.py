"""Train a small network to imitate a teacher that knows the arm's nominal model.

The teacher moves the target of each drive beyond the reference: by the sag that the nominal load
causes, and by a limited step against the error. The network learns both from the teacher's answers
along the reference and at random errors beside it. It knows no other trajectory.
"""

from pathlib import Path

import numpy as np
import onnx
import yaml
from onnx import TensorProto, helper, numpy_helper
from policy import NETWORK, observation

import funnel_hil

SCENARIO = Path(__file__).with_name("scenario.yaml")
STIFFNESS_NM_RAD = yaml.safe_load(SCENARIO.read_text())["plant"]["drive_feedback"][
    "stiffness_nm_rad"
]
HIDDEN, STEPS, BATCH, RATE = 32, 6000, 256, 1e-2
LIMIT_RAD, SOFTNESS_RAD = 0.02, 0.04


class Teacher:
    """Answers, and keeps what it was asked and the sag it found."""

    def __init__(self, model):
        self.diagnostics = funnel_hil.Diagnostics(model.joints)
        self.model, self.demonstrations = model, []

    def reset(self):
        self.demonstrations.clear()

    def torque(self, tracking):
        return np.zeros_like(tracking.error)

    def target(self, tracking):
        position, velocity = tracking.reference_position.copy(), tracking.reference_velocity.copy()
        load = self.model.inverse_dynamics(position, velocity, tracking.reference_acceleration)
        sag = load / STIFFNESS_NM_RAD
        self.demonstrations.append((position, velocity, sag))
        return np.array([position + sag + step_against(tracking.error), velocity])


def step_against(error):
    return -LIMIT_RAD * np.tanh(error / SOFTNESS_RAD)


def demonstrations():
    """Positions, velocities and sags along the reference, 50 a second."""
    teachers = []

    def law(model):
        teachers.append(Teacher(model))
        return teachers[-1]

    run = funnel_hil.simulate(str(SCENARIO), law=law)
    print(f"teacher: {run.verdict}, smallest margin {100 * run.margin:.0f} %")
    return (np.array(column) for column in zip(*teachers[-1].demonstrations, strict=True))


def with_errors(position, velocity, sag, chance):
    """Observations and corrections at random errors beside the demonstrations, small and large."""
    copies = np.repeat(np.arange(len(sag)), 30)
    spread = chance.choice([0.005, 0.05, 0.15], (copies.size, 1))
    error = spread * chance.standard_normal((copies.size, sag.shape[1]))
    seen = observation(position[copies], velocity[copies], error)
    return seen, sag[copies] + step_against(error)


def train(seen, wanted, chance):
    """Weights and biases of a network of two layers, by Adam on the squared error."""
    parameters = []
    for inputs, outputs in (seen.shape[1], HIDDEN), (HIDDEN, wanted.shape[1]):
        weights = chance.standard_normal((inputs, outputs)) / np.sqrt(inputs)
        parameters += [weights, np.zeros(outputs)]
    means, squares = ([np.zeros_like(p) for p in parameters] for _ in range(2))
    for step in range(1, STEPS + 1):
        batch = chance.integers(len(seen), size=BATCH)
        first, first_bias, last, last_bias = parameters
        hidden = np.tanh(seen[batch] @ first + first_bias)
        miss = (hidden @ last + last_bias - wanted[batch]) / BATCH
        back = (miss @ last.T) * (1.0 - hidden**2)
        slopes = [seen[batch].T @ back, back.sum(0), hidden.T @ miss, miss.sum(0)]
        rate = RATE * (1.0 - step / (STEPS + 1))
        for parameter, slope, mean, square in zip(parameters, slopes, means, squares, strict=True):
            mean += 0.1 * (slope - mean)
            square += 0.001 * (slope**2 - square)
            size = np.sqrt(square / (1.0 - 0.999**step)) + 1e-8
            parameter -= rate * mean / (1.0 - 0.9**step) / size
    return parameters


def save(parameters):
    names = ["first", "first_bias", "last", "last_bias"]
    weights = [
        numpy_helper.from_array(value.astype(np.float32), name)
        for name, value in zip(names, parameters, strict=True)
    ]
    nodes = [
        helper.make_node("Gemm", ["observation", "first", "first_bias"], ["sums"]),
        helper.make_node("Tanh", ["sums"], ["hidden"]),
        helper.make_node("Gemm", ["hidden", "last", "last_bias"], ["correction"]),
    ]
    ends = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, [None, size])
        for name, size in (
            ("observation", len(parameters[0])),
            ("correction", len(parameters[3])),
        )
    ]
    graph = helper.make_graph(nodes, "policy", ends[:1], ends[1:], weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, NETWORK)


def main():
    chance = np.random.default_rng(1)
    seen, wanted = with_errors(*demonstrations(), chance)
    center, scale = seen.mean(0), seen.std(0) + 1e-9
    unit = wanted.std()
    first, first_bias, last, last_bias = train((seen - center) / scale, wanted / unit, chance)
    first = first / scale[:, np.newaxis]  # the network takes radians and gives radians
    parameters = [first, first_bias - center @ first, unit * last, unit * last_bias]
    save(parameters)
    hidden = np.tanh(seen @ parameters[0] + parameters[1])
    miss = hidden @ parameters[2] + parameters[3] - wanted
    print(f"{NETWORK.name}: misses the teacher by {1e3 * np.sqrt(np.mean(miss**2)):.2f} mrad RMS")


if __name__ == "__main__":
    main()
