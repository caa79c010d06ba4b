"""Train a small ACT of LeRobot on a dataset of record_dataset.py, without a graphics card, and evaluate it.

    pip install 'lerobot[dataset]' '.[learning,lerobot]'
    python examples/learning/record_dataset.py pick_and_place 120 picks
    python examples/learning/act_policy.py picks act 4000
    ACT=act ur-emulator evaluate pick_and_place --policy examples/learning/act_policy.py:load --seed 1000

4,000 steps take half an hour on one core. All frames are held in memory, which is why this does not use lerobot-train.
"""

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import torch
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy

STATE, GOALS, ACTION = "observation.state", "observation.environment_state", "action"
CHUNK, EXECUTED, BATCH = 20, 4, 64  # actions that are learned at a time, and executed of them; frames
RATE, LEAST_DEVIATION = 5e-4, 1e-4


def load_frames(folder: Path) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """The numbers of all frames, and for each frame the last one of its episode."""
    table = pq.read_table(folder / "data")
    episodes = table["episode_index"].to_numpy()
    last = np.searchsorted(episodes, episodes, side="right") - 1
    return {name: np.array(table[name].to_pylist(), np.float32) for name in (STATE, GOALS, ACTION)}, last


def train(folder: Path, out: Path, steps: int) -> None:
    """Train, and save the policy with the mean and the deviation of each number."""
    torch.set_num_threads(1)
    torch.manual_seed(0)
    frames, last = load_frames(folder)
    scales = {name: (values.mean(0), values.std(0) + LEAST_DEVIATION) for name, values in frames.items()}
    data = {name: (values - scales[name][0]) / scales[name][1] for name, values in frames.items()}
    later = np.arange(len(last))[:, None] + np.arange(CHUNK)
    padded, later = later > last[:, None], np.minimum(later, last[:, None])
    policy = ACTPolicy(
        ACTConfig(
            device="cpu",
            chunk_size=CHUNK,
            n_action_steps=EXECUTED,
            dim_model=128,
            dim_feedforward=256,
            n_heads=4,
            n_encoder_layers=2,
            n_vae_encoder_layers=2,
            latent_dim=16,
            push_to_hub=False,
            input_features={
                STATE: PolicyFeature(FeatureType.STATE, data[STATE].shape[1:]),
                GOALS: PolicyFeature(FeatureType.ENV, data[GOALS].shape[1:]),
            },
            output_features={ACTION: PolicyFeature(FeatureType.ACTION, data[ACTION].shape[1:])},
        )
    ).train()
    optimiser = torch.optim.AdamW(policy.parameters(), lr=RATE, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    chance, losses = np.random.default_rng(0), []
    for step in range(1, steps + 1):
        chosen = chance.integers(0, len(last), BATCH)
        batch = {STATE: data[STATE][chosen], GOALS: data[GOALS][chosen], ACTION: data[ACTION][later[chosen]]}
        batch["action_is_pad"] = padded[chosen]
        loss, _ = policy.forward({name: torch.from_numpy(values) for name, values in batch.items()})
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(policy.parameters(), 10.0)
        optimiser.step()
        schedule.step()
        losses.append(loss.item())
        if step % 200 == 0:
            print(f"step {step}: loss {np.mean(losses[-200:]):.3f}", flush=True)
    policy.save_pretrained(out)
    parts = {f"{name}/{i}": part for name, both in scales.items() for i, part in enumerate(both)}
    np.savez(out / "scales.npz", **parts)


class TrainedPolicy:
    """A policy that was trained so."""

    def __init__(self, env: Any) -> None:
        torch.set_num_threads(1)
        folder = Path(os.environ.get("ACT", "act"))
        self._policy = ACTPolicy.from_pretrained(folder).eval()
        self._scales = np.load(folder / "scales.npz")

    def reset(self, seed: int) -> None:
        """Begin an episode."""
        self._policy.reset()

    def __call__(self, seen: dict[str, Any]) -> np.ndarray:
        """The action for an observation."""
        goals = np.concatenate([seen["achieved_goal"], seen["desired_goal"]])
        with torch.no_grad():
            action = self._policy.select_action(
                {STATE: self._scaled(STATE, seen["observation"]), GOALS: self._scaled(GOALS, goals)}
            )
        return action[0].numpy() * self._scales[f"{ACTION}/1"] + self._scales[f"{ACTION}/0"]

    def _scaled(self, name: str, values: np.ndarray) -> torch.Tensor:
        mean, deviation = self._scales[f"{name}/0"], self._scales[f"{name}/1"]
        return torch.from_numpy(((values - mean) / deviation).astype(np.float32))[None]


load = TrainedPolicy

if __name__ == "__main__":
    train(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))
