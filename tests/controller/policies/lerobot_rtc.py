"""LeRobot's own real-time chunking and action queue; run with a Python that has lerobot.

python lerobot_rtc.py INPUT.npz OUTPUT.npz
"""

import sys
from functools import partial

import numpy as np
import torch
from lerobot.configs.types import RTCAttentionSchedule
from lerobot.policies.rtc.action_queue import ActionQueue
from lerobot.policies.rtc.configuration_rtc import RTCConfig
from lerobot.policies.rtc.modeling_rtc import RTCProcessor

ACTIONS, PERIOD_S, DELAY, EXECUTED, FLOW_STEPS = 16, 0.04, 3, 6, 10
KEPT = ACTIONS - EXECUTED


def processor(schedule=RTCAttentionSchedule.LINEAR):
    config = RTCConfig(
        enabled=True, prefix_attention_schedule=schedule, max_guidance_weight=5.0,
        execution_horizon=KEPT,
    )  # fmt: skip
    return RTCProcessor(config)


def weights(schedule):
    return processor(schedule).get_prefix_weights(DELAY, KEPT, ACTIONS).numpy()


def guided_velocities(given):
    """Velocities at several flow times; LeRobot's time runs from 1 to 0, and noise is its end."""
    found = []
    for tau, matrix in zip(given["taus"], given["denoisers"], strict=True):
        sample, expected = torch.tensor(given["sample"]), torch.tensor(matrix @ given["sample"])
        velocity = (sample - expected) / (1.0 - tau)
        found.append(
            -processor().denoise_step(
                sample, torch.tensor(given["prefix"]), DELAY, torch.tensor(1.0 - tau),
                lambda _, v=velocity: v,
            ).numpy()
        )  # fmt: skip
    return np.array(found)


def queued(steps):
    """Actions that the queue hands out, of chunks 1000 k + i asked after six of them."""
    queue, out, chunk, asked = ActionQueue(RTCConfig(enabled=True)), [], 0, None
    queue.merge(torch.arange(float(ACTIONS))[:, None], torch.arange(float(ACTIONS))[:, None], 0)
    since = 0
    for _ in range(steps):
        if since == EXECUTED:
            chunk, asked, since = chunk + 1, queue.get_action_index(), 0
        if asked is not None and since == DELAY:
            new = 1000.0 * chunk + torch.arange(float(ACTIONS))[:, None]
            queue.merge(new, new, DELAY, asked)
            asked = None
        out.append(queue.get().item())
        since += 1
    return np.array(out)


def trained_flow():
    """A small network that learned the flow to chunks of -0.5 cos(t) + an offset of 20 mrad."""
    net = torch.nn.Sequential(torch.nn.Linear(ACTIONS + 3, 64), torch.nn.Tanh(),
                              torch.nn.Linear(64, ACTIONS))  # fmt: skip
    optimizer = torch.optim.Adam(net.parameters(), 3e-3)
    for _ in range(1500):
        begin_s = 2.0 * torch.pi * torch.rand(256, 1)
        chunk = demonstrated(begin_s) + 0.1 * torch.randn(256, 1)
        time, noise = torch.rand(256, 1), torch.randn(256, ACTIONS)
        sample = time * noise + (1.0 - time) * chunk
        loss = (net(inputs(sample, time, begin_s)) - (noise - chunk)).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return net, loss.item()


def demonstrated(begin_s):
    """A chunk in units of 0.2 rad."""
    return -2.5 * torch.cos(begin_s + PERIOD_S * torch.arange(ACTIONS))


def inputs(sample, time, begin_s):
    return torch.cat([sample, time, torch.cos(begin_s), torch.sin(begin_s)], dim=1)


def velocity_of(net, time, begin_s, sample):
    return net(inputs(sample.reshape(1, -1), time, begin_s)).detach().reshape(sample.shape)


def jumps(net, *, is_guided):
    """Jumps of the actions at 60 switches, in units of 0.2 rad."""
    torch.manual_seed(2)
    queue, found, rtc = ActionQueue(RTCConfig(enabled=True)), [], processor()
    for question in range(60):
        begin_s = torch.full((1, 1), question * EXECUTED * PERIOD_S)
        left = queue.get_left_over()
        sample = torch.randn(1, ACTIONS)
        for step in range(FLOW_STEPS):
            time = torch.tensor(1.0 - step / FLOW_STEPS)
            denoise = partial(velocity_of, net, time.view(1, 1), begin_s)
            prefix = left if is_guided else None
            velocity = rtc.denoise_step(sample[0, :, None], prefix, DELAY, time, denoise)
            sample = sample - velocity.reshape(1, -1) / FLOW_STEPS
        new, delay = sample[0, :, None].detach(), DELAY if left is not None else 0
        if left is not None:
            for _ in range(DELAY):
                queue.get()
            found.append((new[DELAY] - queue.get_left_over()[0]).abs().item())
        queue.merge(new, new, delay, None)
        for _ in range(EXECUTED - delay):
            queue.get()
    return np.array(found)


def main(source, target):
    torch.manual_seed(1)
    torch.set_num_threads(1)
    given = np.load(source)
    net, loss = trained_flow()
    np.savez(
        target, linear=weights(RTCAttentionSchedule.LINEAR), loss=loss,
        exponential=weights(RTCAttentionSchedule.EXP), velocities=guided_velocities(given),
        queued=queued(60), free=jumps(net, is_guided=False), guided=jumps(net, is_guided=True),
    )  # fmt: skip


if __name__ == "__main__":
    main(*sys.argv[1:])
