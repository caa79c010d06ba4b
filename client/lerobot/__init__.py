"""Datasets in LeRobot's format (v3.0), for training its policies; `client.lerobot.devices` is a robot for it.

`write_dataset` makes one of recordings, `write_episodes` of episodes in memory. They write the same files as
``lerobot``, but do not need it: installing ``lerobot`` would also install PyTorch.
"""

from client.lerobot.dataset import Dataset, write_dataset, write_episodes
from client.lerobot.episodes import DEFAULT_ACTION, DEFAULT_STATE, Episode, Numbers

__all__ = ["DEFAULT_ACTION", "DEFAULT_STATE", "Dataset", "Episode", "Numbers", "write_dataset", "write_episodes"]
