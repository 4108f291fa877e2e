"""Train a tiny ACT policy of LeRobot along -0.5 cos(t) rad; run with a Python that has lerobot.

    python train_act.py FOLDER

The state is the position, the reference and its velocity; an action is the reference 40 ms later
than the one before. The camera's image is grey: ACT needs one.
"""

import sys

import numpy as np
import torch
from lerobot.configs.types import FeatureType, NormalizationMode, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors

ACTIONS, PERIOD_S, PIXELS, STEPS, BATCH = 16, 0.04, 32, 300, 16
STATE, IMAGE, ACTION = "observation.state", "observation.images.front", "action"


def demonstrations(count, chance):
    """States and chunks at random times, with positions beside the reference."""
    begin_s = chance.uniform(0.0, 2.0 * np.pi, (count, 1))
    times_s = begin_s + PERIOD_S * np.arange(ACTIONS)
    position, velocity = -0.5 * np.cos(begin_s), 0.5 * np.sin(begin_s)
    state = np.hstack([position + 0.02 * chance.standard_normal((count, 1)), position, velocity])
    chunk = -0.5 * np.cos(times_s)[:, :, np.newaxis]
    return torch.tensor(state, dtype=torch.float32), torch.tensor(chunk, dtype=torch.float32)


def main(folder):
    torch.manual_seed(1)
    torch.set_num_threads(1)
    state, chunk = demonstrations(4000, np.random.default_rng(1))
    stats = {
        STATE: {"mean": state.mean(0), "std": state.std(0)},
        ACTION: {"mean": chunk.mean((0, 1)), "std": chunk.std((0, 1))},
    }
    config = ACTConfig(
        input_features={
            STATE: PolicyFeature(FeatureType.STATE, (state.shape[1],)),
            IMAGE: PolicyFeature(FeatureType.VISUAL, (3, PIXELS, PIXELS)),
        },
        output_features={ACTION: PolicyFeature(FeatureType.ACTION, (1,))},
        normalization_mapping={
            "VISUAL": NormalizationMode.IDENTITY,
            "STATE": NormalizationMode.MEAN_STD,
            "ACTION": NormalizationMode.MEAN_STD,
        },
        chunk_size=ACTIONS, n_action_steps=ACTIONS, dim_model=32, n_heads=2, dim_feedforward=64,
        n_encoder_layers=1, n_decoder_layers=1, use_vae=False, dropout=0.0,
        pretrained_backbone_weights=None, device="cpu", push_to_hub=False,
    )  # fmt: skip
    policy = ACTPolicy(config)
    policy.model.backbone.requires_grad_(False)  # it sees grey alone
    before, after = make_pre_post_processors(config, dataset_stats=stats)
    optimizer = torch.optim.Adam([p for p in policy.parameters() if p.requires_grad], 2e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, STEPS)
    grey = torch.full((BATCH, 3, PIXELS, PIXELS), 128 / 255)
    no_pad = torch.zeros(BATCH, ACTIONS, dtype=torch.bool)
    policy.train()
    for _ in range(STEPS):
        at = torch.randint(len(state), (BATCH,))
        batch = before({STATE: state[at], IMAGE: grey, ACTION: chunk[at]})
        loss, _ = policy({**batch, "action_is_pad": no_pad})
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    for each in (policy.eval(), before, after):
        each.save_pretrained(folder)
    print(f"loss {loss.item():.4f}")


if __name__ == "__main__":
    main(sys.argv[1])
